"""The exceptions for what a user can mend, with place, problem and remedy."""


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

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str]]:
        """Pickle the parts: an exception is rebuilt from its message alone otherwise."""
        return type(self), (self.where, self.problem, self.remedy)


class MachineError(InputError):
    """A fault of the machine, not of the input: one clear line, exit code 1."""

    exit_code = 1
