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
