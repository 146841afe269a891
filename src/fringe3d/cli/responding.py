"""``fringe3d calibrate response``: the gamma of projector and cameras, from images."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from fringe3d.cli.calibrating import calibrate
from fringe3d.cli.console import Reporter
from fringe3d.cli.parameters import Json, Overwrite
from fringe3d.cli.scan_options import tell
from fringe3d.model import ImageStack, Response


@calibrate.command
def response(
    scan: Path,
    /,
    *,
    out: Annotated[Path, Parameter(negative=())],
    images: Path | None = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find how grey values follow the patterns: gamma, its curve, and the ripple of the phase.

    From a grey ramp (fringe3d patterns --ramp 17) on a bright surface, or from the fringes of any
    scan. Leaves response.toml in OUT and a picture NAME.png beside it, for fringe3d measure
    --response (the phase) and fringe3d patterns --response (the images to project).
    Example: fringe3d calibrate response scan --out response.toml

    Parameters
    ----------
    scan
        Scan folder or scan file.
    out
        The response file to write.
    images
        Folder of the images, where they do not lie beside the scan file.
    """
    tell(lambda reporter: _run(scan, out, images, reporter, overwrite=overwrite), out,
         as_json=as_json)  # fmt: skip


def _run(
    scan: Path, out: Path, images: Path | None, reporter: Reporter, *, overwrite: bool
) -> tuple[str, dict[str, Any]]:
    from fringe3d.io.atomic import require_writable, write_text
    from fringe3d.io.recording import read_scan
    from fringe3d.io.responsefile import response_text
    from fringe3d.report.response import write_response_picture

    picture = out.with_suffix(".png")
    for target in (out, picture):
        require_writable(target, overwrite=overwrite, inputs=(scan, images))
    recording = read_scan(scan, images=images, with_rig=False, progress=reporter.step)
    found = [_response(stack) for stack in recording.stacks]
    write_text(out, response_text(found), overwrite=overwrite)
    write_response_picture(picture, found, title=f"Response from {scan.name}")
    record = {"cameras": [asdict(one) for one in found], "out": str(out)}
    return "\n".join(_in_words(one) for one in found), record


def _response(stack: ImageStack) -> Response:
    """Return the response by the grey ramp, where there is one, else by the fringes."""
    from fringe3d.decode import ramp_of, response_from_fringes, response_from_ramp

    levels, places = ramp_of(stack.plan)
    if len(levels) > 2:
        return response_from_ramp(stack, levels, places)
    return response_from_fringes(stack)


def _in_words(found: Response) -> str:
    said = f"camera '{found.device_name}': gamma {found.gamma:.2f} (from {found.source})"
    for ripple in found.ripples:
        said += (
            f"\n  {ripple.n_shifts} steps of {ripple.period_px:g} px: the phase ripples by "
            f"{ripple.amplitude:.3f} rad (rms)"
        )
    return said
