"""HTML and SVG as trees of elements: what is written is well-formed and escaped by construction."""

from xml.etree import ElementTree

Element = ElementTree.Element
Child = Element | str


def el(tag: str, *children: Child | None, **attributes: object) -> Element:
    """An element.

    Args:
        tag: its name.
        children: elements and texts in order; None is left out.
        attributes: ``class_`` stands for class, an underscore within a name for a hyphen; None is left out.
    """
    names = {name.rstrip("_").replace("_", "-"): str(v) for name, v in attributes.items() if v is not None}
    element = Element(tag, names)
    last = None
    for child in children:
        if isinstance(child, str):
            if last is None:
                element.text = (element.text or "") + child
            else:
                last.tail = (last.tail or "") + child
        elif child is not None:
            element.append(child)
            last = child
    return element


def document(root: Element) -> str:
    """The HTML file of an ``html`` element."""
    return "<!DOCTYPE html>\n" + ElementTree.tostring(root, encoding="unicode", method="html") + "\n"


def points(xy) -> str:
    """An SVG point list of (N, 2) coordinates, to a tenth of a unit."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in xy)
