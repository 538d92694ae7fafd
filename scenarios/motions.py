"""The motions of a spec."""

from pydantic import Field

from scenarios.strict import Strict


class Trajectory(Strict):
    """A smooth carrier path along the world's route.

    ``gaze`` is where the camera looks relative to the direction of travel: 0 ahead, 90 to the left wall.
    """

    max_speed_mps: float = Field(0.9, gt=0, le=60)
    max_rate_degps: float = Field(40.0, gt=0, le=400)
    gaze_deg: float = Field(0.0, ge=-180, le=180)
    eye_height_m: float = Field(1.5, gt=0, le=15)
    sway_m: float = Field(0.04, ge=0, le=2, description="amplitude of the smooth sideways and vertical sway")
