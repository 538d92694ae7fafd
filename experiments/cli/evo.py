"""``dslab evo``: errors of finished runs beside results of evo."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dslab.experiments.cli.console import JsonOption, number, print_json_line, print_rows, say
from dslab.scenarios.errors import InputError

if TYPE_CHECKING:
    from dslab.experiments.evaluation.evo_result import EvoResult

_ZIP = ".zip"
_SHOWN = ("rmse", "mean", "median", "std", "max")


def evo_command(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="SOURCE...",
            help="Result folders of runs, folders that hold some, or result files of evo (.zip), mixed.",
        ),
    ],
    out_dir: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for a result file of every run, for evo_res.", show_default=False),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show ATE of finished runs beside results of evo, or write it as such.

    The errors are those of evo_ape tum -as: of the positions, after Sim(3) alignment. For example:

    `dslab evo out/mine theirs.zip`
    """
    from dslab.experiments.comparison.left_runs import find_runs
    from dslab.experiments.evaluation.alignment import Undefined
    from dslab.experiments.evaluation.evo_result import ate_result, read_evo_result, write_evo_result
    from dslab.sim.io.folders import new_directory

    zips = [source for source in sources if source.suffix.lower() == _ZIP]
    folders = [source for source in sources if source not in zips]
    if out_dir is not None and not folders:
        raise InputError("--out", "results of evo are there already", "leave it out, or name a folder")
    runs = find_runs(folders) if folders else []
    names = _names([*(run.folder for run in runs), *(path.with_suffix("") for path in zips)])
    own: dict[str, EvoResult] = {}
    for name, run in zip(names, runs, strict=False):
        result = ate_result(run.pairs, run.stamps_s[run.pairs.frames], name, run.sequence)
        if isinstance(result, Undefined):
            raise InputError(str(run.folder), f"has no ATE: {result.reason}", "leave it out")
        own[name] = result
    results = own | {name: read_evo_result(path) for name, path in zip(names[len(runs) :], zips, strict=True)}
    if out_dir is not None:
        with new_directory(out_dir) as folder:
            for name, result in own.items():
                write_evo_result(folder / f"{name}{_ZIP}", result)
    if as_json:
        print_json_line({name: {**r.stats, "poses": len(r.errors)} for name, r in results.items()})
        return
    print_rows(
        {"result": name, "error": r.info.get("label", ""), "poses": len(r.errors)}
        | {figure: number(r.stats[figure], 4) for figure in _SHOWN}
        for name, r in results.items()
    )
    if out_dir is not None:
        say(f"evo_res {out_dir}/*{_ZIP}")


def _names(places: list[Path]) -> list[str]:
    """Names of results: the last parts of their paths, as many as tell them apart.

    Raises:
        InputError: two are the same.
    """
    whole = [place.resolve().parts[1:] for place in places]
    for count in range(1, max(map(len, whole)) + 1):
        names = ["-".join(parts[-count:]) for parts in whole]
        if len(set(names)) == len(names):
            return names
    double = next(place for place in places if whole.count(place.resolve().parts[1:]) > 1)
    raise InputError(str(double), "is given twice", "name it once")
