"""numba without a cache of kernels; numba imports this module if the environment names it."""

import os
from typing import Any

from numba.core.caching import Cache, UserProvidedCacheLocator

from dslab.experiments.kernel_cache import say


class NoCache(UserProvidedCacheLocator):
    """Locator of a folder that is never used."""

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> "NoCache":
        """A locator for any function."""
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        """No folder."""
        return os.devnull


# Every function asks for a cache, and is given one that neither loads nor saves.
Cache.enable = Cache.disable
say("kernels are compiled anew: no folder for them can be written, set NUMBA_CACHE_DIR to one")
