"""Recordings of failed units, made by replaying them."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dslab.experiments.report.paths_file import add_paths, paths_of
from dslab.sim.io.folders import write_file

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec
    from dslab.experiments.eq1.units import UnitSpec

FOLDER = "recordings"


def add_recordings(
    report: dict[str, Any],
    spec: "ExperimentSpec",
    folder: Path,
    count: int,
    progress: Callable[[int, int], None],
) -> None:
    """Record the first failed units that have no recording, and store their paths.

    Args:
        report: figures from `report_content`; its failures get the paths of their recordings, relative to
            the folder.
        spec: spec of the experiment.
        folder: folder of the experiment.
        count: requested number of recordings.
        progress: called with the numbers of recordings done and requested.
    """
    chosen = report["failures"][:count]
    (folder / FOLDER).mkdir(exist_ok=True)
    for done, failure in enumerate(chosen):
        progress(done, len(chosen))
        failure["recording"] = f"{FOLDER}/{failure['unit_id']}.rrd"
        if not (folder / failure["recording"]).is_file():
            _record(spec.unit(failure["cell"], failure["index"]), failure["unit_id"], folder)
    progress(len(chosen), len(chosen))


def _record(unit: "UnitSpec", unit_id: str, folder: Path) -> None:
    from dslab.experiments.eq1.trial import record_unit

    def write(path: Path) -> None:
        add_paths(folder, unit_id, paths_of(record_unit(unit, path)))

    write_file(folder / FOLDER / f"{unit_id}.rrd", write)
