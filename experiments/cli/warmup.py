"""``dslab warmup``."""

from dslab.experiments.cli.console import err, progress_bars


def warmup_command() -> None:
    """Compile the kernels; later runs load them from the cache.

    Example: `dslab warmup`
    """
    from dslab.experiments.kernels import compile_kernels

    with progress_bars(kernels=False) as show:
        compile_kernels(show, again=True)
    err.print("kernels ready")
