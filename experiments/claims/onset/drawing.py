"""The figure of an onset experiment: how long maps are wrong before their loss, and what becomes of them."""

from typing import TYPE_CHECKING, Any

import numpy as np

from dslab.experiments.claims.onset.judged import WRONG
from dslab.experiments.claims.onset.unit import OnsetSpec
from dslab.experiments.eq1.records import SHAM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw(spec: OnsetSpec, figures: dict[str, Any], width_in: float) -> "Figure":
    """Draw a row per system.

    On the left the share of breakages whose map had been wrong for at most so long, by kind of stress; a
    curve begins at the share whose map was right to the end. The placebo is maps without stress at random
    times. On the right what became of the units, by kind of stress.
    """
    from matplotlib.patches import Patch

    from dslab.experiments.report.plots.style import columns_that_fit, legend_above, panels, wrapped

    systems = figures["systems"]
    figure, axes = panels(2 * len(systems), 2, width_in, 3.4, 0.9)
    least = f"{spec.before_s[0]:g}"
    for place, (system, found) in enumerate(systems.items()):
        left, right = axes[2 * place : 2 * place + 2]
        left.set_title(wrapped(f"{system}: how long wrong", width_in), fontsize=10)
        right.set_title(wrapped(f"{system}: what became of it", width_in), fontsize=10)
        _draw_delays(left, found)
        _draw_ends(right, found["stress"], least)
    handles = [Patch(color=colour, label=name) for name, colour in _parts(least).items()]
    legend_above(figure, handles, columns_that_fit(handles, width_in), width_in)
    return figure


def _draw_delays(axes: "Axes", found: dict[str, Any]) -> None:
    from dslab.experiments.pictures.labels import label
    from dslab.experiments.report.plots.style import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, percent_axis
    from dslab.scenarios.describe import describe_kind

    styles = [(colour, line) for line in ("-", ":") for colour in (BLUE, ORANGE, GREEN, PURPLE, SKY)]
    curves = [
        (describe_stress(stress, describe_kind), seconds, *style)
        for (stress, seconds), style in zip(found["delays"].items(), styles, strict=False)
    ]
    placebo = found["placebo"][WRONG]["seconds"]
    longest_s = max((s for _, seconds, *_ in [*curves, ("", placebo)] for s in seconds), default=1.0)
    for name, seconds, colour, line in [*curves, ("placebo", placebo, GREY, "--")]:
        if not seconds:
            continue
        at_s = np.concatenate([[0.0], np.sort(seconds), [2 * max(longest_s, 1.0)]])
        share = np.array([(np.asarray(seconds) <= s).mean() for s in at_s])
        axes.step(
            at_s, share, where="post", color=colour, linestyle=line, label=label(f"{name} ({len(seconds)})")
        )
    axes.set_xscale("symlog", linthresh=0.1)
    axes.set_xticks([0, 0.1, 0.5, 1, 2, 5, 10], ["0", ".1", ".5", "1", "2", "5", "10"])
    axes.set_xlim(0, 1.1 * max(longest_s, 1.0))
    axes.set_ylim(-0.02, 1.03)
    percent_axis(axes.yaxis)
    axes.tick_params(labelsize=8)
    axes.set_xlabel("wrong before the declared loss for at most, s", fontsize=8)
    axes.set_ylabel("share of breakages", fontsize=8)
    axes.legend(fontsize=7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.18))


def _draw_ends(axes: "Axes", groups: dict[str, Any], least: str) -> None:
    from dslab.experiments.report.plots.style import percent_axis
    from dslab.scenarios.describe import describe_kind

    shown = [(name, of) for name, of in groups.items() if name != "all" and of["broke"]]
    for line, (_, of) in enumerate(shown):
        start = 0.0
        for size, colour in zip(_ends(of, least), _parts(least).values(), strict=True):
            axes.barh(line, size, left=start, color=colour, height=0.7, linewidth=0)
            start += size
    names = [f"{describe_stress(name, describe_kind)} ({of['broke']['units']})" for name, of in shown]
    axes.set_yticks(range(len(shown)), names, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0, 1)
    percent_axis(axes.xaxis)
    axes.tick_params(axis="x", labelsize=8)
    axes.set_xlabel("share of units", fontsize=8)
    axes.grid(visible=False, axis="y")


def _parts(least: str) -> dict[str, str]:
    """Colour of what becomes of a unit."""
    from dslab.experiments.report.plots.style import BLUE, GREY, ORANGE, PALE, PURPLE

    return {
        f"map wrong > {least} s before its loss": ORANGE,
        f"map wrong {least} s or less": PURPLE,
        "map right, view fails": BLUE,
        "wrong or lost in silence": GREY,
        "right to the end": PALE,
    }


def _ends(of: dict[str, Any], least: str) -> list[float]:
    """What became of the units of a group, as shares of all of them."""
    broke = of["broke"]["value"]
    wrong = of[WRONG]["before_declared"][least]
    early = broke * wrong["value"] if wrong else 0.0
    right = broke * of[WRONG]["view_fails"]["value"] if wrong else 0.0
    silent = (1 - broke) * of["silent"]["value"] if of["silent"] else 0.0
    return [early, broke - early - right, right, silent, 1 - broke - silent]


def describe_stress(stress: str, describe: Any) -> str:
    """Name a kind of stress, with ``creeping`` before it and ``no stress`` for none."""
    if stress == SHAM:
        return "no stress"
    kind = stress.removesuffix("-creeping")
    return describe(kind) if kind == stress else f"creeping {describe(kind)}"
