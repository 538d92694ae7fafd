"""``dslab experiment`` for experiments on claims of the paper: what the commands print of them."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dslab.experiments.cli.console import (
    number,
    print_error_line,
    print_json_line,
    print_rows,
    print_yaml,
    progress_bars,
    say,
)
from dslab.experiments.cli.units import unit_progress
from dslab.scenarios.errors import InputError, MachineError


def claim_rows() -> list[dict[str, Any]]:
    """The presets, a row each for ``dslab experiment list``."""
    from dslab.experiments.claims.kinds import KINDS
    from dslab.experiments.claims.loading import claim_presets, load_claim
    from dslab.experiments.cli.experiment_specs import first_part, in_words

    rows = []
    for name in claim_presets():
        spec = load_claim(name)
        units = len(KINDS[spec.kind].units(spec))
        takes = None if spec.unit_s is None else in_words(units * spec.unit_s)
        told = f"Sec. {spec.section}: {first_part(spec.description)}"
        rows.append({"experiment": name, "units": units, "takes": takes, "what it is": told})
    return rows


def claim_folder_row(folder: Path) -> dict[str, Any]:
    """A folder, for ``dslab experiment list``."""
    from dslab.experiments.claims.folder import read_claim

    found = read_claim(folder)
    state = "finished" if found.done == found.total else "not finished"
    units = f"{found.done} / {found.total}"
    return {"folder": folder, "experiment": found.spec.name, "state": state, "units": units}


def show_claim(experiment: str) -> None:
    """Print the file of an experiment, with what it is above it."""
    from dslab.experiments.campaign.folder import SPEC_FILE
    from dslab.experiments.claims.folder import read_claim
    from dslab.experiments.claims.kinds import KINDS
    from dslab.experiments.claims.loading import PRESET_DIR, claim_presets, load_claim
    from dslab.scenarios.input_files import SETTINGS_BYTES, is_folder, read_text

    spec, path = load_claim(experiment), Path(experiment)
    if experiment in claim_presets():
        path = PRESET_DIR / f"{experiment}.yaml"
    units = len(KINDS[spec.kind].units(spec))
    lines = [f"{spec.name}: {units} units in {spec.worlds} worlds, {len(spec.cells)} conditions"]
    lines += [f"Sec. {spec.section}: {' '.join(spec.claim.split())}"]
    if is_folder(path):
        found = read_claim(path)
        lines += [f"{found.done} of {found.total} units are done"]
        path = path / SPEC_FILE
    text = read_text(path, SETTINGS_BYTES, "check the path")
    print_yaml("".join(f"# {line}\n" for line in lines) + text)


def run_claim_command(
    experiment: str,
    out_dir: Path,
    worlds: int | None,
    workers: tuple[int | None, str | None, float, int],
    last_first: bool,
    rerun_damaged: bool,
    as_json: bool,
) -> None:
    """Run or resume; ``workers`` are their number, scheduler, and limits of time and memory of a unit."""
    from dslab.experiments.claims.loading import load_claim
    from dslab.experiments.claims.runner import run_claim
    from dslab.experiments.jobs.pool import PoolSettings
    from dslab.experiments.runs.provenance import usable_cores

    spec = load_claim(experiment)
    if worlds is not None:
        spec = spec.model_copy(update={"worlds": worlds})
    count, scheduler, time_s, memory_mb = workers
    settings = PoolSettings(count or usable_cores(), scheduler, time_s, memory_mb or None)
    with unit_progress(spec.name, out_dir, lambda tally: f"{tally.errors} errors") as show:
        tally = run_claim(spec, out_dir, settings, show, last_first, rerun_damaged)
    if tally.errors and not tally.done:
        problem = f"all {tally.errors} units ended in an error: {tally.cause}"
        raise MachineError(str(out_dir), problem, "mend it and run the same command again")
    if as_json:
        claim_status(out_dir, as_json=True)
        return
    say(f"{tally.done} of {tally.total} units")
    if tally.errors:
        print_error_line(f"{tally.errors} units ended in an error, most: {tally.cause}; run it again")
    say(f"next: dslab experiment report {out_dir}")


def claim_status(folder: Path, as_json: bool) -> None:
    """Print the progress of an experiment."""
    from dslab.experiments.claims.folder import read_claim

    found = read_claim(folder)
    if as_json:
        told = asdict(found) | {"spec": found.spec.name, "rows": len(found.rows)}
        print_json_line({**told, "spec_hash": found.spec.content_hash})
        return
    finished = ", finished" if found.done == found.total else ""
    spent = "" if found.wall_s is None else f", {number(found.wall_s / 3600, 2)} h of worker time"
    say(f"{found.spec.name}: {found.done} of {found.total} units{finished}, {len(found.rows)} rows{spent}")
    for message in found.messages:
        say(f"ended in an error: {message}")
    if len(found.codes) > 1:
        say(f"units were run with {len(found.codes)} versions of the code: {', '.join(found.codes)}")


def claim_report(folder: Path) -> None:
    """Write the report of an experiment and print the answer."""
    from dslab.experiments.claims.report import FIGURES_FILE, PLOT, write_claim_report

    with progress_bars() as show:
        show("figures", 0, 1)
        figures = write_claim_report(folder)
    say(f"Sec. {figures['section']}: {' '.join(figures['claim'].split())}")
    units = figures["units"]
    look = ", a look" if figures["is_look"] else ""
    say(f"{figures['worlds']} worlds{look}, {units['done']} of {units['total']} units")
    print_answer(figures.get("answer", ()))
    say(f"figures in {folder / FIGURES_FILE}, plot in {folder / PLOT}.svg")


def claim_replay(folder: Path, unit: str | None, recording: Path | None) -> bool:
    """Measure a unit again, compare it with its rows, and record it; True unless it differs."""
    from dslab.experiments.claims.replay import replay_claim

    if unit is None:
        raise InputError("UNIT", "is missing", "give its number, as `unit` in table.parquet and figures.json")
    with progress_bars() as show:
        show(f"unit {unit}", 0, 1)
        found, differing, has_rows = replay_claim(folder, unit, recording)
    told = ", ".join(f"{name} {value}" for name, value in found.items())
    say(f"unit {unit}: {told}")
    say(
        f"differs in {', '.join(differing)}"
        if differing
        else "agrees with its rows"
        if has_rows
        else "no rows yet"
    )
    if recording is not None:
        say(f"open it: dslab view {recording}")
    return not differing


def print_answer(answer: Sequence[Any]) -> None:
    """Print sentences, and tables of rows."""
    for part in answer:
        if isinstance(part, str):
            say(part)
        else:
            print_rows(part)


def refuse_claim(folder: Path | str, command: str) -> None:
    """Refuse a command that experiments on claims do not have.

    Raises:
        InputError: the folder is that of one.
    """
    from dslab.experiments.claims.loading import is_claim

    if is_claim(folder):
        problem = f"is of an experiment on a claim, which has no `{command}`"
        raise InputError(str(folder), problem, "use run, status or report")
