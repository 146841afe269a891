"""Sphinx: python -m sphinx -W --keep-going -j auto -b html docs docs/_build."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent / "src"))

from fringe3d import __version__

project = "fringe3d"
copyright = "the authors of fringe3d, Apache-2.0"  # noqa: A001 (Sphinx wants that name)
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "fringe3d"
html_copy_source = False
html_show_sphinx = False

myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # types, shapes and units stand in the docstrings
autodoc_default_options = {"members": True, "show-inheritance": False}
toc_object_entries = False
napoleon_google_docstring = False
napoleon_use_rtype = False

suppress_warnings = ["misc.highlighting_failure"]  # dots in a TOML example stand for numbers


def setup(app: Any) -> None:
    """Footnotes of docstrings stand in pages of Markdown: as text, not as links."""

    def as_text(
        _app: Any, _what: str, _name: str, _of: Any, _options: Any, lines: list[str]
    ) -> None:
        lines[:] = [line.replace("]_", "]").replace(".. [", "[") for line in lines]

    app.connect("autodoc-process-docstring", as_text)
