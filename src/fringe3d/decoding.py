"""What the cameras show: the images that a method needs, decoded, filtered and looked at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fringe3d.decode import (
    CameraPhases,
    centred_camera,
    decode,
    decode_apart,
    filtered_camera,
    mixed_camera,
    response_from_fringes,
    without_saturated,
)
from fringe3d.errors import MethodError
from fringe3d.health import Finding, check_files, check_phases
from fringe3d.kernels import alongside
from fringe3d.matching import best_direction_first, followed, followed_from_points
from fringe3d.methods import Choice, choose_method, images_of, settle
from fringe3d.model import Device, ImageStack, MeasuringVolume, PhaseMap, Rig, Scan
from fringe3d.options import MeasureOptions, keep_images, volume_of


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """Phases with fringe orders that go on from a frame before.

    Parameters
    ----------
    phases : tuple of CameraPhases
    after : tuple of CameraPhases; those of the frame before
    """

    phases: tuple[CameraPhases, ...]
    after: tuple[CameraPhases, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Decoded:
    """Phases of all cameras, and the method that is to make points of them.

    Parameters
    ----------
    phases : tuple of CameraPhases, one for each camera; the best direction first
    choice : Choice; the method, and why
    n_images : int; of each camera, that the method uses
    rig : Rig or None
    volume : MeasuringVolume or None
    findings : callable; waits for the checks of images and phases, and returns what they found
    carried : Carried or None; orders that go on from a frame before, in a stream
    """

    phases: tuple[CameraPhases, ...]
    choice: Choice
    n_images: int
    rig: Rig | None
    volume: MeasuringVolume | None
    findings: Callable[[], Sequence[Finding]]
    carried: Carried | None = None

    @property
    def main(self) -> PhaseMap:
        """Return the phase map of C1 that points rest on."""
        return self.phases[0].directions[0].main

    def devices(self) -> tuple[Device, Device]:
        """Return C1, and the second camera or the projector."""
        assert self.rig is not None
        return _devices(self.rig, [p.directions[0].main.device_name for p in self.phases],
                        self.choice.method)  # fmt: skip


def decoded(scan: Scan, options: MeasureOptions, /) -> Decoded:
    """Decode the images of a scan that the method needs.

    Raises
    ------
    MethodError
        If plan and rig do not support the method.
    """
    rig = scan.rig
    stacks = [keep_images(stack, options) for stack in scan.stacks]
    choice = choose_method(rig, stacks, options)
    volume = volume_of(rig, stacks[0].device_name, options)
    stacks = [images_of(choice, stack, rig, volume, options) for stack in stacks]
    used = [_without_saturated(stack, options) for stack in stacks]
    phases = tuple(_decode(stack, rig, choice.method, options) for stack in used)
    findings = alongside(_check_images, used, phases)
    phases = _filtered(phases, used, options)
    if rig is not None and choice.method != "projector":
        names = [stack.device_name for stack in used]
        phases = best_direction_first(phases, *_devices(rig, names, choice.method))
    main = phases[0].directions[0].main
    return Decoded(phases=phases, choice=settle(choice, main, rig, volume, options),
                   n_images=used[0].plan.n_images, rig=rig, volume=volume,
                   findings=findings)  # fmt: skip


def carried_on(shown: Decoded, after: tuple[CameraPhases, ...], /) -> Decoded:
    """Return it with the fringe orders that go on from absolute phases of the frame before."""
    return replace(shown, carried=Carried(followed(shown.phases, after), after))


def carried_from_points(
    shown: Decoded, after: tuple[CameraPhases, ...], points_mm: NDArray[np.float64], /
) -> Decoded:
    """Return it with those that go on from points (row, col, 3), mm, whose phases have no orders.

    Raises
    ------
    MethodError
        If there is no second camera, or no calibrated projector, which tells where they were lit.
    """
    other = shown.devices()[1]
    projector = shown.rig.projector if shown.rig is not None else None
    if other.role != "camera" or projector is None:
        raise MethodError(
            "follow: expected two cameras and a calibrated projector, which tells where points "
            "were lit. Measure this frame without the one before"
        )
    phases = followed_from_points(shown.phases, other, projector, points_mm)
    return replace(shown, carried=Carried(phases, after))


def _without_saturated(stack: ImageStack, options: MeasureOptions) -> ImageStack:
    """Leave saturated steps out where enough others are left, the projector's response known."""
    if options.own_response:
        stack = stack.with_response(response_from_fringes(stack))
    return without_saturated(stack)


def _decode(
    stack: ImageStack, rig: Rig | None, method: str, options: MeasureOptions
) -> CameraPhases:
    """Decode one camera; two directions of Gray code alone give the projector's whole pixels."""
    shape = rig.projector.shape if rig is not None and rig.projector is not None else None
    if method == "m6":
        return decode_apart(stack, shape, min_modulation_dn=options.min_modulation_dn)
    return decode(
        stack,
        shape,
        min_modulation_dn=options.min_modulation_dn,
        whole_cells=method == "projector" and len(stack.plan.angles) > 1,
    )


def _filtered(
    phases: tuple[CameraPhases, ...], stacks: Sequence[ImageStack], options: MeasureOptions
) -> tuple[CameraPhases, ...]:
    """Return the phases filtered, and at pixel centres; the first camera is looked at in its
    pixels alone. A series of exposures sees dark pixels beside bright ones."""
    found, blur = [], options.blur_px
    for i, camera in enumerate(phases):
        smooth = filtered_camera(camera, options.filter, is_first=i == 0)
        if blur is not None:
            smooth = centred_camera(smooth, blur_px=blur, is_first=i == 0)
            if stacks[i].fused is not None:
                smooth = mixed_camera(smooth, blur_px=blur)
        found.append(smooth)
    return tuple(found)


def _check_images(
    stacks: Sequence[ImageStack], phases: Sequence[CameraPhases]
) -> Sequence[Finding]:
    return [*check_files(stacks), *check_phases(phases)]


def _devices(rig: Rig, names: Sequence[str], method: str) -> tuple[Device, Device]:
    cameras = {camera.name: camera for camera in rig.cameras}
    if method == "projector":
        assert rig.projector is not None
        return cameras[names[0]], rig.projector
    return cameras[names[0]], cameras[names[1]]
