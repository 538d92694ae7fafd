"""HTML pages from Jinja templates: values are escaped, undefined names raise."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

_STYLE = Path(__file__).with_name("page.css")


def render_page(templates: Path, filters: dict[str, Callable[..., Any]], **values: Any) -> str:
    """Render `page.html.j2` of a folder of templates.

    Args:
        templates: the folder; its `style.css`, or else the one of all pages, becomes the template's `style`.
        filters: functions for the templates, by name, besides Jinja's own.
        values: what the templates show.
    """
    environment = Environment(
        loader=FileSystemLoader(templates),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= filters
    own = templates / "style.css"
    style = (own if own.exists() else _STYLE).read_text(encoding="utf-8")
    text = environment.get_template("page.html.j2").render(values, style=style)
    # Names of files may be other bytes.
    return text.encode("utf-8", "backslashreplace").decode()
