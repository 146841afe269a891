"""A ball before a plane that move between the images, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from closed_form import SphereScene, demo_rig, simulate, trace
from fringe3d.decode import stilled
from fringe3d.model import Fringe, ImageStack, PatternPlan

SIZE = (240, 192)
PERIOD_PX = 16.0
PERIODS_PER_MM = -0.1491
"""Of the phase in C1 as plane and ball come towards the rig: the median of what `trace` says."""

MATT = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class Errors:
    """Root mean square errors of the phase, rad, of pixels that see one surface all the time.

    Parameters
    ----------
    moving : of the images as they are
    stilled : of the images without motion
    still_scene : of a scene that does not move, which has noise alone
    """

    moving: float
    stilled: float
    still_scene: float


def plan_of(n_images: int) -> PatternPlan:
    """Return rounds of steps of 90 degrees."""
    steps = tuple(Fringe(period_px=PERIOD_PX, shift=k * np.pi / 2) for k in range(n_images))
    return PatternPlan(patterns=steps, projector_shape=(768, 1024))


def moving_stack(
    n_images: int, mm_per_image: float, *, seed: int = 1
) -> tuple[ImageStack, NDArray[np.float64], NDArray[np.bool_]]:
    """Return C1's images, the true phase in the middle, and which pixels see one surface."""
    rig, plan, rng = demo_rig(camera_size=SIZE), plan_of(n_images), np.random.default_rng(seed)
    camera, projector = rig.cameras[0], rig.projector
    assert projector is not None
    images, usable = [], np.ones(camera.shape, bool)
    middle = trace(camera, projector, _at(0.0))
    for number in range(n_images):
        scene = _at(mm_per_image * (number - (n_images - 1) / 2))
        scan, truths = simulate(rig, plan, scene, rng)
        images.append(scan.stacks[0].images[number])
        same = truths[0].on_sphere == middle.on_sphere
        usable &= binary_erosion(truths[0].lit & same, iterations=2)
    stack = ImageStack(images=np.stack(images), plan=plan, device_name="c1", saturation_dn=255.0)
    phase = 2 * np.pi / PERIOD_PX * (middle.projector_xy[..., 0] + 0.5)
    inside = np.zeros_like(usable)
    inside[8:-8, 8:-8] = True
    return stack, phase, usable & inside


def _at(height_mm: float) -> SphereScene:
    return SphereScene(center_mm=(2.0, -3.0, 2.0 + height_mm), plane_z_mm=-8.0 + height_mm)


def error_of(stack: ImageStack, phase: NDArray[np.float64], usable: NDArray[np.bool_], /) -> float:
    """Return the rms error of the phase by the formula of equal steps, rad."""
    shifts = np.array([p.shift for p in stack.plan.patterns if isinstance(p, Fringe)])
    turned = np.tensordot(np.exp(1j * shifts), stack.images.astype(float), axes=1)
    off = np.angle(turned * np.exp(-1j * phase))[usable]
    return float(np.sqrt(np.mean(off**2)))


def drifting(n_images: int, periods_per_image: float, *, seed: int = 1) -> Errors:
    """Return the errors of a scene whose phase drifts by so many periods from image to image."""
    stack, phase, usable = moving_stack(n_images, periods_per_image / PERIODS_PER_MM, seed=seed)
    still = moving_stack(n_images, 0.0, seed=seed)
    return Errors(
        moving=error_of(stack, phase, usable),
        stilled=error_of(stilled(stack), phase, usable),
        still_scene=error_of(*still),
    )
