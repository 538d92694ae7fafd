"""A sequence from what a user names: a folder, a scenario, or a scenario file."""

from collections.abc import Callable
from pathlib import Path

from scenarios.errors import InputError
from sim.sequence import Sequence


def open_sequence(
    source: str, seed: int | None = None, progress: Callable[[str, int, int], None] | None = None
) -> Sequence:
    """Load a sequence folder, or render a scenario (or take it from the cache).

    Args:
        source: a folder in TUM form, the name of a scenario, or the path of its YAML file.
        seed: root seed of a scenario, its own where None; a folder has none.
        progress: called with (step, frames done, frames in all) while rendering.

    Raises:
        InputError: there is no such thing, or it is not valid.
    """
    path = Path(source)
    if path.is_dir():
        from sim.io.tum import load_sequence

        return load_sequence(path)
    if not path.exists() and len(path.parts) > 1 and path.suffix not in (".yaml", ".yml"):
        raise InputError(
            source, "no such folder", "check the path, or name a scenario (dslab scenarios list)"
        )
    from scenarios.loading import load_scenario
    from sim.render import render_sequence

    return render_sequence(load_scenario(source), seed, progress=progress)
