"""``dslab demo``."""

from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from experiments.cli.console import ForceOption, number, out, progress_bars, share, single_threaded_opencv

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
    from experiments.demo import MARKER_FILE, PICTURE_FILE, run_demo
    from experiments.result_folder import RECORDING_FILE
    from scenarios.loading import load_scenario
    from sim.io.folders import check_free
    from sim.sequence_rendering import render_sequence

    check_free(out_dir, MARKER_FILE)
    single_threaded_opencv()
    spec = load_scenario(scenario, seed)
    with progress_bars() as show:
        sequence = render_sequence(spec, progress=show, force=force)
        summaries = run_demo(sequence, spec.seed, out_dir, show)
    title = f"{spec.name}, seed {spec.seed}, {spec.duration_s:g} s, {len(sequence)} frames"
    out.print(demo_table(summaries, title))
    out.print(f"picture    {out_dir / PICTURE_FILE}", soft_wrap=True)
    out.print(f"recording  {out_dir / RECORDING_FILE}  (open it: dslab view {out_dir})", soft_wrap=True)
    for kind in summaries:
        out.print(f"{kind:10s} {out_dir / kind}", soft_wrap=True)


def demo_table(summaries: dict, title: str) -> Table:
    """Table with one row per system and one per injected segment."""
    table = Table(title=title, box=box.SIMPLE, show_edge=False, padding=(0, 1, 0, 0))
    table.add_column("")
    for column in ("tracked", "with\npose", "breakages", "recovered", "relocalized", "ATE"):
        table.add_column(column, justify="right", no_wrap=True)
    for kind, summary in summaries.items():
        table.add_section()
        table.add_row(Text(kind, "bold"), *_cells(summary, summary["ate_m"], summary["ate_poses"]))
        for segment in summary["segments"]:
            part = f"{segment['kind'].replace('_', ' ')} {segment['start_s']:g}-{segment['end_s']:g} s"
            table.add_row(f" {part}", *_cells(segment, segment["ate_m"], segment["ate_frames"]))
    table.caption = (
        "Tracked: frames with a live pose. With pose: frames with a final pose in the\n"
        "largest map; ATE: their RMSE after Sim(3) alignment. Recovered: the maps were\n"
        f"fused. A breakage up to {_grace_s():g} s after a segment counts for the segment."
    )
    return table


def _cells(part: dict, ate_m: float | None, posed: int | None) -> list[str]:
    frames = part["frames"]
    return [
        share(part["tracked"] / frames if frames else None),
        share((posed or 0) / frames if frames else None),
        str(part["breakages"]),
        str(part["recoveries"]),
        str(part["relocalizations"]),
        number(ate_m, 3, " m"),
    ]


def _grace_s() -> float:
    from experiments.evaluation.breakages import EXPOSURE_GRACE_S

    return EXPOSURE_GRACE_S
