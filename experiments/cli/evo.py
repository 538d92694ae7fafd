"""``dslab evo``: errors of trajectories beside results of evo."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from experiments.cli.console import JsonOption, number, out, print_json_line, print_table, progress_bars

if TYPE_CHECKING:
    from experiments.evaluation.evo_result import EvoResult
    from sim.sequence import Sequence

_TRAJECTORY, _ZIP = "trajectory.txt", ".zip"
_SHOWN = ("rmse", "mean", "median", "std", "max")
# As evo pairs stamps by default.
_TOLERANCE_S = 0.01


def evo_command(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE...",
            help="Result folders, trajectories in TUM form, or result files of evo (.zip), in any mixture.",
        ),
    ],
    truth: Annotated[
        str | None,
        typer.Option(
            metavar="SOURCE",
            help="Sequence folder or scenario with the true poses of the folders and trajectories.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Root seed of a scenario; its own.", show_default=False)
    ] = None,
    out_dir: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for a result file per folder or trajectory.", show_default=False),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare trajectories by ATE with results of evo, or write them as such.

    The errors are those of evo_ape tum -as: of the positions, after Sim(3) alignment. With --out the result
    files can be given to evo_res.

    For example:

    `dslab evo out/mine --truth path/to/sequence --out out/evo`

    `dslab evo out/mine theirs.zip --truth path/to/sequence`
    """
    from experiments.evaluation.evo_result import read_evo_result, write_evo_result
    from experiments.runs.sources import open_sequence
    from scenarios.errors import InputError
    from sim.io.folders import check_free, new_directory

    own = [source for source in sources if source.suffix.lower() != _ZIP]
    if own and truth is None:
        problem = "has no true poses to be compared with"
        raise InputError(str(own[0]), problem, "add --truth with its sequence folder or scenario")
    if out_dir is not None:
        if not own:
            raise InputError("--out", "results of evo are there already", "leave it out, or name a folder")
        check_free(out_dir)
    with progress_bars() as show:
        sequence = open_sequence(truth, seed, show) if truth is not None and own else None
    results: dict[str, EvoResult] = {}
    for source in sources:
        name = _name(source)
        if name in results:
            raise InputError(str(source), f"is a second one called {name}", "rename it")
        if sequence is None or source not in own:
            results[name] = read_evo_result(source)
        else:
            results[name] = _judged(source, name, sequence)
    if out_dir is not None:
        with new_directory(out_dir) as folder:
            for source in own:
                write_evo_result(folder / f"{_name(source)}{_ZIP}", results[_name(source)])
    if as_json:
        print_json_line({name: {**r.stats, "poses": len(r.errors)} for name, r in results.items()})
        return
    print_table(_table(results))
    if out_dir is not None:
        out.print(f"{out_dir}: for evo_res", soft_wrap=True)


def _name(source: Path) -> str:
    """Name of a result: of the folder, or of the file without its ending."""
    path = source.resolve()
    if path.name == _TRAJECTORY:
        return path.parent.name
    return path.name if path.is_dir() else path.stem


def _judged(source: Path, name: str, sequence: "Sequence") -> "EvoResult":
    """The errors of a trajectory or a result folder."""
    import numpy as np

    from experiments.evaluation.alignment import Undefined
    from experiments.evaluation.evo_result import ate_result
    from experiments.evaluation.metrics import PosePairs
    from scenarios.errors import InputError
    from scenarios.input_files import is_folder, is_given
    from sim.io.truth import read_tum_poses

    path = source / _TRAJECTORY if is_folder(source) else source
    if not is_given(path):
        raise InputError(str(path), "no such file", "give a result folder, a trajectory or a .zip of evo")
    true = sequence.T_world_cam
    if true is None:
        raise InputError(
            f"--truth: {sequence.name}", "has no true poses", "give a sequence with ground truth"
        )
    poses = read_tum_poses(path, sequence.stamps_s, _TOLERANCE_S)
    assert poses is not None
    frames = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)) & np.isfinite(true).all(axis=(1, 2)))
    pairs = PosePairs(frames, poses[frames], true[frames])
    result = ate_result(pairs, sequence.stamps_s[frames], name, sequence.name)
    if isinstance(result, Undefined):
        raise InputError(str(path), f"has no error: {result.reason}", "give more poses of this sequence")
    return result


def _table(results: "dict[str, EvoResult]") -> Table:
    table = Table()
    table.add_column("result")
    for name in ("error", "poses", *_SHOWN):
        table.add_column(name, justify="right")
    for name, result in results.items():
        figures = (number(result.stats[figure], 4) for figure in _SHOWN)
        table.add_row(name, str(result.info.get("label", "")), str(len(result.errors)), *figures)
    return table
