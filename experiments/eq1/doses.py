"""The axis of the doses of every kind of stress: its field, its ends, and which way is stronger."""

from dataclasses import dataclass
from math import exp, log

from pydantic import ValidationError

from dslab.experiments.eq1.spec_parts import severity_fields
from dslab.scenarios.errors import InputError
from dslab.scenarios.faults import guess, problem_and_remedy
from dslab.scenarios.segments import SEGMENT_KINDS

DOSES = 20
"""Doses of an axis, in equal steps of their logarithm."""


@dataclass(frozen=True)
class DoseAxis:
    """The doses of a kind of stress.

    Attributes:
        field: of the segment; its unit is in its name.
        weakest, strongest: ends, both above 0. Where less is stronger, as of contrast, the weakest is the
            larger.
    """

    field: str
    weakest: float
    strongest: float

    @property
    def rises(self) -> bool:
        """True if more is stronger."""
        return self.strongest > self.weakest

    def strength(self, dose: float) -> float:
        """Logarithm of a dose, or minus that where less is stronger."""
        return log(dose) if self.rises else -log(dose)

    def dose(self, strength: float) -> float:
        """The dose of a strength."""
        return exp(strength if self.rises else -strength)

    @property
    def doses(self) -> tuple[float, ...]:
        """All of them, the weakest first, with four digits."""
        step = (self.strength(self.strongest) - self.strength(self.weakest)) / (DOSES - 1)
        between = (self.dose(self.strength(self.weakest) + i * step) for i in range(1, DOSES - 1))
        return (self.weakest, *(float(f"{dose:.4g}") for dose in between), self.strongest)


AXES = {
    "low_texture": DoseAxis("contrast", 0.7, 0.01),
    "repeated_texture": DoseAxis("share", 0.05, 1.0),
    "motion_blur": DoseAxis("exposure_s", 0.01, 0.8),
    "fast_rotation": DoseAxis("rate_degps", 30.0, 600.0),
    "pure_rotation": DoseAxis("angle_deg", 5.0, 180.0),
    "frame_drops": DoseAxis("share", 0.1, 1.0),
    "time_jitter": DoseAxis("sigma_s", 0.001, 0.3),
    "fog": DoseAxis("extinction_per_m", 0.02, 10.0),
    "moving_objects": DoseAxis("share", 0.05, 0.95),
    "rolling_shutter": DoseAxis("readout_s", 0.005, 0.3),
    "defocus": DoseAxis("diameter_px", 1.5, 60.0),
    "lens_dirt": DoseAxis("share", 0.05, 0.95),
    "rain": DoseAxis("rate_mmph", 1.0, 300.0),
    "shallow_focus": DoseAxis("aperture_mm", 1.0, 200.0),
    "lens_flare": DoseAxis("veil", 0.01, 20.0),
    "cracked_lens": DoseAxis("cracks", 1.0, 200.0),
    "vignetting": DoseAxis("stops", 0.25, 16.0),
    "covered_lens": DoseAxis("transmission", 0.7, 0.0005),
    "flicker": DoseAxis("modulation", 0.05, 1.0),
    "day_to_night": DoseAxis("stops", 0.25, 20.0),
    "low_light": DoseAxis("illumination", 0.7, 0.0005),
    "over_exposure": DoseAxis("stops", 0.25, 12.0),
    "auto_exposure_lag": DoseAxis("stops", 0.25, 12.0),
    "jpeg": DoseAxis("quality", 80.0, 1.0),
    "bandwidth_loss": DoseAxis("share", 0.02, 1.0),
}
"""The axis of every kind that comes with the lab."""


def dose_axis(
    kind: str, field: str | None = None, weakest: float | None = None, strongest: float | None = None
) -> DoseAxis:
    """The axis of a kind of stress, its own or a given one.

    Args:
        kind: of the segment.
        field: that is the dose; None for that of the kind's own axis.
        weakest, strongest: ends; None for those of the kind's own axis.

    Raises:
        InputError: the kind is unknown, has no such field or no number to vary, or an end is not valid.
    """
    given = _own_axis(kind, field, weakest is not None and strongest is not None)
    axis = DoseAxis(
        given.field,
        given.weakest if weakest is None else weakest,
        given.strongest if strongest is None else strongest,
    )
    for option, value in (("--weakest", axis.weakest), ("--strongest", axis.strongest)):
        _check_end(option, value, kind, axis.field)
    if len(set(axis.doses)) < DOSES:
        problem = f"{axis.weakest:g} and {axis.strongest:g} are too near each other"
        raise InputError("--weakest and --strongest", problem, "give a wider range")
    return axis


def _own_axis(kind: str, field: str | None, has_ends: bool) -> DoseAxis:
    """The axis of a kind, or of another field of it whose ends are given."""
    if kind not in SEGMENT_KINDS:
        known = sorted(SEGMENT_KINDS)
        remedy = f"use {guess(kind, known)}one of {', '.join(known)}"
        raise InputError(kind, "there is no such kind of stress", remedy)
    numbers = [n for n in severity_fields(kind) if SEGMENT_KINDS[kind].model_fields[n].annotation is float]
    if not numbers:
        raise InputError(kind, "has no number that could be its dose", "use another kind of stress")
    if field is not None and field not in numbers:
        problem = f"a segment of kind {kind} has no number {field}"
        raise InputError("--dose", problem, f"use {' or '.join(numbers)}")
    own = AXES.get(kind)
    if own is not None and field in (None, own.field):
        return own
    if not has_ends:
        problem = f"no range of {field or ' or '.join(numbers)} is known of {kind}"
        raise InputError(kind, problem, "give --dose with --weakest and --strongest")
    if field is None and len(numbers) > 1:
        raise InputError(kind, f"has {len(numbers)} doses", f"give --dose, {' or '.join(numbers)}")
    return DoseAxis(field or numbers[0], 0.0, 0.0)


def _check_end(option: str, value: float, kind: str, field: str) -> None:
    if not value > 0:
        remedy = f"give a {field} above 0: doses differ by factors"
        raise InputError(option, f"{value:g} has no logarithm", remedy)
    model = SEGMENT_KINDS[kind]
    try:
        model.model_validate({"kind": kind, "start_s": 0.0, "duration_s": 1.0, field: value})
    except ValidationError as error:
        for fault in error.errors():
            if field in fault["loc"]:
                problem, remedy = problem_and_remedy(fault)
                raise InputError(option, f"{field}: {problem}", remedy) from None
