"""``dslab warmup``."""

from collections import deque

from dslab.experiments.cli.console import err, progress_bars, single_threaded_opencv


def warmup_command() -> None:
    """Compile the kernels; later runs load them from the cache.

    Example: `dslab warmup`
    """
    from dslab.experiments.jobs.pool import PoolSettings, open_pool
    from dslab.scenarios.errors import InputError
    from dslab.slam import warmup as systems

    single_threaded_opencv()
    with open_pool(_warm_up_simulator, PoolSettings()) as beside, progress_bars() as show:
        beside.start(None, *beside.free())
        systems.warm_up(show)
        try:
            for ended in beside.run(deque()):
                ended.result()
        except InputError as error:
            err.print(f"kernels of the simulator are compiled when first used: {error}", soft_wrap=True)
    err.print("kernels ready")


def _warm_up_simulator(_: None) -> None:
    from dslab.sim.warmup import warm_up

    warm_up()
