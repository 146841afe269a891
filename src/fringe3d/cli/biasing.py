"""``fringe3d calibrate bias``: what the calibration of a rig misses, learnt once and stored."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from fringe3d.cli.calibrating import CalibrationOptions, Images, Scans, calibrate, read_scans
from fringe3d.cli.console import Reporter, say
from fringe3d.cli.parameters import Json, Overwrite, at_least
from fringe3d.errors import MethodError, RigError

if TYPE_CHECKING:
    from fringe3d.rig_bias import LearntBias

LARGEST_SIGMA_PX = 0.15
"""A fringe order more moves the points of a nearly symmetric rig by a quarter of a pixel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasOptions(CalibrationOptions):
    """What the user said on the command line; see ``fringe3d calibrate bias --help``."""

    shifts: int | None = None
    gray_bits: int | None = None


@calibrate.command
def bias(
    *,
    from_: Scans,
    out: Path,
    rig: Path | None = None,
    images: Images = None,
    depth: str | None = None,
    shifts: int | None = None,
    gray_bits: Annotated[int | None, Parameter(validator=at_least(0))] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Learn what the calibration of a rig misses, and store it with the rig.

    Leaves the rig with its bias in OUT, and NAME-bias.png beside it: how far points in the second
    camera lie from where the calibration expects them. It is the health figure of a rig. With it
    four images do where the cameras see the projector nearly symmetrically.
    Example: fringe3d calibrate bias --from scan-a --from scan-b --out rig.toml

    Parameters
    ----------
    from_
        Scan folder or scan file, of something with steps and slopes; repeat it for several scans
        of the same rig. Four fringe images do; a Gray code, where there is one, makes it sure.
    out
        The rig file to write.
    rig
        Rig file instead of the scan's own.
    depth
        MIN:MAX, mm along the principal ray of C1; needed where the rig has no volume.
    shifts
        Use only that many of the phase steps.
    gray_bits
        Use only the finest images of each Gray code; 0 for none.
    """
    from fringe3d.io.importing import parse_depth

    options = BiasOptions(
        scans=tuple(from_),
        out=out,
        rig=rig,
        images=tuple(images or ()),
        depth_mm=parse_depth(depth) if depth else None,
        shifts=shifts,
        gray_bits=gray_bits,
        overwrite=overwrite,
    )
    with Reporter(quiet=as_json).running() as reporter:
        text, record = calibrate_bias(options, reporter)
    say(f"{text} -> {out}", record, as_json=as_json)


def calibrate_bias(options: BiasOptions, reporter: Reporter, /) -> tuple[str, dict[str, Any]]:
    """Learn the bias from the scans, and write the rig.

    Returns
    -------
    str, dict
        What to print, and the same as plain data.

    Raises
    ------
    Fringe3DError
        If scans, rig or options do not suffice, several solutions remain, or nothing can be
        written.
    """
    from fringe3d.io.atomic import require_writable, write_text
    from fringe3d.io.rigfile import rig_text
    from fringe3d.options import MeasureOptions
    from fringe3d.report.bias import write_bias_picture
    from fringe3d.rig_bias import LEAST_CERTAINTY, learn_rig_bias

    picture = options.out.with_name(f"{options.out.stem.removesuffix('-bias')}-bias.png")
    for target in (options.out, picture):
        require_writable(target, overwrite=options.overwrite, inputs=options.scans)
    scans = read_scans(options, reporter)
    rig = scans[0].rig
    if rig is None:
        raise RigError(f"{options.scans[0]}: expected a rig, found none. Name one with --rig")
    wanted = MeasureOptions(
        n_shifts=options.shifts, gray_bits=options.gray_bits, depth_mm=options.depth_mm
    )
    reporter.stage("learning the bias")
    learnt = learn_rig_bias(scans, rig, wanted, step=reporter.step)
    if learnt.certainty < LEAST_CERTAINTY:
        raise MethodError(
            f"{', '.join(map(str, options.scans))}: expected one bias that goes with the images, "
            f"found {learnt.n_solutions}; the best has a probability of {learnt.certainty:.0%}. "
            "Take a scan with steps and slopes all over the image, several scans, or one with a "
            "Gray code"
        )
    names = ", ".join(path.name for path in options.scans)
    found = replace(learnt.bias, source=names)
    write_text(options.out, rig_text(replace(rig, bias=found)), overwrite=options.overwrite)
    write_bias_picture(picture, found, rig.cameras[0], title=f"Calibration bias from {names}")
    if found.sigma_px > LARGEST_SIGMA_PX:
        reporter.warn(
            f"the bias is known to {found.sigma_px:.2f} px only, a good one to "
            f"{LARGEST_SIGMA_PX:g} px: measure refines it where surfaces are clear; what is alone "
            "may stay open. Take several scans, or one with a Gray code"
        )
    return _text(learnt), _record(learnt) | {"out": str(options.out)}


def _text(learnt: LearntBias) -> str:
    bias = learnt.bias
    return (
        f"calibration bias: points in the second camera miss by {bias.rms_px:.2f} px (rms over "
        f"image and depth), known to {bias.sigma_px:.2f} px; at most {bias.scatter_px:.2f} px are "
        f"not smooth. {learnt.decided_part:.1%} of the fringe orders are certain"
    )


def _record(learnt: LearntBias) -> dict[str, Any]:
    return {
        "bias_px": learnt.bias.rms_px,
        "sigma_px": learnt.bias.sigma_px,
        "scatter_px": learnt.bias.scatter_px,
        "certainty": learnt.certainty,
        "n_solutions": learnt.n_solutions,
        "decided_part": learnt.decided_part,
    }
