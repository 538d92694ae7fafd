"""The systems of a batch against the doses of its stress, as a table and a plot."""

from pathlib import Path
from typing import Any

import pandas as pd

from dslab.experiments.batch.doses import DoseSeries
from dslab.experiments.batch.paper_figures import FIGURES_DIR
from dslab.experiments.batch.rows import CONTENT, ERROR
from dslab.experiments.comparison.dose_response import (
    dose_response,
    dose_table,
    dose_title,
    draw_dose_response,
)
from dslab.experiments.report.plots.draw import rendered
from dslab.experiments.report.plots.style import WIDE_IN, settings
from dslab.sim.io.folders import subfolder, write_file

DOSE_FILE, DOSE_PLOT = "dose_response.csv", "dose_response"


def write_dose_response(rows: pd.DataFrame, series: DoseSeries, folder: Path) -> list[dict[str, Any]]:
    """Write every system against the dose, as a table and a plot, into the folder of a batch.

    Args:
        rows: of :func:`experiments.batch.run.run_batch`.
        series: of its spec.
        folder: of the batch.

    Returns:
        The points, see :func:`experiments.comparison.dose_response.dose_response`.
    """
    made = rows[rows.ended != ERROR]
    table = made.astype(object).where(made.notna(), None).assign(sequence=made[CONTENT])
    points = dose_response(table.to_dict("records"))
    if not points:
        return []
    write_file(folder / DOSE_FILE, lambda path: dose_table(points).to_csv(path, index=False))
    with settings():
        figure = draw_dose_response(points, dose_title(*series.about), WIDE_IN)
        rendered(DOSE_PLOT, "", figure).write(subfolder(folder, FIGURES_DIR))
    return points
