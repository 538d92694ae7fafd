"""``dslab demo``."""

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.console import ForceOption, out, progress_bars, single_threaded_opencv

SCENARIO = "breakage"
"""Default scenario of the demonstration."""


def demo_command(
    out_dir: Annotated[
        Path, typer.Option("--out", help="Result folder; an earlier demonstration is replaced.")
    ] = Path("out/demo"),
    scenario: Annotated[str, typer.Option(help="Scenario: a name or a YAML file.")] = SCENARIO,
    seed: Annotated[int | None, typer.Option(min=0, help="Root seed; default: that of the scenario.")] = None,
    force: ForceOption = False,
) -> None:
    """Render a scenario that breaks the base, run base and Dual-SLAM, and show the results.

    For example:

    `dslab demo --out out/demo`
    """
    from experiments.cli.run_tables import print_runs
    from experiments.demo import MARKER_FILE, run_demo
    from experiments.result_folder import PICTURE_FILE, RECORDING_FILE
    from scenarios.loading import load_scenario
    from sim.io.folders import check_free
    from sim.sequence_rendering import render_sequence

    check_free(out_dir, MARKER_FILE)
    single_threaded_opencv()
    spec = load_scenario(scenario, seed)
    with progress_bars() as show:
        sequence = render_sequence(spec, progress=show, force=force)
        summaries = run_demo(sequence, spec.seed, out_dir, show)
    print_runs(summaries)
    out.print(f"picture    {out_dir / PICTURE_FILE}", soft_wrap=True)
    out.print(f"recording  {out_dir / RECORDING_FILE}  (open it: dslab view {out_dir})", soft_wrap=True)
    for kind in summaries:
        out.print(f"{kind:10s} {out_dir / kind}", soft_wrap=True)
