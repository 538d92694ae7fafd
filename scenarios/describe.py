"""Descriptions of scenarios: fields with units, segments, world, motion, camera."""

from typing import Any

from dslab.scenarios.segments import SegmentBase
from dslab.scenarios.spec import Scenario

# Longest endings first: `max_accel_mps2` is no number of seconds.
_UNITS = {
    "_per_m": " /m",
    "_degps": " °/s",
    "_mmph": " mm/h",
    "_mps2": " m/s²",
    "_mps": " m/s",
    "_deg": "°",
    "_px": " px",
    "_mm": " mm",
    "_hz": " Hz",
    "_e": " e⁻",
    "_m": " m",
    "_s": " s",
}
# Names that are units themselves.
_BARE_UNITS = {"stops": " stops", "fps": " frames/s"}


def describe_field(name: str, value: Any) -> str:
    """Describe a field: ``exposure 0.25 s`` for ``exposure_s`` and 0.25."""
    label, unit = label_and_unit(name)
    return f"{plain(value)}{unit}" if name in _BARE_UNITS else f"{label} {plain(value)}{unit}"


def describe_kind(kind: str) -> str:
    """Describe a kind of segment, world or motion."""
    return kind.replace("_", " ")


def plain(value: Any) -> str:
    """Format a value with four digits."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
    return str(value).replace("_", " ")


def measured(value: float) -> str:
    """Format a measured value with three digits."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def describe_severity(segment: SegmentBase) -> str:
    """Describe the severity of a segment in physical units."""
    return ", ".join(
        describe_field(name, value)
        for name, value in segment.severity.items()
        if not (name in ("ramp_s", "fall_s") and not value)
    )


def describe_span(segment: SegmentBase) -> str:
    """Describe the time of a segment."""
    return f"{segment.start_s:.4g} to {segment.end_s:.4g} s"


def describe_world(scenario: Scenario) -> str:
    """Describe the world and its sizes; fields that are not set are left out."""
    return _with_fields(scenario.world.kind, scenario.world.model_dump(exclude={"kind"}))


def describe_motion(scenario: Scenario) -> str:
    """Describe the motion and its limits; fields of 0 are left out."""
    fields = scenario.trajectory.model_dump(exclude={"kind"})
    return _with_fields(scenario.trajectory.kind, {name: value for name, value in fields.items() if value})


def describe_camera(scenario: Scenario) -> str:
    """Describe the camera."""
    camera = scenario.camera
    parts = [
        f"{camera.width_px} × {camera.height_px} px",
        f"{camera.fps:g} frames/s",
        f"focal length {camera.fx_px:.4g} × {camera.fy_px:.4g} px",
        f"exposure {1000 * camera.exposure_s:.3g} ms",
        f"noise {camera.noise_sigma:.3g} grey levels",
    ]
    if camera.distortion.model != "none":
        parts.append(f"{camera.distortion.model} distortion")
    if camera.shot_noise:
        parts.append(f"shot noise {camera.shot_noise:.3g} grey levels")
    if camera.softness_px:
        parts.append(f"softness {camera.softness_px:.3g} px")
    if camera.contrast != 1:
        parts.append(f"contrast {camera.contrast:.3g}")
    if camera.residual:
        parts.append(f"calibration error {camera.residual.k1:.3g}, {camera.residual.k2:.3g}")
    return f"{camera.preset}: {', '.join(parts)}" if camera.preset else ", ".join(parts)


def label_and_unit(name: str) -> tuple[str, str]:
    """Split a field's name: ``exposure`` and `` s`` for ``exposure_s``."""
    for ending, unit in _UNITS.items():
        if name.endswith(ending):
            return name.removesuffix(ending).replace("_", " "), unit
    return name.replace("_", " "), _BARE_UNITS.get(name, "")


def _with_fields(kind: str, fields: dict[str, Any]) -> str:
    given = (_described(name, value) for name, value in fields.items() if value is not None)
    return ", ".join([describe_kind(kind), *given])


def _described(name: str, value: Any) -> str:
    """A field, or a group of fields: ``aliased: things 0.4, places 0.8``."""
    if not isinstance(value, dict):
        return describe_field(name, value)
    return f"{describe_kind(name)}: " + ", ".join(describe_field(key, one) for key, one in value.items())
