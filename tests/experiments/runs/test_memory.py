"""Memory of one run does not count for the next."""

import platform

import psutil
import pytest

from dslab.experiments.runs.memory import peak_rss_mb, reset_peak

PIECE = 100_000  # bytes, small enough for the heap


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's heap")
def test_memory_that_a_run_has_freed_is_returned_though_something_after_it_is_kept():
    pieces = [bytearray(PIECE) for _ in range(2000)]
    held_mb = psutil.Process().memory_info().rss / 2**20
    kept = pieces.pop()
    pieces.clear()
    reset_peak()
    assert peak_rss_mb() < held_mb - 100
    assert len(kept) == PIECE
