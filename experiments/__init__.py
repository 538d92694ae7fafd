"""Runs, trials, statistics and pictures of SLAM systems under stress.

The names below are what this package promises; everything else may change at any time. They are imported
when first used: ``import experiments`` loads no GL and compiles nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from experiments.kernel_cache import choose_kernel_cache

if TYPE_CHECKING:
    from experiments.api import Run, compare, run, run_experiment
    from experiments.campaign.folder import read_experiment
    from experiments.eq1.spec import ExperimentSpec
    from experiments.eq1.spec import load_spec as load_experiment
    from experiments.plugins import load_plugins
    from experiments.report.write import write_report
    from experiments.statistics.analysis import Analysis, analyse

choose_kernel_cache()

_HOMES = {
    "Analysis": "experiments.statistics.analysis",
    "ExperimentSpec": "experiments.eq1.spec",
    "Run": "experiments.api",
    "analyse": "experiments.statistics.analysis",
    "compare": "experiments.api",
    "load_experiment": "experiments.eq1.spec:load_spec",
    "load_plugins": "experiments.plugins",
    "read_experiment": "experiments.campaign.folder",
    "run": "experiments.api",
    "run_experiment": "experiments.api",
    "write_report": "experiments.report.write",
}

__all__ = [
    "Analysis",
    "ExperimentSpec",
    "Run",
    "analyse",
    "compare",
    "load_experiment",
    "load_plugins",
    "read_experiment",
    "run",
    "run_experiment",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, original = _HOMES[name].partition(":")
    return getattr(import_module(module), original or name)


def __dir__() -> list[str]:
    return sorted(__all__)
