"""What a change of a file is: words, strictness, and the function that does it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

UNLESS_OPTIONAL: Literal["unless optional"] = "unless optional"
UNLESS_SPARSE: Literal["unless sparse"] = "unless sparse"
Strict = bool | Literal["unless optional", "unless sparse"]
"""What is read stays the same or is refused: always, or unless the file, or an entry, may be absent."""
Change = tuple[str, Strict, Callable[[Path], Any]]
NUMBERS = ("-1", "0", "0.5", "1e308", "-1e308", "1e-308", "123456789012345678", "99999999999999999999")
"""Numbers of the right type that are hardly meant."""
DIGITS = "1" * 401
