"""What the cameras saw of a scan that was measured."""

from __future__ import annotations

from pathlib import Path

from fringe3d.decode import decode
from fringe3d.errors import Fringe3DError
from fringe3d.io.recording import read_scan
from fringe3d.io.stored import StoredResult, angle_of
from fringe3d.model import PhaseMap


def seen_phases(stored: StoredResult, /) -> dict[str, PhaseMap]:
    """Return the phases of the cameras, by name; none where the scan is not found.

    They are decoded from the images again, along the direction of the fringes that the points rest
    on. Paths are those of the command that measured, so this finds them from the same folder.
    """
    request = stored.record.get("request", {})
    if "scan" not in request:
        return {}
    images, rig = (Path(request[k]) if k in request else None for k in ("images", "rig"))
    try:
        scan = read_scan(Path(request["scan"]), images=images, rig=rig)
        wanted = angle_of(stored.record["decoding"][0]["direction"])
        shape = scan.rig.projector.shape if scan.rig and scan.rig.projector else None
        found: dict[str, PhaseMap] = {}
        for stack in scan.stacks:
            camera = decode(stack, shape)
            maps = [d.main for d in camera.directions if abs(d.main.angle - wanted) < 1e-3]
            if maps:
                found[stack.device_name] = maps[0]
    except (Fringe3DError, OSError):
        return {}
    return found
