"""Figures as text: rounded, with intervals; report.json holds them unrounded."""

from collections.abc import Callable, Sequence
from typing import Any

NONE = "–"


def percent(value: float | None) -> str:
    """Percentage of a share; small shares keep two significant digits."""
    if value is None:
        return NONE
    hundredth = 100 * value
    if hundredth == 0 or abs(hundredth) >= 0.95:
        return f"{hundredth:.1f} %"
    return f"{hundredth:.2g} %"


def number(value: float | None) -> str:
    """Figure with three significant digits; integers in full."""
    if value is None:
        return NONE
    if isinstance(value, int) or (value == int(value) and abs(value) < 1e5):
        return f"{int(value)}"
    return f"{value:.3g}".replace("e-0", "e-").replace("e+0", "e")


def metres(value: float | None) -> str:
    """Length in metres, to the centimetre."""
    return NONE if value is None else f"{value:.2f}"


def p_value(value: float | None) -> str:
    """P-value; below 0.001 only as a bound."""
    if value is None:
        return NONE
    return "< 0.001" if value < 0.001 else f"{value:.3f}" if value < 0.1 else f"{value:.2f}"


def ratio(value: float | None) -> str:
    """Ratio, to two digits behind the point at most."""
    if value is None:
        return "unbounded"
    return f"{value:.2f}" if value < 10 else f"{value:.3g}"


def proportion(share: dict[str, Any] | None) -> str:
    """Events of units and their share."""
    if share is None:
        return NONE
    if not share["units"]:
        return "0 of 0"
    return f"{share['events']} of {share['units']}: {percent(share['estimate'])}"


def ends(of: dict[str, Any]) -> str:
    """Limits of an interval."""
    return _between(of, number)


def ends_percent(of: dict[str, Any]) -> str:
    """Limits of an interval of a share."""
    return _between(of, percent)


def interval_of_share(share: dict[str, Any]) -> str:
    """Share with the ends of its interval in brackets: ``24.1 % [13.4, 34.3]``."""
    low, high = _ends(share, percent)
    return f"{percent(share['value'])} [{low.removesuffix(' %')}, {high.removesuffix(' %')}]"


def counts(values: dict[str, int]) -> str:
    """List of names, each after its count: names may end in a number."""
    return "; ".join(f"{n} × {name.replace('_', ' ')}" for name, n in values.items()) or NONE


def plural(count: int, noun: str) -> str:
    """Count with its noun."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def listed(words: Sequence[str]) -> str:
    """Words as a list in a sentence."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def _ends(of: dict[str, Any], form: Callable[[float | None], str]) -> list[str]:
    return ["unbounded" if of[end] is None else form(of[end]) for end in ("low", "high")]


def _between(of: dict[str, Any], form: Callable[[float | None], str]) -> str:
    low, high = _ends(of, form)
    return f"{low.removesuffix(' %') if high.endswith(' %') else low} to {high}"


FILTERS = {
    f.__name__: f for f in (percent, number, metres, p_value, proportion, ratio, ends, ends_percent, counts)
}
