"""Runs as a rerun recording, any number of systems side by side. Only this package imports rerun."""

import os

# rerun reads this when it is loaded. Its writer logs what is raised here as an error of its own.
os.environ.setdefault("RUST_LOG", "off")

from experiments.recording.recorder import Recording, SystemRecorder
from experiments.recording.viewer import open_viewer

__all__ = ["Recording", "SystemRecorder", "open_viewer"]
