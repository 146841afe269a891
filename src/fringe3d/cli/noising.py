"""``fringe3d noise``: the noise model of each camera, from the images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from fringe3d.cli.console import Reporter
from fringe3d.cli.parameters import Json, Overwrite, app
from fringe3d.cli.scan_options import tell
from fringe3d.errors import MethodError

if TYPE_CHECKING:
    from fringe3d.decode import SensorNoise


@app.command
def noise(
    scans: Annotated[list[Path], Parameter(negative=())],
    /,
    *,
    out: Path,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Find how noisy each camera is: read noise, and shot noise per grey value (EMVA 1288).

    One scan tells by what five or more phase steps leave over (eight or more where there is a
    gamma); two or more recordings of the same plan and an unchanged scene tell by their
    differences. Leaves noise.toml in OUT and the photon transfer curve in NAME.png beside it; give
    it to fringe3d measure --noise.
    Example: fringe3d noise scan-a scan-b --out noise.toml

    Parameters
    ----------
    scans
        A scan, or several recordings of the same.
    out
        The noise file to write.
    """
    tell(lambda reporter: _run(scans, out, reporter, overwrite=overwrite), out, as_json=as_json)


def _run(
    paths: list[Path], out: Path, reporter: Reporter, *, overwrite: bool
) -> tuple[str, dict[str, Any]]:
    from fringe3d.decode import noise_from_repeats, noise_from_steps
    from fringe3d.io.atomic import require_writable, write_text
    from fringe3d.io.noisefile import noise_text
    from fringe3d.io.recording import read_scan
    from fringe3d.report.noise import write_noise_picture

    picture = out.with_suffix(".png")
    for target in (out, picture):
        require_writable(target, overwrite=overwrite, inputs=paths)
    scans = [read_scan(path, with_rig=False, progress=reporter.step) for path in paths]
    names = [[stack.device_name for stack in scan.stacks] for scan in scans]
    if any(other != names[0] for other in names):
        raise MethodError(f"noise: expected the same cameras in all recordings, found {names}")
    found = [
        noise_from_steps(stacks[0]) if len(stacks) == 1 else noise_from_repeats(stacks)
        for stacks in zip(*(scan.stacks for scan in scans), strict=True)
    ]
    models = {one.device_name: (one.model, one.source) for one in found}
    write_text(out, noise_text(models), overwrite=overwrite)
    write_noise_picture(picture, found)
    record = {"cameras": [_record(one) for one in found], "out": str(out)}
    return "\n".join(_in_words(one) for one in found), record


def _in_words(found: SensorNoise) -> str:
    model = found.model
    return (
        f"camera '{found.device_name}': read noise {model.read_noise_dn:.3f} +- "
        f"{found.read_sigma_dn:.3f} DN (with rounding), gain {model.gain_dn_per_e:.5f} +- "
        f"{found.gain_sigma:.5f} DN per electron, from {found.source}"
    )


def _record(found: SensorNoise) -> dict[str, Any]:
    return {
        "name": found.device_name,
        "read_noise_dn": found.model.read_noise_dn,
        "read_sigma_dn": found.read_sigma_dn,
        "gain_dn_per_e": found.model.gain_dn_per_e,
        "gain_sigma": found.gain_sigma,
        "source": found.source,
    }
