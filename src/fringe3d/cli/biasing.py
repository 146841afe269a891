"""``fringe3d calibrate bias``: what the calibration of a rig misses, learnt once and stored."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from fringe3d.cli.calibrating import calibrate
from fringe3d.cli.console import Reporter
from fringe3d.cli.parameters import Json
from fringe3d.cli.scan_options import SomeImagesOptions, read_scans, tell
from fringe3d.errors import MethodError, RigError

if TYPE_CHECKING:
    from fringe3d.rig_bias import LearntBias

LARGEST_SIGMA_PX = 0.15
"""A fringe order more moves the points of a nearly symmetric rig by a quarter of a pixel."""


@calibrate.command
def bias(*, options: SomeImagesOptions, as_json: Json = False) -> None:
    """Learn what the calibration of a rig misses, and store it with the rig.

    Takes scans of something with steps and slopes: four fringe images do; a Gray code, where there
    is one, makes it sure. Leaves the rig with its bias in OUT, and NAME-bias.png beside it: how far
    points in the second camera lie from where the calibration expects them. It is the health figure
    of a rig. With it four images do where the cameras see the projector nearly symmetrically.
    Example: fringe3d calibrate bias --from scan-a --from scan-b --out rig.toml
    """
    tell(lambda reporter: calibrate_bias(options, reporter), options.out, as_json=as_json)


def calibrate_bias(options: SomeImagesOptions, reporter: Reporter, /) -> tuple[str, dict[str, Any]]:
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
    from fringe3d.report.bias import write_bias_picture
    from fringe3d.rig_bias import LEAST_CERTAINTY, learn_rig_bias

    picture = options.out.with_name(f"{options.out.stem.removesuffix('-bias')}-bias.png")
    for target in (options.out, picture):
        require_writable(target, overwrite=options.overwrite, inputs=options.from_)
    scans = read_scans(options, reporter)
    rig = scans[0].rig
    if rig is None:
        raise RigError(f"{options.from_[0]}: expected a rig, found none. Name one with --rig")
    reporter.stage("learning the bias")
    learnt = learn_rig_bias(scans, rig, options.measuring, step=reporter.step)
    if learnt.certainty < LEAST_CERTAINTY:
        raise MethodError(
            f"{', '.join(map(str, options.from_))}: expected one bias that goes with the images, "
            f"found {learnt.n_solutions}; the best has a probability of {learnt.certainty:.0%}. "
            "Take a scan with steps and slopes all over the image, several scans, or one with a "
            "Gray code"
        )
    names = ", ".join(path.name for path in options.from_)
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
