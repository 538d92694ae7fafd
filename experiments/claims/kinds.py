"""The kinds of experiments on claims, by the ``kind`` of their spec."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dslab.experiments.claims import belief, belief_figures, two_view, two_view_figures
from dslab.experiments.claims.onset import drawing as onset_drawing
from dslab.experiments.claims.onset import figures as onset_figures
from dslab.experiments.claims.onset import unit as onset
from dslab.experiments.claims.spec import Row, Unit
from dslab.experiments.claims.variants.draw import draw as draw_variants
from dslab.experiments.claims.variants.figures import figures as variants_figures
from dslab.experiments.claims.variants.measure import measure as measure_variants
from dslab.experiments.claims.variants.measure import units as variants_units
from dslab.experiments.claims.variants.spec import VariantsSpec

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Kind:
    """What is measured, in units of which each is one job, and what is made of the rows.

    Attributes:
        spec: the class of its specs, a ``ClaimSpec`` with the literal of its name.
        units: of a spec, in order.
        measure: rows of a unit, which depend on spec and unit only; pickled by its name.
        figures: of a spec and the table of all rows, JSON data: every number with interval and number of
            worlds; its ``answer``, a list of sentences, is printed.
        draw: the figure of a spec and its figures, of a width in inches.
        record: runs a unit and writes a recording for ``dslab view``; None if there is nothing to see.
    """

    spec: type[Any]
    units: Callable[[Any], list[Unit]]
    measure: Callable[[Any, Unit], list[Row]]
    figures: "Callable[[Any, pd.DataFrame], dict[str, Any]]"
    draw: "Callable[[Any, dict[str, Any], float], Figure]"
    record: Callable[[Any, Unit, Path], None] | None = None


KINDS: dict[str, Kind] = {
    "two_view": Kind(
        two_view.TwoViewSpec,
        two_view.units,
        two_view.measure,
        two_view_figures.figures,
        two_view_figures.draw,
    ),
    "onset": Kind(
        onset.OnsetSpec,
        onset.units,
        onset.measure,
        onset_figures.figures,
        onset_drawing.draw,
        onset.record_unit,
    ),
    "belief": Kind(
        belief.BeliefSpec, belief.units, belief.measure, belief_figures.figures, belief_figures.draw
    ),
    "variants": Kind(VariantsSpec, variants_units, measure_variants, variants_figures, draw_variants),
}
