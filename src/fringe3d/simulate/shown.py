"""What a projector shows, image by image, and cameras that look at it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.simulate.render import Levels, Stage, emitted, light_on, moved, unsteady
from fringe3d.simulate.sensor import expose


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """What a projector shows at one moment, ready to be seen by cameras.

    Parameters
    ----------
    stage : Stage; the scene at that moment
    levels : light for increasing blur, with its first variance and step, px**2
    lamp : float; brightness of the lamp, 1 on average
    shift : (2,) float, projector px; how far the picture is off its place
    """

    stage: Stage
    levels: Levels
    lamp: float
    shift: NDArray[np.float64]


def show(
    stage: Stage,
    image: NDArray[np.unsignedinteger[Any]],
    /,
    *,
    place: int,
    n_images: int,
    seed: int,
    position: int = 0,
) -> Shown:
    """Show one image of the projector's memory, as `record` does with the patterns of a plan.

    Parameters
    ----------
    stage : Stage
    image : (row, col) of the projector, uint8 or uint16
    place, n_images : int; which image of a sequence of how many it is: for what moves or flickers
    seed, position : int; as for `record`
    """
    lamp, shifts = unsteady(stage, n_images, seed, position)
    now = moved(stage, place, n_images)
    return Shown(now, emitted(image, now), float(lamp[place]), shifts[place])


def see(
    shown: Shown,
    number: int,
    rng: np.random.Generator,
    hot: NDArray[np.float32],
    /,
    *,
    exposure: float = 1.0,
) -> NDArray[np.unsignedinteger[Any]]:
    """Expose one camera to what the projector shows.

    Parameters
    ----------
    shown : Shown
    number : int; of the camera in the rig
    rng : Generator; of the noise
    hot : (row, col) float32; from `hot_of`
    exposure : float; factor on the exposure of the camera
    """
    now = shown.stage
    light = light_on(now, number, shown.levels, shown.lamp, shown.shift)
    camera = now.setup.camera
    optics = camera if exposure == 1 else replace(camera, exposure=camera.exposure * exposure)
    return expose(light.reshape(now.rig.cameras[number].shape), optics, rng, hot)
