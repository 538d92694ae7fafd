"""Names as text of plots."""


def label(name: str) -> str:
    r"""The text with which matplotlib draws a name as it is.

    A pair of ``$`` would be read as mathematics, a name that begins with ``_`` left out of legends, and bytes
    that are no UTF-8 are no text: they are shown as ``\udc..``.
    """
    shown = name.encode("utf-8", "backslashreplace").decode().replace("$", r"\$")
    return f"\N{ZERO WIDTH SPACE}{shown}" if shown.startswith("_") else shown
