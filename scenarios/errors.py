"""The exceptions for what a user can mend, with place, problem and remedy."""

import warnings
from collections.abc import Sequence


class InputError(Exception):
    """Bad input from a user: one clear line, exit code 2.

    Args:
        where: the file and field at fault, for example ``camera.yaml: fx``.
        problem: the fault.
        remedy: advice for the user.
    """

    exit_code = 2

    def __init__(self, where: str, problem: str, remedy: str) -> None:
        self.where, self.problem, self.remedy = where, problem, remedy
        super().__init__(f"{where}: {problem}; {remedy}")

    @property
    def faults(self) -> "tuple[InputError, ...]":
        """Every fault: this one, unless there are several."""
        return (self,)

    def __reduce__(self) -> tuple[type["InputError"], tuple]:
        """Pickle the parts: an exception is rebuilt from its message alone otherwise."""
        return type(self), (self.where, self.problem, self.remedy)


class SeveralFaultsError(InputError):
    """Several faults of one file: as a line, the first of them and the number of the others."""

    def __init__(self, faults: Sequence[InputError]) -> None:
        first, self._faults = faults[0], tuple(faults)
        super().__init__(first.where, first.problem, f"{first.remedy} ({len(faults) - 1} more in this file)")

    @property
    def faults(self) -> tuple[InputError, ...]:
        """Every fault, the most informative first."""
        return self._faults

    def __reduce__(self) -> tuple[type["SeveralFaultsError"], tuple]:
        """See ``InputError``."""
        return type(self), (self._faults,)


def collect(found: list[InputError], faults: list[InputError] | None) -> None:
    """Add faults to a list; without one, raise them, if there are any.

    Raises:
        InputError: a fault was found; with all of them as its ``faults``.
    """
    if faults is not None:
        faults += found
    elif found:
        raise found[0] if len(found) == 1 else SeveralFaultsError(found)


class MachineError(InputError):
    """A fault of the machine, not of the input: one clear line, exit code 1."""

    exit_code = 1


class InputNotice(UserWarning):
    """What was noticed of an input, and what was made of it."""


def notice(where: str, said: str) -> None:
    """Say what was noticed of an input: a warning in Python, one line on the terminal."""
    warnings.warn(InputNotice(f"{where}: {said}"), stacklevel=3)
