"""``dslab experiment boundary``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from dslab.experiments.cli.console import (
    JsonOption,
    SeedOption,
    SystemsOption,
    print_json_line,
    progress_bars,
    say,
)
from dslab.experiments.cli.units import (
    MEMORY_MB,
    TIMEOUT_S,
    CoresOption,
    MemoryOption,
    RerunDamagedOption,
    RetryErrorsOption,
    TimeoutOption,
    unit_progress,
)

if TYPE_CHECKING:
    from dslab.experiments.campaign.boundary_schedule import BoundarySchedule
    from dslab.experiments.campaign.runner import Tally
    from dslab.experiments.eq1.boundary_plan import BoundaryPlan


def boundary_command(
    kind: Annotated[
        str, typer.Argument(metavar="KIND", help="Kind of stress; KIND-creeping for one that rises slowly.")
    ],
    of: Annotated[
        Literal["breakage", "dual", "system", "mission", "recovery"],
        typer.Option(
            help="breakage: tracking breaks (B); dual: and every thread fails (D); system: what a user gets "
            "(S); mission: that, or silently or falsely wrong (M); recovery: thread 1 does not cross (R_1)."
        ),
    ],
    fail: Annotated[float, typer.Option(metavar="P", help="Probability of failure at the dose sought.")],
    out_dir: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the search.")],
    spec: Annotated[
        str, typer.Option(metavar="NAME|SPEC.yaml", help="Experiment whose units are the trials.")
    ] = "eq1",
    world: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Its kind of world and of motion, one of its `bases`; default: the first."
        ),
    ] = None,
    system: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="System that fails: of `dslab systems list`, or module:Class; default: that of the spec.",
        ),
    ] = None,
    systems_dir: SystemsOption = None,
    trials: Annotated[int, typer.Option(min=2, help="Number of trials, each in a world of its own.")] = 60,
    sham: Annotated[int, typer.Option(min=1, help="Of these, trials without stress, which come first.")] = 8,
    batch: Annotated[
        int, typer.Option(min=1, max=8, help="Trials whose doses are chosen together: busy workers at most.")
    ] = 4,
    dose: Annotated[
        str | None, typer.Option(metavar="FIELD", help="Field of the segment, if not that of the kind.")
    ] = None,
    weakest: Annotated[float | None, typer.Option(help="Weakest dose, if not that of the kind.")] = None,
    strongest: Annotated[
        float | None, typer.Option(help="Strongest dose; below the weakest where less is stronger.")
    ] = None,
    seed: SeedOption = None,
    workers: CoresOption = None,
    timeout: TimeoutOption = TIMEOUT_S,
    memory: MemoryOption = MEMORY_MB,
    retry_errors: RetryErrorsOption = False,
    rerun_damaged: RerunDamagedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find the dose of a stress at which a failure has a given probability.

    Every trial is a unit in a fresh world. Doses are chosen by what they are expected to tell, given all
    trials before. The folder gets a ledger, boundary.json and boundary.png; the same command goes on with it,
    also after `kill -9`, with more trials or for another probability. Doses and answer are the same for any
    number of workers. Give another seed than that of the experiment for which the dose is sought.
    For example:

    `dslab experiment boundary motion_blur --of breakage --fail 0.5 --out out/blur`

    `dslab experiment boundary low_texture --of mission --fail 0.25 --world room --trials 100 --out out/room`
    """
    from dslab.experiments.campaign.runner import run_experiment
    from dslab.experiments.campaign.workers import unit_workers
    from dslab.experiments.eq1.boundary_plan import boundary_plan
    from dslab.experiments.eq1.doses import dose_axis
    from dslab.experiments.eq1.spec import load_spec
    from dslab.experiments.report.boundary import PICTURE_FILE, searched_text, write_boundary

    axis = dose_axis(kind.removesuffix("-creeping"), dose, weakest, strongest)
    plan = boundary_plan(
        load_spec(spec), kind, of, fail, base=world, trials=trials, shams=sham, batch=batch, seed=seed or 0,
        axis=axis, system=system,
    )  # fmt: skip
    units = unit_workers(plan.spec, systems_dir or (), workers, None, timeout, memory)
    order = _Estimating(plan)
    with unit_progress(f"{kind}, {of} {fail:g}", out_dir, order.text) as show:
        tally = run_experiment(
            plan.spec, out_dir, units.open, retry_errors, rerun_damaged, show, order.schedule, units.digests
        )
    with progress_bars(kernels=False) as step:
        found = write_boundary(plan, out_dir, lambda done, total: step("measuring the dose", done, total))
    if as_json:
        print_json_line(found)
        return
    say(found["answer"])
    sham_trials = found["sham"]
    given_up = f", {tally.errors} given up for: {tally.cause}" if tally.errors else ""
    say(
        f"{tally.done} trials in as many worlds, {tally.void} of them void{given_up}; "
        f"without stress {sham_trials['failures']} of {sham_trials['trials']} fail"
    )
    for line in searched_text(found):
        say(line)
    say(f"picture in {out_dir / PICTURE_FILE}")


class _Estimating:
    """Keeps the schedule of a run, to show what it has found so far."""

    def __init__(self, plan: "BoundaryPlan") -> None:
        self._plan = plan
        self._schedule: BoundarySchedule | None = None
        self._shown = (-1, "")

    def schedule(self, _experiment: Any, rows: Any) -> "BoundarySchedule":
        from dslab.experiments.campaign.boundary_schedule import BoundarySchedule

        self._schedule = BoundarySchedule(self._plan, rows)
        return self._schedule

    def text(self, tally: "Tally") -> str:
        """The answer so far, void trials and errors."""
        from dslab.experiments.report.boundary import answer_text

        if self._schedule is None or tally.done <= self._plan.shams:
            return f"trials without stress, {tally.void} void"
        if self._shown[0] != tally.done:
            grid, weights = self._schedule.grid, self._schedule.posterior()
            text = answer_text(grid.boundary(weights, self._plan.level), self._plan)
            self._shown = tally.done, text.partition(": ")[2]
        return f"{self._shown[1]}, {tally.void} void" + (f", {tally.errors} errors" if tally.errors else "")
