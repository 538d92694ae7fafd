"""The one exception for bad input: what is wrong, where, and what to do about it."""


class InputError(Exception):
    """Bad input from a user: one clear line, exit code 2.

    Args:
        where: the file and field at fault, for example ``camera.yaml: fx``.
        problem: what is wrong with it.
        remedy: what the user can do.
    """

    def __init__(self, where: str, problem: str, remedy: str) -> None:
        self.where, self.problem, self.remedy = where, problem, remedy
        super().__init__(f"{where}: {problem}; {remedy}")

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str]]:
        """An exception is remade from its message alone; this one needs its parts to cross to a process."""
        return type(self), (self.where, self.problem, self.remedy)
