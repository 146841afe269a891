"""``fringe3d report``: results for people."""

from __future__ import annotations

from pathlib import Path

from fringe3d.cli.console import say
from fringe3d.cli.parameters import Json, Overwrite, app


@app.command
def report(
    result: Path,
    /,
    *,
    out: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write a result as one HTML page to look at, keep and pass on.

    What was measured, with which images, a small 3D view, pictures, figures, rejected pixels by
    reason, health, and what to do better. It needs no network.
    Example: fringe3d report result

    Parameters
    ----------
    result
        Folder that fringe3d measure left.
    out
        The page; RESULT/report.html by default.
    """
    from fringe3d.io.atomic import require_writable, write_text
    from fringe3d.io.stored import read_result
    from fringe3d.report.measurement import report_html

    target = out or result / "report.html"
    stored = read_result(result)
    require_writable(target, overwrite=overwrite, inputs=(result / "measure.toml",))
    text = report_html(stored)
    write_text(target, text, overwrite=overwrite)
    record = {"out": str(target), "bytes": len(text.encode())}
    say(f"{len(text.encode()) / 1e6:.1f} MB -> {target}", record, as_json=as_json)
