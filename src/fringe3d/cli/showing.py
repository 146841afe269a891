"""``fringe3d report`` and ``fringe3d view``: results for people."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import rich
from cyclopts import Parameter

from fringe3d.cli.console import say
from fringe3d.cli.parameters import Json, Overwrite, app, at_least, view_installed
from fringe3d.errors import MethodError


@app.command
def report(
    result: Path,
    /,
    *,
    out: Path | None = None,
    pdf: Annotated[bool, Parameter(negative=())] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write a result as one HTML page to look at, keep and pass on.

    What was measured, with which images, a small 3D view, pictures, figures, rejected pixels by
    reason, health, and what to do better. It needs no network. Designs, calibrations, acceptance
    tests, comparisons and merges become a page of the same look.
    Examples: fringe3d report result; fringe3d report design --pdf; fringe3d report rig.toml

    Parameters
    ----------
    result
        Folder that fringe3d measure, merge, design, evaluate acceptance or evaluate compare left;
        or the rig.toml that fringe3d calibrate left, with its report beside.
    out
        The page; RESULT/report.html by default, RIG-report.html for a rig.
    pdf
        Write a PDF instead, printed by Chromium, Chrome or Edge.
    """
    from fringe3d.cli.viewing import report_of
    from fringe3d.io.atomic import new_file, require_writable

    ending = ".pdf" if pdf else ".html"
    beside = result.with_name(f"{result.stem}-report{ending}")
    target = out or (result / f"report{ending}" if result.is_dir() else beside)
    text, inputs = report_of(result)
    require_writable(target, overwrite=overwrite, inputs=inputs)
    content = text.encode()
    if pdf:
        from fringe3d.report.pdf import pdf_of

        content = pdf_of(text)
    with new_file(target, overwrite=overwrite) as aside:
        aside.write_bytes(content)
    record = {"out": str(target), "bytes": len(content)}
    say(f"{len(content) / 1e6:.1f} MB -> {target}", record, as_json=as_json)


@app.command
def view(
    *results: Path,
    host: str = "127.0.0.1",
    port: Annotated[int, Parameter(validator=at_least(1, 65535))] = 8080,
    points: Annotated[int, Parameter(validator=at_least(1))] = 1_000_000,
    reference: Path | None = None,
    html: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Show results in three dimensions, in the browser; Ctrl-C ends it.

    Points or surfaces coloured by depth, brightness, sigma, order probability, residual or
    deviation; the rig with its measuring volume; rejected pixels by reason; and of each pixel the
    viewing ray, the candidates on it, their light sheets, and how well each fits what the second
    camera sees. Several results stand side by side: methods compared.
    Examples: fringe3d view result; fringe3d view full reduced four; fringe3d view scan

    Parameters
    ----------
    results
        Folders that fringe3d measure left; or scans (folder or scan file), which are measured with
        the defaults first and not kept.
    host
        Address to listen on: by default only this machine can see the page; 0.0.0.0 for all.
    port
        The next free one is taken where it is in use.
    points
        Show at most so many of each; more are thinned at random.
    reference
        Another result, a cloud (PLY, XYZ, NPZ) or a mesh (STL, OBJ) in the same frame, mm: points
        can be coloured by their deviation from it.
    html
        Write the points of one result as a page that needs no network instead, and end.
    """
    from fringe3d.cli.viewing import compared_with, shown_results, write_page

    if not results:
        raise MethodError("view: expected a result or a scan, found none. See fringe3d view --help")
    found = shown_results(results, quiet=as_json)
    if reference is not None:
        found = [(compared_with(reference, stored), phases) for stored, phases in found]
    if html is not None:
        n_bytes = write_page(html, found, points, overwrite=overwrite)
        record = {"out": str(html), "bytes": n_bytes}
        say(f"{n_bytes / 1e6:.1f} MB -> {html}", record, as_json=as_json)
        return
    with view_installed("view", ". Without them: --html FILE, or fringe3d report"):
        from fringe3d.view.live import LiveView
    rich.reconfigure(quiet=True)  # the banner of the server, on standard output
    live = LiveView([stored for stored, _ in found], host=host, port=port, most_points=points,
                    phases=lambda stored: next(f() for s, f in found if s is stored))  # fmt: skip
    shown = [str(result) for result in results]
    try:
        say(f"{live.address} shows {', '.join(shown)}; Ctrl-C ends it",
            {"address": live.address, "results": shown}, as_json=as_json)  # fmt: skip
        live.server.sleep_forever()
    except KeyboardInterrupt:
        live.server.stop()
