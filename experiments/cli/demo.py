"""``dslab demo``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dslab.experiments.cli.console import (
    ForceOption,
    out,
    print_facts,
    print_rows,
    progress_bars,
    share,
    single_threaded_opencv,
)

if TYPE_CHECKING:
    from dslab.experiments.eq1.spec import ExperimentSpec
    from dslab.experiments.statistics.judged import JudgedCell

SCENARIO, SEED = "demo", 4
"""Both stood before the first run; what it shows stands in docs/first-steps.md."""
EXPERIMENT = "demo"
"""Preset whose units it runs."""


def demo_command(
    out_dir: Annotated[
        Path,
        typer.Option("--out", metavar="DIR", help="Result folder; an earlier demonstration is replaced."),
    ] = Path("out/demo"),
    no_units: Annotated[bool, typer.Option("--no-units", help="Leave out the second part.")] = False,
    force: ForceOption = False,
) -> None:
    """Break monocular SLAM on purpose, and see what Dual-SLAM makes of it: two to three minutes.

    First part: base (ORB-SLAM's method), dual+ (Dual-SLAM, initialized by GMS) and ldso (direct sparse
    odometry with loops) run over one rendered scenario with low texture, motion blur and fast rotation.
    Written: a folder per system, a picture, a recording for the viewer.

    Second part: eight small units of an experiment on Eq. 1, the paper's prediction of how often base and
    recovery both fail. Each has a world of its own. They are too few to decide anything.

    For example:

    `dslab demo --out out/demo`
    """
    from dslab.experiments.cli.run_tables import print_runs
    from dslab.experiments.demo import EXPERIMENT_DIR, MARKER_FILE, run_demo
    from dslab.experiments.eq1.spec import load_spec
    from dslab.experiments.result_folder import PICTURE_FILE, RECORDING_FILE
    from dslab.scenarios.loading import load_scenario
    from dslab.sim.io.folders import check_free
    from dslab.sim.sequence_rendering import render_sequence

    check_free(out_dir, MARKER_FILE)
    single_threaded_opencv()
    experiment = None if no_units else load_spec(EXPERIMENT)
    with progress_bars() as show:
        sequence = render_sequence(load_scenario(SCENARIO, SEED), progress=show, force=force)
        summaries, cells = run_demo(sequence, SEED, out_dir, experiment, progress=show)
    print_runs(summaries)
    for name in dict.fromkeys(cell.cell for cell in cells):
        assert experiment is not None
        _print_units([cell for cell in cells if cell.cell == name], experiment)
    units = out_dir / EXPERIMENT_DIR
    print_facts(
        {
            "picture": out_dir / PICTURE_FILE,
            "recording": f"{out_dir / RECORDING_FILE}  (open it: dslab view {out_dir})",
            **{kind: out_dir / kind for kind in summaries},
            **({"units": f"{units}  (all: dslab experiment report {units})"} if cells else {}),
        }
    )


def _print_units(levels: Sequence["JudgedCell"], experiment: "ExperimentSpec") -> None:
    """Predicted and measured shares of dual failures in one cell, a row for each number of threads."""
    from dslab.scenarios.describe import describe_field, describe_kind

    cell, kinds = levels[0], [thread.kind for thread in experiment.threads]
    of_cell = experiment.cells[cell.cell]
    assert of_cell.degradation is not None and of_cell.dose is not None
    degradation = experiment.degradations[of_cell.degradation]
    dose = describe_field(degradation.dose, degradation.doses_of(of_cell.base)[of_cell.dose])
    print_rows(
        (
            {
                "n": level.n,
                "recovery threads": ", ".join(kinds[: level.n]),
                "predicted": share(level.eq1),
                "measured": share(level.measured.value),
                "95 % interval": f"{100 * level.measured.low:.0f} to {100 * level.measured.high:.0f} %",
            }
            for level in levels
        ),
        f"Eq. 1 in {cell.units} units of {describe_kind(cell.kind)}, {dose}",
    )
    broke, *failed = levels[-1].worlds_with
    threads = ", ".join(f"thread {j} failed in {count}" for j, count in enumerate(failed, 1))
    out.print(
        "Share of units in which the base broke and all n recovery threads failed. Eq. 1 predicts it as if "
        f"these were independent, p0 · pr1 … prn: of {cell.worlds} worlds the base broke in {broke}; made to "
        f"cross the same images in every unit, {threads}. No verdict: too few worlds to decide."
    )
