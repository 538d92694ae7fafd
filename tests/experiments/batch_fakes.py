"""Runs of a batch that are made up, in processes of their own; and batches of them."""

import time
from pathlib import Path

from dslab.experiments.batch.rows import Row
from dslab.experiments.batch.run import Job

_MET_S = 30.0


def made_up(job: Job) -> Row:
    """A figure that depends on the run, and a note that it was made."""
    _note(job, "made")
    return job.about | {
        "ended": "finished",
        "intact": job.about["run"] > 0,
        "ate_m": 1.0 + job.about["run"],
    }


def leaving_a_note(job: Job) -> Row:
    """Leaves a file as its result."""
    job.folder.mkdir(parents=True)
    (job.folder / "note").touch()
    return made_up(job)


def slow(job: Job) -> Row:
    """Later runs take longer than a test waits, until they may go."""
    if job.about["run"] > 0 and not (_notes(job) / "go").exists():
        _note(job, "waits")
        time.sleep(60)
    return made_up(job)


def going_wrong(job: Job) -> Row:
    """Run 1 ends as if its process died, run 2 as if it hung, run 3 raises unless mended."""
    if job.about["run"] == 1:
        raise ChildProcessError("its process has died (exit code 7)")
    if job.about["run"] == 2:
        raise TimeoutError
    if job.about["run"] == 3 and not (_notes(job) / "mended").exists():
        raise OSError("no disk")
    return made_up(job)


def meeting(job: Job) -> Row:
    """Those that may run side by side wait for one another; those that must not say who is there."""
    mark = _notes(job) / f"here-{job.system}-{job.about['run']}"
    mark.touch()
    others = [p.name for p in mark.parent.glob("here-*") if p != mark]
    until_s = time.monotonic() + _MET_S
    while not job.alone and not others and time.monotonic() < until_s:
        time.sleep(0.02)
        others = [p.name for p in mark.parent.glob("*here-*") if p != mark]
    row = made_up(job) | {"ended_message": "alone" if not others else "met"}
    mark.rename(mark.with_name(f"was-{mark.name}"))
    return row


def _notes(job: Job) -> Path:
    return job.folder.parents[4]


def _note(job: Job, word: str) -> None:
    with (_notes(job) / word).open("a") as file:
        file.write(f"{job.system} {job.about['run']}\n")
