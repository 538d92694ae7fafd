"""Sequence folders: writing in TUM form, reading in any."""

from sim.io.folders import claim_output_dir
from sim.io.forms import load_sequence
from sim.io.tum_writer import write_tum

__all__ = ["claim_output_dir", "load_sequence", "write_tum"]
