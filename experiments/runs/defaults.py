"""What a run takes where nothing is said, on the command line and in Python alike."""

from typing import Literal

SYSTEM = "base"
"""The method that the others are compared with."""
MODE: Literal["lockstep", "threaded"] = "lockstep"
"""Repeats bit for bit."""
