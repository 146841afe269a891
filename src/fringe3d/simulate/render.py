"""From a rig, a scene and a plan to a recording with its truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringe3d.model import (
    Device,
    ImageStack,
    Pattern,
    PatternPlan,
    Rig,
    RigidTransform,
    Scan,
)
from fringe3d.patterns import pattern_image
from fringe3d.simulate._sampling import OVERSAMPLING, collect
from fringe3d.simulate.bounce import Bounce, bounce
from fringe3d.simulate.footprint import Footprint, footprint
from fringe3d.simulate.optics import CameraOptics, ProjectorOptics, Recording
from fringe3d.simulate.scene import Scene
from fringe3d.simulate.sensor import expose, hot_pixels
from fringe3d.simulate.truth import Truth, trace

RAYS_THROUGH_PUPIL = 9
"""From a grid of 3 x 3 on, places in the pixel and in the pupil are independent."""

MAX_BLUR_STEP = 0.5
"""px**2 between blur levels; linear interpolation between them then changes the modulation of
fringes of 16 px by less than 0.03 %."""

MAX_BLUR_LEVELS = 24
"""They bound the memory; strong defocus over a deep scene is interpolated more coarsely (1 % of the
modulation of fringes of 8 px over a range of 23 px**2)."""

Progress = Callable[[str, int, int], None]

Levels = tuple[NDArray[np.float32], float, float]
"""Projected light for increasing blur: images, first variance and step, px**2."""


def _silent(_work: str, _done: int, _total: int) -> None:
    pass


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """The imperfect world around the rig.

    Parameters
    ----------
    camera, projector, recording : optics and events
    n_rays : 1, 4, 9 or 16 rays for each pixel; at least 9 with an open aperture of the camera

    Raises
    ------
    ValueError
        If there are too few rays for an open aperture.
    """

    camera: CameraOptics = field(default_factory=CameraOptics)
    projector: ProjectorOptics = field(default_factory=ProjectorOptics)
    recording: Recording = field(default_factory=Recording)
    n_rays: int = 4

    def __post_init__(self) -> None:
        if self.camera.aperture_mm and self.n_rays < RAYS_THROUGH_PUPIL:
            raise ValueError(
                f"camera: aperture_mm: expected at least {RAYS_THROUGH_PUPIL} rays for each pixel "
                f"to spread over the pupil, found {self.n_rays}. Take more (--rays)"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A scene seen by a rig: everything that does not depend on the patterns.

    Make it once, record it with as many plans and seeds as you like.
    """

    rig: Rig
    scene: Scene
    setup: Setup
    truths: tuple[Truth, ...]
    paths: tuple[Footprint, ...]
    bounces: tuple[Bounce | None, ...]


def prepare(
    rig: Rig, scene: Scene, setup: Setup | None = None, /, *, progress: Progress = _silent
) -> Stage:
    """Cast all rays of a rig into a scene.

    Parameters
    ----------
    rig : Rig with a projector
    scene : Scene
    setup : Setup or None (defaults)
    progress : called as the cameras are done

    Raises
    ------
    ValueError
        If there is no projector, or no camera sees the object lit.
    """
    if rig.projector is None:
        raise ValueError("simulate: expected a rig with a projector, found none")
    setup = setup or Setup()
    truths, paths, bounces = [], [], []
    for number, camera in enumerate(rig.cameras):
        truths.append(trace(camera, rig, scene))
        paths.append(_follow(camera, rig, scene, setup))
        bounces.append(_bounce(camera, rig, scene, setup, truths[-1]))
        progress("casting rays", number + 1, len(rig.cameras))
    if not any((truth.is_object & truth.lit).any() for truth in truths):
        raise ValueError(
            "simulate: expected a camera that sees the object lit, found none. Move the object "
            "into the view of cameras and projector"
        )
    return Stage(rig, scene, setup, tuple(truths), tuple(paths), tuple(bounces))


def record(
    stage: Stage,
    plan: PatternPlan,
    /,
    *,
    seed: int,
    position: int = 0,
    title: str = "",
    progress: Progress = _silent,
) -> Scan:
    """Project a plan and record it with all cameras.

    Parameters
    ----------
    stage : Stage
    plan : PatternPlan
    seed : int; the same seed gives the same bytes
    position : int; number of the scan in a series: other noise, the same hot pixels
    title : str
    progress : called as the images are made

    Returns
    -------
    Scan
        One stack for each camera. Images after a dropped one move up; what then is missing at
        the end is black.

    Raises
    ------
    ValueError
        If dropped or repeated images are not in the plan.
    """
    shown = _shown(plan.n_images, stage.setup.recording)
    lamp, shifts = unsteady(stage, len(shown), seed, position)
    images = [
        np.zeros((plan.n_images, *camera.shape), _dtype(stage)) for camera in stage.rig.cameras
    ]
    hot = [hot_of(stage, number, seed=seed) for number in range(len(stage.rig.cameras))]
    black, levels = None, (np.empty((0, 0, 0), np.float32), 0.0, 1.0)
    for place, (moment, index) in enumerate(shown):
        now = moved(stage, moment, plan.n_images)
        if plan.patterns[index] is not black or now is not stage:
            black = plan.patterns[index]
            levels = _projected(black, now)
        for number, camera in enumerate(now.rig.cameras):
            light = light_on(now, number, levels, float(lamp[place]), shifts[place])
            rng = np.random.default_rng([seed, 2, position, number, place])
            images[number][place] = expose(
                light.reshape(camera.shape), now.setup.camera, rng, hot[number]
            )
        progress("recording", place + 1, len(shown))
    stacks = [
        _stack(stack, plan, camera, stage.setup.camera)
        for stack, camera in zip(images, stage.rig.cameras, strict=True)
    ]
    return Scan(stacks=tuple(stacks), rig=stage.rig, title=title)


def hot_of(stage: Stage, number: int, /, *, seed: int) -> NDArray[np.float32]:
    """Return the offsets of a camera's hot pixels; those of `record` with the same seed."""
    rng = np.random.default_rng([seed, 1, number])
    return hot_pixels(stage.rig.cameras[number].shape, stage.setup.camera, rng)


def unsteady(
    stage: Stage, n_images: int, seed: int, position: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lamp's brightness (n_images,) and the projector's shifts (n_images, 2), px."""
    shake = np.random.default_rng([seed, 0, position])
    lamp = 1 + stage.setup.projector.flicker * shake.standard_normal(n_images)
    return lamp, stage.setup.projector.vibration_px * shake.standard_normal((n_images, 2))


def record_exposures(
    stage: Stage, plan: PatternPlan, exposures: Sequence[float], /, *, seed: int, title: str = ""
) -> list[Scan]:
    """Record a plan once for each of several multiples of the camera's exposure."""
    scans = []
    for number, factor in enumerate(exposures):
        camera = replace(stage.setup.camera, exposure=stage.setup.camera.exposure * factor)
        lit = replace(stage, setup=replace(stage.setup, camera=camera))
        scans.append(record(lit, plan, seed=seed + 1000 * number, title=title))
    return scans


def _follow(camera: Device, rig: Rig, scene: Scene, setup: Setup) -> Footprint:
    assert rig.projector is not None
    return footprint(camera, rig.projector, scene, setup.camera, setup.projector,
                     n_rays=setup.n_rays, reference_mm=reference_point(rig))  # fmt: skip


def _bounce(camera: Device, rig: Rig, scene: Scene, setup: Setup, truth: Truth) -> Bounce | None:
    assert rig.projector is not None
    if not setup.recording.interreflection:
        return None
    return bounce(camera, rig.projector, scene, setup.projector, truth,
                  reference_mm=reference_point(rig))  # fmt: skip


def reference_point(rig: Rig, /) -> NDArray[np.float64]:
    """Return where brightness and focus are set, (3,), mm: the point nearest to all axes.

    Of parallel axes, the one of these points that is nearest to the world's origin.
    """
    normals = np.zeros((3, 3))
    moment = np.zeros(3)
    for device in rig.devices:
        forward = device.device_from_world.rotation[2]
        across = np.eye(3) - np.outer(forward, forward)
        normals += across
        moment += across @ device.center_world
    return np.asarray(np.linalg.lstsq(normals, moment)[0], np.float64)


def _shown(n_images: int, recording: Recording) -> list[tuple[int, int]]:
    """Return for each recorded image its place in the sequence, and which pattern it shows."""
    for key in ("dropped", "repeated"):
        wrong = [i for i in getattr(recording, key) if not 0 <= i < n_images]
        if wrong:
            raise ValueError(
                f"recording: {key}: expected places 0 to {n_images - 1} of the plan's images, "
                f"found {wrong}"
            )
    if len(set(recording.dropped)) == n_images:
        raise ValueError("recording: dropped: expected at least one image to arrive, found none")
    shown = list(range(n_images))
    for place in sorted(recording.repeated):
        shown[place] = shown[max(place - 1, 0)]
    return [both for both in enumerate(shown) if both[0] not in recording.dropped]


def moved(stage: Stage, place: int, n_images: int) -> Stage:
    """Return the stage at the time of an image; the truth holds in the middle of the sequence."""
    recording = stage.setup.recording
    if not recording.moves:
        return stage
    seconds = (place - (n_images - 1) / 2) * recording.frame_ms / 1000
    turn = Rotation.from_euler("z", recording.spin_deg_s * seconds, degrees=True)
    motion = RigidTransform(
        rotation=turn.as_matrix(), translation=np.asarray(recording.velocity_mm_s) * seconds
    )
    scene = stage.scene.placed(motion @ stage.scene.world_from_object)
    paths = tuple(_follow(camera, stage.rig, scene, stage.setup) for camera in stage.rig.cameras)
    # The light between surfaces is smooth: that of the middle position will do.
    return replace(stage, scene=scene, paths=paths)


def _projected(pattern: Pattern, stage: Stage) -> Levels:
    """Return the projected light for increasing blur: images, first variance and step, px**2."""
    projector = stage.rig.projector
    assert projector is not None
    return emitted(pattern_image(pattern, projector.shape), stage)


def emitted(image: NDArray[np.unsignedinteger[Any]], stage: Stage) -> Levels:
    """Return the projected light of an image of the projector."""
    light = stage.setup.projector
    shown = image.astype(np.float32) / np.iinfo(image.dtype).max
    bright = light.dark + (1 - light.dark) * shown ** np.float32(light.gamma)
    fine = bright.repeat(OVERSAMPLING, axis=0).repeat(OVERSAMPLING, axis=1)
    first, step, n_levels = _blur_levels(stage)
    levels = np.empty((n_levels, *fine.shape), np.float32)
    for level in range(n_levels):
        sigma = OVERSAMPLING * math.sqrt(first + level * step)
        levels[level] = (
            cv2.GaussianBlur(fine, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
            if sigma > 0
            else fine
        )
    return levels, first, step


def _blur_levels(stage: Stage) -> tuple[float, float, int]:
    lit = [path.blur[path.direct > 0] for path in stage.paths]
    low = min(float(blur.min(initial=np.inf)) for blur in lit)
    high = max(float(blur.max(initial=-np.inf)) for blur in lit)
    n_levels = min(max(2, math.ceil((high - low) / MAX_BLUR_STEP) + 1), MAX_BLUR_LEVELS)
    return low, max((high - low) / (n_levels - 1), 1e-6), n_levels


def light_on(
    stage: Stage, number: int, levels: Levels, lamp: float, shift: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the light on the sensor, (n_pixels,), 1 for white paper."""
    path, extra = stage.paths[number], stage.bounces[number]
    light = np.empty(len(path.ambient), np.float32)
    images, first, step = levels
    collect(images, first, step, path.u, path.v, path.blur, path.direct, shift[0], shift[1], light)
    if extra is not None:
        light += extra.light(levels, shift) * path.ambient
    return np.asarray(light * np.float32(lamp) + path.ambient * stage.setup.recording.ambient,
                      np.float32)  # fmt: skip


def _dtype(stage: Stage) -> type[np.unsignedinteger[Any]]:
    return np.uint8 if stage.setup.camera.bit_depth == 8 else np.uint16


def _stack(
    images: NDArray[np.unsignedinteger[Any]],
    plan: PatternPlan,
    camera: Device,
    optics: CameraOptics,
) -> ImageStack:
    return ImageStack(
        images=images,
        plan=plan,
        device_name=camera.name,
        saturation_dn=optics.top_dn,
        black_level_dn=optics.black_level_dn,
        noise=optics.noise if optics.gamma == 1 else None,
    )
