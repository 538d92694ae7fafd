"""``dslab warmup``."""

from dslab.experiments.cli.console import err, progress_bars, single_threaded_opencv


def warmup_command() -> None:
    """Compile the kernels; later runs load them from the cache.

    Example: `dslab warmup`
    """
    from dslab.experiments.runs.processes import process_pool
    from dslab.scenarios.errors import InputError
    from dslab.sim import warmup as simulator
    from dslab.slam import warmup as systems

    single_threaded_opencv()
    with process_pool(1) as beside, progress_bars() as show:
        rendered = beside.submit(simulator.warm_up)
        systems.warm_up(show)
        try:
            rendered.result()
        except InputError as error:
            err.print(f"kernels of the simulator are compiled when first used: {error}", soft_wrap=True)
    err.print("kernels ready")
