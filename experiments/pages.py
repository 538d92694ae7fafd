"""HTML pages from Jinja templates: values are escaped, undefined names raise."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined


def render_page(
    templates: Path, filters: dict[str, Callable[..., Any]], styled_as: Path | None = None, **values: Any
) -> str:
    """Render `page.html.j2` of a folder of templates.

    Args:
        templates: the folder; its `style.css` becomes the template's `style`.
        filters: functions for the templates, by name, besides Jinja's own.
        styled_as: another folder, whose `style.css` is used.
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
    style = ((styled_as or templates) / "style.css").read_text(encoding="utf-8")
    return environment.get_template("page.html.j2").render(values, style=style)
