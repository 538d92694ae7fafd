"""``dslab experiment power`` and ``prove``: the statistics on simulated experiments."""

from typing import Annotated

import typer

from dslab.experiments.cli.console import (
    JsonOption,
    WorkersOption,
    number,
    print_json_line,
    print_rows,
    progress_bars,
    say,
)
from dslab.scenarios.errors import InputError


def power_command(
    p0: Annotated[float, typer.Option(help="Assumed share of units with a breakage.")],
    pr: Annotated[
        list[float], typer.Option(help="Assumed failure rate of a recovery thread; repeat for each thread.")
    ],
    ratio: Annotated[float, typer.Option(help="Ratio of measured to predicted failures to detect.")] = 2.0,
    worlds: Annotated[
        int | None, typer.Option(min=3, max=2000, help="Worlds; default: as many as the power takes.")
    ] = None,
    power: Annotated[float, typer.Option(help="Wanted probability of detection, without --worlds.")] = 0.8,
    sequences: Annotated[int, typer.Option(min=1, max=20, help="Sequences per world.")] = 1,
    replicates: Annotated[int, typer.Option(min=1, max=20, help="Replicates per sequence.")] = 3,
    icc: Annotated[float, typer.Option(help="Share of an outcome that the world determines.")] = 0.6,
    tests: Annotated[int, typer.Option(min=1, max=100, help="Tests under one Holm correction.")] = 1,
    as_json: JsonOption = False,
) -> None:
    """Simulate the tests of Eq. 1, and print their power, or the worlds that a power takes.

    For example:

    `dslab experiment power --p0 0.25 --pr 0.2 --pr 0.2 --ratio 2 --power 0.8`
    """
    from dataclasses import asdict

    from dslab.experiments.statistics.power import MOST_WORLDS, Design, power_of, worlds_needed

    design = Design(worlds or MOST_WORLDS, sequences, replicates, icc, tests)
    try:
        with progress_bars(kernels=False) as show:
            show("simulating", 0, 1)
            if worlds is None:
                found = worlds_needed(p0, tuple(pr), ratio, power, design)
            else:
                found = power_of(p0, tuple(pr), ratio, design)
    except ValueError as error:
        raise InputError("dslab experiment power", str(error), "give other assumptions") from None
    if as_json:
        print_json_line({} if found is None else asdict(found))
    elif found is None:
        say(f"more than {MOST_WORLDS} worlds would be needed")
    else:
        say(f"predicted {found.predicted:.4g}; {ratio:g} times as high: {found.measured:.4g}")
        say(
            f"{found.design.worlds} worlds: power {found.independence:.2f} of the test of independence, "
            f"{found.forecast:.2f} of the forecast (standard error {found.error:.2f})"
        )


def prove_command(
    experiments: Annotated[int, typer.Option(min=20, help="Simulated experiments per claim.")] = 2000,
    only: Annotated[str, typer.Option(metavar="TEXT", help="Only claims with this in their name.")] = "",
    workers: WorkersOption = 1,
    seed: Annotated[int, typer.Option(min=0, help="Root seed of the draws.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Simulate experiments with known answers, and print how often the statistics give them.

    The figures are the same for any number of workers. The exit code is 1 if a claim does not hold.
    For example:

    `dslab experiment prove --experiments 100`
    """
    from dataclasses import asdict

    from dslab.experiments.statistics.proofs import claims, prove

    total = sum(only in claim.name for claim in claims())
    if total == 0:
        raise InputError("--only", f"no claim has {only!r} in its name", "leave it out to see all names")
    proofs = []
    with progress_bars() as show:
        show("claims", 0, total)
        for proof in prove(experiments, seed, workers, only):
            proofs.append(proof)
            show("claims", len(proofs), total)
    if as_json:
        for proof in proofs:
            print_json_line({**asdict(proof), "holds": proof.holds()})
    else:
        print_rows(
            {
                "claim": proof.name,
                "asked": f"{number(proof.low)} to {number(proof.high)}",
                "found": number(proof.found),
                "error": number(proof.error),
                "holds": "yes" if proof.holds() else "no",
            }
            for proof in proofs
        )
    if not all(proof.holds() for proof in proofs):
        raise typer.Exit(1)
