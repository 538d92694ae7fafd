"""Sequence folders as the rest of the code writes and reads them: written in TUM form, read in any."""

from sim.io.forms import load_sequence
from sim.io.tum_writer import write_tum

__all__ = ["load_sequence", "write_tum"]
