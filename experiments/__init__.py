"""Runs, trials, statistics and pictures of SLAM systems under stress.

The names below are what this package promises; everything else may change at any time. They are imported
when first used: ``import experiments`` loads no GL and compiles nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dslab.experiments.kernel_cache import choose_kernel_cache

if TYPE_CHECKING:
    from dslab.experiments.api import Run, compare, run, run_experiment, run_many
    from dslab.experiments.campaign.folder import read_experiment
    from dslab.experiments.eq1.spec import ExperimentSpec
    from dslab.experiments.eq1.spec import load_spec as load_experiment
    from dslab.experiments.plugins import load_plugins
    from dslab.experiments.report.write import write_report
    from dslab.experiments.statistics.analysis import Analysis, analyse

choose_kernel_cache()

_HOMES = {
    "Analysis": "dslab.experiments.statistics.analysis",
    "ExperimentSpec": "dslab.experiments.eq1.spec",
    "Run": "dslab.experiments.api",
    "analyse": "dslab.experiments.statistics.analysis",
    "compare": "dslab.experiments.api",
    "load_experiment": "dslab.experiments.eq1.spec:load_spec",
    "load_plugins": "dslab.experiments.plugins",
    "read_experiment": "dslab.experiments.campaign.folder",
    "run": "dslab.experiments.api",
    "run_experiment": "dslab.experiments.api",
    "run_many": "dslab.experiments.api",
    "write_report": "dslab.experiments.report.write",
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
    "run_many",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, original = _HOMES[name].partition(":")
    return getattr(import_module(module), original or name)


def __dir__() -> list[str]:
    return sorted(__all__)
