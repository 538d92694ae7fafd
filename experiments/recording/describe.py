"""Text of events."""

from slam.core.events import Event

_LEVELS = {"breakage": "ERROR", "map_dropped": "WARN"}


def describe_event(event: Event) -> tuple[str, str]:
    """Text and log level of an event: time, frame, kind, non-empty fields.

    Lists are given by their length.
    """
    fields = event.record()
    kind, frame, stamp_s = fields.pop("event"), fields.pop("frame"), fields.pop("stamp_s")
    level = _LEVELS.get(kind, "INFO")
    if fields.get("success") is False or fields.get("accepted") is False:
        level = "WARN"
    details = ", ".join(f"{name} {_value(v)}" for name, v in fields.items() if v not in ("", None, []))
    return f"{stamp_s:.2f} s  frame {frame}  {kind.replace('_', ' ')}: {details}", level


def _value(value: object) -> str:
    if isinstance(value, list):
        return str(len(value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)
