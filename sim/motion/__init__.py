"""Motions by kind of carrier. A new one is one file with a plan function and one line here."""

from collections.abc import Callable

from scenarios.motions import Trajectory
from sim.motion.car import plan_car
from sim.motion.spline import PoseSpline
from sim.motion.walker import plan_handheld, plan_walk
from sim.worlds.base import Route


def plan_motion(route: Route, trajectory: Trajectory, duration_s: float, seed: int) -> PoseSpline:
    """The motion of the trajectory's carrier along a route.

    Args:
        route: free space to move in.
        trajectory: kind of carrier and its limits.
        duration_s: the motion is defined from ``-PAD_S`` to ``duration_s + PAD_S``.
        seed: root seed; the streams are ``("motion", ...)``.
    """
    return _PLANS[trajectory.kind](route, trajectory, duration_s, seed)


def _plan_drone(route: Route, trajectory: Trajectory, duration_s: float, seed: int) -> PoseSpline:
    # MuJoCo is loaded only by those who fly.
    from sim.motion.drone import plan_drone

    return plan_drone(route, trajectory, duration_s, seed)


_PLANS: dict[str, Callable[[Route, Trajectory, float, int], PoseSpline]] = {
    "walk": plan_walk,
    "handheld": plan_handheld,
    "car": plan_car,
    "drone": _plan_drone,
}
