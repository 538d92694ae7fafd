"""Sequence folders: writing in TUM form, reading in any."""

from dslab.sim.io.forms import load_sequence
from dslab.sim.io.tum_writer import write_tum

__all__ = ["load_sequence", "write_tum"]
