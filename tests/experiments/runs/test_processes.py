"""Worker processes end with the process that started them."""

import os
import subprocess
import sys

import psutil
import pytest

from experiments.runs.processes import process_pool

KILLED = """
import os, signal
from experiments.runs.processes import process_pool
if __name__ == "__main__":
    with process_pool(1) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
"""


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    (tmp_path / "killed.py").write_text(KILLED)
    words = [sys.executable, str(tmp_path / "killed.py")]
    ended = subprocess.run(words, stdout=subprocess.PIPE, text=True, timeout=60, check=False)
    try:
        worker = psutil.Process(int(ended.stdout))
    except psutil.NoSuchProcess:
        return
    worker.wait(timeout=20)


def test_workers_are_killed_if_the_block_raises():
    def work():
        with process_pool(1) as pool:
            pids.append(pool.submit(os.getpid).result())
            raise KeyboardInterrupt

    pids: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        work()
    assert not psutil.pid_exists(pids[0])
