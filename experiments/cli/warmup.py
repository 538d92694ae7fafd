"""``dslab warmup``."""

from experiments.cli.console import err, progress_bars, single_threaded_opencv


def warmup_command() -> None:
    """Compile the kernels; later runs load them from the cache.

    Example: `dslab warmup`
    """
    from slam.warmup import warm_up

    single_threaded_opencv()
    with progress_bars() as show:
        warm_up(show)
    err.print("kernels ready")
