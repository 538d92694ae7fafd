"""Motions by kind."""

from collections.abc import Callable, Mapping

from dslab.scenarios.extensions import note_extension
from dslab.scenarios.motions import Trajectory, add_motion_kind
from dslab.sim.motion.base import Motion
from dslab.sim.motion.car import plan_car
from dslab.sim.motion.spline import PoseSpline
from dslab.sim.motion.walker import plan_handheld, plan_walk
from dslab.sim.worlds.base import Route


def plan_motion(route: Route, trajectory: Trajectory, duration_s: float, seed: int) -> Motion:
    """Plan the motion of a trajectory along a route.

    Args:
        route: free space to move in.
        trajectory: kind of motion and its limits.
        duration_s: the motion is defined from ``-PAD_S`` to ``duration_s + PAD_S``.
        seed: root seed; the streams are ``("motion", ...)``.
    """
    return _PLANS[trajectory.kind](route, trajectory, duration_s, seed)


def _plan_drone(route: Route, trajectory: Trajectory, duration_s: float, seed: int) -> PoseSpline:
    # MuJoCo is loaded for drones only.
    from dslab.sim.motion.drone import plan_drone

    return plan_drone(route, trajectory, duration_s, seed)


MotionPlan = Callable[[Route, Trajectory, float, int], Motion]
"""A route, a trajectory, a duration and a seed to the motion along the route."""

_PLANS: dict[str, MotionPlan] = {
    "walk": plan_walk,
    "handheld": plan_handheld,
    "car": plan_car,
    "drone": _plan_drone,
}


def register_motion(
    kind: str,
    plan: MotionPlan,
    *,
    defaults: Mapping[str, float] | None = None,
    fields: tuple[str, ...] = (),
) -> None:
    """Add a kind of motion, to be named as ``trajectory: {kind: ...}`` in scenarios.

    Args:
        kind: its name.
        plan: makes the motion from a route, the trajectory, the duration in seconds and the root seed; the
            same arguments must give the same motion.
        defaults: fields of the trajectory that the kind sets.
        fields: those of shake_deg, step_hz, max_accel_mps2 and gust_mps that the kind has.

    Raises:
        ValueError: the kind is taken, or a field is unknown.
    """
    add_motion_kind(kind, defaults or {}, fields)
    _PLANS[kind] = plan
    note_extension(f"motion: {kind}", plan)
