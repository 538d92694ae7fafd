"""What differs from the paper and ORB-SLAM and can be undone alone, after docs/dual-slam.md.

Names of settings are those of that page: ``THREAD.`` stands for the settings of both recovery threads,
``ORB.`` and ``SIFT.`` for those of one. Where a deviation is made on the published profile it has the values
that our systems have by themselves.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, is_dataclass, replace
from functools import reduce
from typing import Any, Literal

from dslab.experiments.runs.slam_settings import parse_slam_settings
from dslab.slam.config import SlamConfig
from dslab.slam.core.camera import PinholeCamera
from dslab.slam.dual.config import DualConfig
from dslab.slam.dual.recovery.registry import build_thread

Side = Literal["undone", "made"]
NEVER, ALL = 1e6, 1_000_000
"""Of a bound that nothing reaches."""
ANY_CAMERA = PinholeCamera(320, 240, 250.0, 250.0, 159.5, 119.5, 20.0)
"""A camera of small images: settings differ for large ones, but not by these."""


@dataclass(frozen=True)
class Deviation:
    """One deviation.

    Attributes:
        name: of what we do otherwise; its variant is ``without-NAME`` off our systems, ``with-NAME`` on the
            published.
        heading: of its paragraph in docs/dual-slam.md.
        undone: the settings that undo it.
        recovers: it is one of the recovery, not of the base.
        needs: names of others without which it does nothing: it is not made alone on the published profile.
    """

    name: str
    heading: str
    undone: Mapping[str, Any]
    recovers: bool = True
    needs: tuple[str, ...] = ()


PUBLISHED = "By the paper's text"
"""Heading of what the published profile undoes and no paragraph of its own justifies."""
DEVIATIONS = (
    *(
        Deviation(name, heading, undone, recovers=False)
        for name, heading, undone in (
            ("doubt", "What breaks", {"tracking.doubt.min_share": 0.0, "tracking.doubt.nearer": 0.0}),
            ("subpixel", "Between the pixels", {"orb.subpixel": False, "orb.noise_px": 1.0}),
            ("faint-corners", "Faint ones", {"orb.faint_share": 0.0}),
            ("five-fold", "Five-fold features", {"initial_features": 2.0}),
            ("three-levels", "Three pyramid levels", {"initialization.max_octave": 0}),
            ("lead", "When two views suffice", {"initialization.two_view.min_lead_sigmas": 0.0}),
            (
                "second-motion",
                "The second motion of a plane",
                {"initialization.second_motion.max_views": 0},
            ),
            ("between", "Frames before the map", {"initialization.max_between": 0}),
            ("tracking", PUBLISHED, {"tracking.rules": "published", "tracking.local_map_keyframes": ALL}),
            ("mapping", PUBLISHED, {"mapping.rules": "published"}),
            ("geometry", PUBLISHED, {"initialization.geometry": "published"}),
            ("neighbours", PUBLISHED, {"mapping.neighbours": 20}),
            ("window", PUBLISHED, {"mapping.window": ALL, "mapping.fixed": ALL}),
            ("belief", PUBLISHED, {"belief": None}),
            (
                "candidates",
                PUBLISHED,
                {
                    "relocalization.candidates": ALL,
                    "relocalization.last_keyframe": False,
                    "relocalization.local_map_keyframes": 1,
                },
            ),
            ("margin", PUBLISHED, {"relocalization.min_margin": 0.0}),
            ("self-calibration", PUBLISHED, {"self_calibration.at_keyframes": []}),
        )
    ),
    Deviation("dropping", "Young maps are dropped", {"min_map_keyframes": 0}),
    Deviation("relocalization", "Relocalization into saved maps", {"dual.relocalization": False}),
    Deviation("five-keyframes", "Five keyframes", {"dual.start_keyframes": 2}),
    Deviation("sharp-start", "Not from smeared frames", {"dual.max_start_noise": NEVER}, needs=("tracking",)),
    Deviation("side-by-side", "Recoveries side by side", {"dual.workers": 1}),
    Deviation("passing-over", "Two seconds passed over", {"THREAD.max_unusable_s": 0.0}),
    Deviation("shrink-doubt", "A map that shrinks", {"THREAD.doubt.slower": 0.0, "THREAD.doubt.nearer": 0.0}),
    Deviation("sift-adjusted", "SIFT in the bundle adjustment", {"SIFT.adjusted_keyframes": 2}),
    Deviation("weak-texture", "Weak texture", {"SIFT.contrast": 0.04}),
    Deviation("two-alignments", "Two agreeing alignments", {"THREAD.fusion.confirmations": 1}),
    Deviation("one-by-one", "Keyframe by keyframe", {"THREAD.at_once": True}),
    Deviation(
        "early-end", "The end at the second agreement", {"THREAD.whole_buffer": True}, needs=("one-by-one",)
    ),
    Deviation("joining", "Joining by place", {"dual.place_merging": None}),
)
"""Those that can be undone alone, each by settings."""

NOT_ALONE = {
    "A cap": "no sequence here is longer than the cap",
    "Failure of a thread": "exhaustive makes every thread run, and leaves what its failure is",
    "GMS plus windowed search": "the preset init: dual+ against paper+",
    "Kinds beyond two": "the threads are those of Algorithm 1",
    "A look at the alignment": "direct threads do not run here",
    "Rescue by intensities": "it is off",
    "Where depths come from": "there is no other source",
    "EPnP, then both kinds of features": "no setting leaves a step out",
    "A SIFT detector of its own": "there is no other detector",
    "Keyframes of the same time": "the paper names no time",
}
"""Headings with a setting, and why no variant undoes them alone."""

NOT_TRIED = {
    "loops": "no sequence here comes back to a place",
    "tracking.doubt.slower": "without tracking.doubt.nearer it does nothing",
}
"""Settings, or groups of them, in which the published profile differs, and why no variant has them."""


def deviation_variants(side: Side) -> list[dict[str, Any]]:
    """The variants that show what each deviation is worth alone, and what they are compared with.

    Args:
        side: ``undone`` off our systems ``base`` and ``dual``, or ``made`` on the published ``orbslam`` and
            ``paper``.

    Returns:
        Fields of variants: name, system, settings, and the name of the reference; of those that are
        other systems than it.
    """
    systems = ("base", "dual") if side == "undone" else ("orbslam", "paper")
    found: list[dict[str, Any]] = [{"name": system, "system": system} for system in systems]
    for deviation in DEVIATIONS:
        system = systems[deviation.recovers]
        own = deviation.undone if side == "undone" else made(deviation)
        alone = side == "undone" or not deviation.needs
        if alone and _settings(system, settings := nested(own, side)) != _settings(system, {}):
            name = f"{'without' if side == 'undone' else 'with'}-{deviation.name}"
            found.append({"name": name, "system": system, "against": system, "settings": settings})
    return found


def made(deviation: Deviation) -> dict[str, Any]:
    """The values of its settings that our systems have by themselves, by the same names."""
    return {name: _plain(_own(name)) for name in deviation.undone}


def nested(settings: Mapping[str, Any], side: Side) -> dict[str, Any]:
    """Settings by names as in a settings file, with the two recovery threads where one of theirs is set."""
    kinds = {"ORB": "orb", "SIFT": "sift"}
    if side == "made":
        kinds = {name: f"paper_{kind}" for name, kind in kinds.items()}
    found: dict[str, Any] = {}
    threads: dict[str, dict[str, Any]] = {name: {} for name in kinds}
    for name, value in settings.items():
        first, _, rest = name.partition(".")
        if first == "THREAD" or first in kinds:
            for of in kinds if first == "THREAD" else (first,):
                _put(threads[of], rest, deepcopy(value))
        else:
            _put(found, name, value)
    if any(threads.values()):
        chosen = [{"kind": kind, "config": threads[of]} for of, kind in kinds.items()]
        found.setdefault("dual", {})["recovery_threads"] = chosen
    return found


def _settings(system: str, written: dict[str, Any]) -> Any:
    """All settings of a system, with each thread's written out."""
    config, dual = parse_slam_settings(written, (), str).of(system, ANY_CAMERA)
    threads = [getattr(build_thread(spec), "config", None) for spec in dual.recovery_threads]
    return config, replace(dual, recovery_threads=()), threads


def _put(into: dict[str, Any], name: str, value: Any) -> None:
    *above, last = name.split(".")
    reduce(lambda node, key: node.setdefault(key, {}), above, into)[last] = value


def _own(name: str) -> Any:
    first, _, rest = name.partition(".")
    if first in ("THREAD", "ORB", "SIFT"):
        specs = {spec.kind: spec for spec in DualConfig().recovery_threads}
        thread: Any = build_thread(specs["sift" if first == "SIFT" else "orb"])
        return reduce(getattr, rest.split("."), thread.config)
    settings, path = (DualConfig(), rest) if first == "dual" else (SlamConfig(), name)
    return reduce(getattr, path.split("."), settings)


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {}  # that it is on: its own settings are those of its class
    return list(value) if isinstance(value, tuple) else value
