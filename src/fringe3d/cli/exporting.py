"""``fringe3d export``: a rig for other software."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from fringe3d.cli.console import say
from fringe3d.cli.parameters import Json, Overwrite, app
from fringe3d.errors import RigError
from fringe3d.model import Device, Rig


@app.command
def export(
    rig: Path,
    /,
    *,
    out: Path,
    devices: str | None = None,
    inverse_pose: Annotated[bool, Parameter(negative=())] = False,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Write two devices of a rig as a calibration that OpenCV reads (YAML, XML, JSON).

    Two cameras: M1 D1 M2 D2 R T; camera and projector: cam_K cam_kc pro_K pro_kc R T. Volume, bias
    and covariance stay behind. fringe3d import --calibration reads it back.
    Example: fringe3d export rig.toml --out stereo.yml

    Parameters
    ----------
    rig
        Rig file.
    out
        The file to write: .yml, .yaml, .xml or .json.
    devices
        NAME,NAME: the first becomes the origin; by default the first two cameras, or the camera and
        the projector.
    inverse_pose
        R and T map the second device to the first (OpenCV's map the first to the second).
    """
    from fringe3d.io.atomic import require_writable, write_text
    from fringe3d.io.opencv_calibration import opencv_text
    from fringe3d.io.rigfile import read_rig

    require_writable(out, overwrite=overwrite, inputs=(rig,))
    first, second = _pair(read_rig(rig), devices)
    text = opencv_text(first, second, form=out.suffix, second_from_first=not inverse_pose)
    write_text(out, text, overwrite=overwrite)
    maps = (second.name, first.name) if inverse_pose else (first.name, second.name)
    record = {"out": str(out), "devices": [first.name, second.name], "maps_from": maps[0],
              "maps_to": maps[1]}  # fmt: skip
    say(f"{first.name} and {second.name}, R and T from {maps[0]} to {maps[1]} (mm) -> {out}",
        record, as_json=as_json)  # fmt: skip


def _pair(rig: Rig, names: str | None) -> tuple[Device, Device]:
    if len(rig.devices) < 2:
        raise RigError(f"expected a rig of two devices, found only '{rig.devices[0].name}'")
    if names is None:
        return rig.devices[0], rig.devices[1]
    known = {device.name: device for device in rig.devices}
    wanted = names.split(",")
    if len(wanted) != 2 or len(set(wanted)) < 2 or not set(wanted) <= set(known):
        raise RigError(
            f"--devices: expected two different names of {', '.join(known)}, with a comma between, "
            f"found '{names}'"
        )
    return known[wanted[0]], known[wanted[1]]
