"""TUM-form folders, written and read; the form is described in ``sim.io.layout``."""

from sim.io.tum_reader import load_sequence
from sim.io.tum_writer import claim_output_dir, write_tum

__all__ = ["claim_output_dir", "load_sequence", "write_tum"]
