"""Pages from templates, all of one look."""

from __future__ import annotations

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup


def page(template: str, /, **values: Any) -> str:
    """Return a page; what is no `Markup` is text."""
    loader = PackageLoader("fringe3d.report")
    pages = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    script = Markup(loader.get_source(pages, "cloud_view.js")[0])
    return pages.get_template(template).render(script=script, **values)
