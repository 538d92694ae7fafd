"""Files of a claim's report: table.parquet, figures.json, figure.svg and figure.png."""

from functools import partial
from pathlib import Path
from typing import Any

from dslab.experiments.claims.folder import arrow_table, read_claim, write_table
from dslab.experiments.claims.kinds import KINDS
from dslab.experiments.claims.spec import ENOUGH_WORLDS
from dslab.experiments.jobs.ledger import LEDGER_FILE
from dslab.experiments.report.plots.draw import rendered
from dslab.experiments.report.plots.style import WIDE_IN, settings
from dslab.experiments.report.write import says_the_same
from dslab.experiments.runs.files import plain, to_json
from dslab.scenarios.errors import InputError
from dslab.scenarios.input_files import is_given
from dslab.sim.io.folders import write_file

FIGURES_FILE, PLOT = "figures.json", "figure"


def write_claim_report(folder: Path) -> dict[str, Any]:
    """Write table, figures and plot into the folder of an experiment, and return the figures.

    The figures follow from spec and table alone, so that a folder with only these two gives the same.

    Raises:
        InputError: it is not such a folder, holds no rows yet, or cannot be written.
    """
    claimed = read_claim(folder)
    spec, kind = claimed.spec, KINDS[claimed.spec.kind]
    if not claimed.rows:
        raise InputError(str(folder), "holds no rows yet", "try again when a unit has ended")
    table = arrow_table(claimed.rows).to_pandas()
    worlds = int(table["world"].nunique())
    figures = plain(
        {
            "experiment": spec.name,
            "claim": spec.claim,
            "section": spec.section,
            "worlds": worlds,
            "is_look": worlds < ENOUGH_WORLDS,
            "units": {"done": claimed.done, "total": claimed.total},
            **kind.figures(spec, table),
        }
    )
    if is_given(folder / LEDGER_FILE):
        write_table(folder, claimed)
    if not says_the_same(folder / FIGURES_FILE, figures):
        text = to_json(figures, indent=1) + "\n"
        write_file(folder / FIGURES_FILE, partial(Path.write_text, data=text, encoding="utf-8"))
    with settings():
        rendered(PLOT, spec.claim, kind.draw(spec, figures, WIDE_IN)).write(folder)
    return figures
