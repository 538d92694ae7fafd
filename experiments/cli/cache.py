"""``dslab cache``: what rendered frames take on the disk."""

import time
from typing import TYPE_CHECKING, Annotated

import typer

from dslab.experiments.cli.console import print_facts

if TYPE_CHECKING:
    from dslab.sim.cache import Entry, FolderCache

_HELP = """Show the cache of rendered frames: its folder, its size and how many entries it has.

Frames are kept in `DSLAB_CACHE_DIR`, by default in the user's cache folder. Beyond 20 GB, those used longest
ago are deleted. Depth images are kept only where they were asked for. For example:

`dslab cache`

`dslab cache clean --older-than 7`
"""
_DAY_S = 86400.0
app = typer.Typer(help=_HELP)


@app.callback(invoke_without_command=True)
def show(context: typer.Context) -> None:
    if context.invoked_subcommand is not None:
        return
    from dslab.sim.cache import CACHE_DIR_VARIABLE, FolderCache

    store = FolderCache()
    entries, now_s = store.entries(), time.time()
    facts: dict[str, object] = {
        "folder": f"{store.root}; {CACHE_DIR_VARIABLE} names another",
        "size": size_text(store),
        "entries": len(entries),
    }
    if entries:
        last, oldest = ((now_s - entries[place].used_s) / _DAY_S for place in (-1, 0))
        facts["last used"] = f"{last:.1f} days ago; the oldest {oldest:.1f} days ago"
    print_facts(facts)


@app.command()
def clean(
    older_than: Annotated[
        float, typer.Option(min=0, metavar="DAYS", help="Only what was not used for so many days.")
    ] = 0.0,
) -> None:
    """Delete rendered frames; those that a running process reads or writes stay.

    They are rendered again when needed, with the same bytes. For example:

    `dslab cache clean`

    `dslab cache clean --older-than 7`
    """
    from dslab.sim.cache import FolderCache

    store = FolderCache()
    deleted, used = store.clean(older_than * _DAY_S)
    kept = f"; {len(used)} in use" if used else ""
    print(f"{store.root}: {len(deleted)} deleted, {_gigabytes(deleted)}{kept}")


def size_text(store: "FolderCache") -> str:
    """Size and cap of a cache."""
    from dslab.sim.cache import MAX_BYTES

    return f"{_gigabytes(store.entries())} of at most {MAX_BYTES / 1e9:g} GB"


def _gigabytes(entries: "list[Entry]") -> str:
    return f"{sum(entry.size_bytes for entry in entries) / 1e9:.2f} GB"
