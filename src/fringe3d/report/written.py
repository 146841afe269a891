"""Reports that were written as Markdown with pictures, as one page: designs, calibrations, ..."""

from __future__ import annotations

import base64
import re
from pathlib import Path

from markdown_it import MarkdownIt
from markupsafe import Markup

from fringe3d.errors import MethodError
from fringe3d.report.pages import page
from fringe3d.report.written_cloud import cloud_beside

IN_FOLDERS = ("design.md", "acceptance.md", "compare.md", "paper.md", "merge.md")
BESIDE_RIGS = ("-board.md", "-projector.md")
KINDS = {".png": "image/png", ".jpg": "image/jpeg", ".gif": "image/gif"}


def written_report(path: Path, /) -> Path | None:
    """Return the Markdown report of a design, acceptance, comparison or calibration.

    Parameters
    ----------
    path : Path; the report itself, the folder that holds it, or the ``rig.toml`` that a
        calibration left with its report beside

    Returns
    -------
    Path or None; None if there is none
    """
    if path.suffix == ".md" and path.is_file():
        return path
    if path.is_dir():
        candidates = [path / name for name in IN_FOLDERS]
    else:
        candidates = [path.with_name(path.stem + ending) for ending in BESIDE_RIGS]
    return next((file for file in candidates if file.is_file()), None)


def written_html(report: Path, /) -> str:
    """Return a report as one HTML page without links to anything outside.

    Parameters
    ----------
    report : Path; Markdown; what looks like HTML in it is text

    Raises
    ------
    MethodError
        If it is not text.
    """
    try:
        text = report.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise MethodError(f"{report}: expected a report as text, found other bytes") from None
    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    body = re.sub(r'<img src="([^"]*)"', lambda found: _embedded(report, found[1]), body)
    body = re.sub(r'<a href="(?!#)[^"]*">(.*?)</a>', r"\1", body)  # it leads nowhere from here
    title = re.search(r"^# (.+)$", text, flags=re.M)
    cloud = cloud_beside(report)
    return page("written.html", title=title[1] if title else report.stem, body=Markup(body),
                cloud=cloud)  # fmt: skip


def _embedded(report: Path, target: str) -> str:
    """Return an image tag whose picture is in it; only files beside the report are taken."""
    picture = report.parent / Path(target).name
    if not picture.is_file() or picture.suffix not in KINDS:
        return '<img src="data:,"'
    data = base64.b64encode(picture.read_bytes()).decode("ascii")
    return f'<img src="data:{KINDS[picture.suffix]};base64,{data}"'
