"""The segments of a spec, one model per kind of degradation.

Segments of different kinds may lie over one another in time; those of one kind follow one another.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from pydantic import Field, model_validator

from dslab.scenarios.kinds import Kinds
from dslab.scenarios.strict import Strict

Axis = Literal["yaw", "pitch", "roll"]


class SegmentBase(Strict):
    """Base of the models of segments; each has a literal ``kind``."""

    start_s: float = Field(ge=0)
    duration_s: float = Field(gt=0)

    @property
    def end_s(self) -> float:
        """End of the segment, sequence time."""
        return self.start_s + self.duration_s

    @property
    def label(self) -> str:
        """Kind and times, for a line of text."""
        return f"{getattr(self, 'kind', '')}, {self.start_s:g}-{self.end_s:g} s"

    @property
    def severity(self) -> dict[str, float | str]:
        """The parameters that say how bad it is, without kind and times."""
        return self.model_dump(exclude={"kind", "start_s", "duration_s"}, exclude_none=True)


class ImageSegment(SegmentBase):
    """A segment that acts on the images; its severity may rise and fall in straight lines at its ends."""

    ramp_s: float = Field(0.0, ge=0, description="time in which the severity rises, and in which it falls")
    fall_s: float | None = Field(None, ge=0, description="time in which it falls, if not ramp_s")

    @property
    def falls_s(self) -> float:
        """Time in which the severity falls."""
        return self.ramp_s if self.fall_s is None else self.fall_s

    @model_validator(mode="after")
    def _ramps_fit(self) -> "ImageSegment":
        if self.ramp_s + self.falls_s > self.duration_s + 1e-9:
            if self.fall_s is None:
                raise ValueError(
                    f"two ramps of {self.ramp_s:g} s are longer than the segment, "
                    f"use at most ramp_s = {self.duration_s / 2:g}"
                )
            raise ValueError(
                f"ramp_s and fall_s are {self.ramp_s + self.fall_s:g} s together, longer than the segment, "
                f"use at most {self.duration_s:g}"
            )
        return self


class LowTexture(SegmentBase):
    """The surfaces that the camera passes in this time have their texture contrast multiplied.

    Passed is a surface whose fullest view falls into this time; where none is, nothing fades. With view_share
    surfaces fade until they fill that share of the view in this time, those first that are seen least outside
    it. In recordings: Detail of the frames fades; shading and noise stay.
    """

    kind: Literal["low_texture"]
    contrast: float = Field(
        ge=0, le=1, description="1 leaves the texture, 0 removes it; perceived as log contrast"
    )
    view_share: float | None = Field(
        None, gt=0, le=1, description="share of the view that fades; null for the surfaces passed"
    )


class RepeatedTexture(SegmentBase):
    """Surfaces passed in this time repeat one patch of the most seen of them. Rendered scenarios only."""

    kind: Literal["repeated_texture"]
    share: float = Field(ge=0, le=1, description="share of those surfaces, by the view they fill")
    period_m: float = Field(0.5, ge=0.05, le=10, description="side of the patch that repeats")


class MotionBlur(SegmentBase):
    """The shutter stays open longer: beyond one frame interval it is the blur of averaged frames.

    In recordings: Light is averaged, between the frames too, along the optical flow.
    """

    kind: Literal["motion_blur"]
    exposure_s: float = Field(ge=0, le=1, description="how long it is open; of averaged frames, their span")


class FastRotation(SegmentBase):
    """The camera swings out and back, a smooth burst of rotation about one of its axes on top of the path.

    In recordings: Images and truth swing out and back; all frames are cropped to what every turn sees.
    """

    kind: Literal["fast_rotation"]
    rate_degps: float = Field(
        ge=0,
        le=1000,
        description="peak angular rate; the peak angle is 0.245 rate_degps duration_s",
    )
    axis: Axis = "yaw"


class PureRotation(SegmentBase):
    """The camera stops, turns out and back on the spot, without parallax, and goes on.

    One that begins at 0 s begins at rest. Rendered scenarios only.
    """

    kind: Literal["pure_rotation"]
    angle_deg: float = Field(ge=0, le=360, description="how far it turns out; 0 does not even stop")
    axis: Axis = "yaw"


class FrameDrops(SegmentBase):
    """Frames are missing; those that remain keep their stamps and poses."""

    kind: Literal["frame_drops"]
    share: float = Field(ge=0, le=1, description="of the segment's frames; its last one always stays")


class TimeJitter(SegmentBase):
    """Stamps are wrong; the true pose stays that of the moment of the exposure."""

    kind: Literal["time_jitter"]
    sigma_s: float = Field(ge=0, le=10, description="standard deviation; stamps keep their order")


class Fog(ImageSegment):
    """Homogeneous fog between the camera and the surfaces. Recordings need depth images."""

    kind: Literal["fog"]
    extinction_per_m: float = Field(ge=0, le=100, description="share of the light lost per metre")
    airlight_level: float = Field(190.0, ge=0, le=255, description="grey level of endless fog")


class MovingObjects(ImageSegment):
    """Textured things pass in front of everything, each with a motion of its own."""

    kind: Literal["moving_objects"]
    share: float = Field(ge=0, le=0.95, description="share of the view that they fill")
    rate_degps: float = Field(20.0, ge=0, le=1000, description="how fast they cross the view's middle")


class RollingShutter(ImageSegment):
    """Rows are read one after the other while the camera moves; the middle row at the frame's stamp.

    Rendered scenarios only.
    """

    kind: Literal["rolling_shutter"]
    readout_s: float = Field(ge=0, le=1, description="from the first row to the last")


class Defocus(ImageSegment):
    """The lens is out of focus: every point is a disc."""

    kind: Literal["defocus"]
    diameter_px: float = Field(ge=0, le=100, description="blur circle; up to 1 px changes nothing")


class LensDirt(ImageSegment):
    """Drops and specks on the lens stay in place and show a smeared image instead of the scene."""

    kind: Literal["lens_dirt"]
    share: float = Field(ge=0, le=0.95, description="share of the view that they cover")
    spot_deg: float = Field(6.0, gt=0.1, le=60, description="mean width of a spot, visual angle")


class Rain(ImageSegment):
    """Rain falls before the camera, and drops land on the glass before its lens."""

    kind: Literal["rain"]
    rate_mmph: float = Field(ge=0, le=300, description="mm per hour: 2 is light, 10 heavy, 50 a cloudburst")
    wind_mps: float = Field(3.0, ge=0, le=40, description="slants the drops and blows them against the glass")
    glass_mm: float = Field(30.0, ge=0, le=100, description="from glass to lens; 0 for one under a roof")
    wet_s: float = Field(20.0, ge=0, le=3600, description="how long it has rained on the glass at the start")


class CoveredLens(ImageSegment):
    """Something before the lens keeps light off."""

    kind: Literal["covered_lens"]
    transmission: float = Field(ge=0, le=1, description="share of the light that passes; 0 blanks the frames")


class LowLight(ImageSegment):
    """Less light on the sensor: darker, and noisy by shot noise and read noise."""

    kind: Literal["low_light"]
    illumination: float = Field(gt=0, le=1, description="light, as a share of that of the clean frames")
    gain: float = Field(1.0, ge=1, le=1000, description="amplification of signal and noise at full severity")
    full_well_e: float = Field(10000.0, gt=0, le=1e7, description="electrons of a white pixel at gain 1")
    read_noise_e: float = Field(5.0, ge=0, le=1e4, description="standard deviation, electrons")


class OverExposure(ImageSegment):
    """Too much exposure: what is bright saturates."""

    kind: Literal["over_exposure"]
    stops: float = Field(ge=0, le=12, description="each doubles the light")


class AutoExposureLag(ImageSegment):
    """The light jumps at the start and stays; the exposure follows with a delay of first order."""

    kind: Literal["auto_exposure_lag"]
    stops: float = Field(ge=-12, le=12, description="the jump; above 0 it gets brighter")
    time_constant_s: float = Field(0.5, gt=0, le=60, description="of the exposure's delay")


class Jpeg(ImageSegment):
    """The frames have been through a JPEG encoder."""

    kind: Literal["jpeg"]
    quality: float = Field(ge=0, le=100, description="libjpeg's scale; 100 stands for no encoder at all")


class CrackedLens(ImageSegment):
    """The glass before the lens is cracked: cracks scatter light, and the glass beside them bends it."""

    kind: Literal["cracked_lens"]
    cracks: float = Field(ge=0, le=200, description="how many run from the point of impact, with branches")
    bend_deg: float = Field(0.5, ge=0, le=10, description="how far light beside a crack is bent")


class LensFlare(ImageSegment):
    """A light shines into the lens: glare about it, streaks, and ghosts on the other side of the view.

    The light is far away and stays where it is; in recordings it turns with the camera.
    """

    kind: Literal["lens_flare"]
    veil: float = Field(ge=0, le=20, description="light that it adds on average at the start; 1 is white")
    off_axis_deg: float = Field(15.0, ge=0, le=80, description="from the view's middle at the start")


class ShallowFocus(ImageSegment):
    """A wide lens is in focus at one distance; all else is blurred. Recordings need depth images."""

    kind: Literal["shallow_focus"]
    aperture_mm: float = Field(ge=0, le=200, description="width of the lens's opening; 0 is sharp throughout")
    focus_m: float = Field(1.0, gt=0.01, le=1000, description="distance of what is sharp")


class Vignetting(ImageSegment):
    """The view gets darker towards its corners."""

    kind: Literal["vignetting"]
    stops: float = Field(ge=0, le=16, description="light lost in the corners; each halves it")


class DayToNight(ImageSegment):
    """Daylight goes, over `ramp_s`; the camera amplifies what is left, and its noise."""

    kind: Literal["day_to_night"]
    stops: float = Field(ge=0, le=20, description="daylight lost; each halves it")
    gain: float = Field(16.0, ge=1, le=1000, description="the most by which the camera amplifies")
    lamp: float = Field(0.0, ge=0, le=1, description="light of a lamp on the camera, as a share of daylight")


class Flicker(ImageSegment):
    """Lamps flicker with the mains: bands over the rows, which are read one after the other."""

    kind: Literal["flicker"]
    modulation: float = Field(ge=0, le=1, description="share by which a row's light rises and falls")
    rate_hz: float = Field(100.0, gt=0, le=1e5, description="of the light, twice that of the mains")
    readout_s: float = Field(0.02, ge=0, le=1, description="from first row to last; 0 for no bands")


class BandwidthLoss(ImageSegment):
    """Packets of the coded video are lost: blocks are smeared from before them, or show another place."""

    kind: Literal["bandwidth_loss"]
    share: float = Field(ge=0, le=1, description="of the packets")
    block_px: int = Field(16, ge=4, le=128, description="side of a block")


_Known = (
    LowTexture
    | RepeatedTexture
    | MotionBlur
    | FastRotation
    | PureRotation
    | FrameDrops
    | TimeJitter
    | Fog
    | MovingObjects
    | RollingShutter
    | Defocus
    | LensDirt
    | Rain
    | ShallowFocus
    | LensFlare
    | CrackedLens
    | Vignetting
    | CoveredLens
    | DayToNight
    | Flicker
    | LowLight
    | OverExposure
    | AutoExposureLag
    | Jpeg
    | BandwidthLoss
)
SEGMENT_KINDS: Kinds[SegmentBase] = Kinds("segment", get_args(_Known))
"""The model of every kind of segment, by kind; ``sim.register_degradation`` adds one."""

if TYPE_CHECKING:
    Segment = _Known
else:
    Segment = Annotated[SegmentBase, SEGMENT_KINDS]


def self_overlap(segments: Sequence[SegmentBase]) -> tuple[int, int] | None:
    """Places of two segments of one kind that overlap, the earlier first; None if there are none."""
    by_kind = sorted(
        range(len(segments)), key=lambda i: (getattr(segments[i], "kind", ""), segments[i].start_s)
    )
    for i, j in pairwise(by_kind):
        same = type(segments[i]) is type(segments[j])
        if same and segments[j].start_s < segments[i].end_s - 1e-9:
            return i, j
    return None
