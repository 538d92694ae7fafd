"""Recordings of runs for rerun, systems side by side. Only this package imports rerun."""

import os

# rerun reads this on import. Without it the writer logs errors that are raised here anyway.
os.environ.setdefault("RUST_LOG", "off")

from dslab.experiments.recording.recorder import Recording, SystemRecorder
from dslab.experiments.recording.viewer import open_viewer, recorded_breakage_s

__all__ = ["Recording", "SystemRecorder", "open_viewer", "recorded_breakage_s"]
