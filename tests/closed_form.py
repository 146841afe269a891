"""A sphere before a plane, rendered in closed form: rays, shadows and truth without a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.geometry import pixel_grid, project, rays
from fringe3d.model import (
    Device,
    ImageStack,
    MeasuringVolume,
    NoiseModel,
    PatternPlan,
    Rig,
    RigidTransform,
    Scan,
)
from fringe3d.patterns import intensity, sequence

Points = NDArray[np.float64]

DEMO_NOISE = NoiseModel(read_noise_dn=0.8, gain_dn_per_e=0.01)


@dataclass(frozen=True, slots=True, kw_only=True)
class SphereScene:
    """A sphere before a plane, lit by the projector and by ambient light.

    Parameters
    ----------
    center_mm, radius_mm : centre (3,) and radius of the sphere, world frame
    plane_z_mm : float; the plane z = plane_z_mm; the devices look along -z
    light_dn : float, DN; brightness of white paper facing the projector
    ambient_dn : float, DN; brightness without the projector
    black_level_dn : float, DN
    noise : NoiseModel
    gamma : float; the projector turns an intensity v into v**gamma
    """

    center_mm: tuple[float, float, float] = (2.0, -3.0, 2.0)
    radius_mm: float = 9.0
    plane_z_mm: float = -8.0
    light_dn: float = 190.0
    ambient_dn: float = 8.0
    black_level_dn: float = 0.0
    noise: NoiseModel = DEMO_NOISE
    gamma: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """What is true for each pixel of a camera, (row, col, ...).

    Parameters
    ----------
    points_mm : (row, col, 3); world frame
    projector_xy : (row, col, 2), px
    lit : (row, col); the projector lights the point
    on_sphere : (row, col)
    """

    points_mm: Points
    projector_xy: Points
    lit: NDArray[np.bool_]
    on_sphere: NDArray[np.bool_]


Recording = tuple[Scan, tuple[Truth, ...]]


def demo_rig(*, camera_size: tuple[int, int] = (640, 512)) -> Rig:
    """Return a rig like that of the source paper: two cameras and a projector above a table.

    Cameras at a tilt of 27 deg and azimuths of +-31 deg, the projector at 22 deg; distance
    335 mm; volume 80 mm wide and 25 mm high; strong distortion in all lenses.

    Parameters
    ----------
    camera_size : (width, height), px
    """
    width, height = camera_size
    scale = width / 640

    def camera(name: str, azimuth_deg: float, distortion: ArrayLike) -> Device:
        return Device(
            name=name,
            role="camera",
            n_rows=height,
            n_cols=width,
            focal_px=np.array([2300.0, 2302.0]) * scale,
            center_px=[(width - 1) / 2 + 3.0, (height - 1) / 2 - 5.0],
            distortion=distortion,
            device_from_world=above_table(27.0, azimuth_deg),
        )

    projector = Device(
        name="projector",
        role="projector",
        n_rows=768,
        n_cols=1024,
        focal_px=[3215.0, 3218.0],
        center_px=[515.0, 371.0],
        distortion=[-0.12, 0.3, 0.0012, -0.0008, 0.0],
        device_from_world=above_table(22.0, 0.0),
    )
    return Rig(
        cameras=(
            camera("c1", -31.0, [-0.21, 0.35, 0.0007, -0.0011, 0.0]),
            camera("c2", 31.0, [-0.19, 0.28, -0.0009, 0.0006, 0.0]),
        ),
        projector=projector,
        volume=MeasuringVolume.cylinder([0, 0, 0], [0, 0, 1], radius_mm=45.0, height_mm=25.0),
        provenance="fringe3d demo rig",
    )


def above_table(
    tilt_deg: float, azimuth_deg: float, distance_mm: float = 335.0, /
) -> RigidTransform:
    """Return the pose of a device that looks at the origin, its rows along the world's x."""
    tilt, azimuth = np.radians([tilt_deg, azimuth_deg])
    position = distance_mm * np.array(
        [np.sin(tilt) * np.sin(azimuth), -np.sin(tilt) * np.cos(azimuth), np.cos(tilt)]
    )
    forward = -position / distance_mm
    right = np.array([1.0, 0.0, 0.0]) - forward[0] * forward
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return RigidTransform(rotation=rotation, translation=-rotation @ position)


def simulate(
    rig: Rig, plan: PatternPlan, scene: SphereScene, rng: np.random.Generator, /
) -> Recording:
    """Render a recording of the scene and its truth.

    Parameters
    ----------
    rig : Rig with a projector
    plan : PatternPlan
    scene : SphereScene
    rng : Generator; the same state gives the same bytes

    Returns
    -------
    Scan, tuple of Truth
        8-bit images; one truth for each camera.
    """
    if rig.projector is None:
        raise ValueError("simulate: expected a rig with a projector, found none")
    truths = tuple(trace(camera, rig.projector, scene) for camera in rig.cameras)
    stacks = tuple(
        _record(camera, rig.projector, plan, scene, truth, rng)
        for camera, truth in zip(rig.cameras, truths, strict=True)
    )
    return Scan(stacks=stacks, rig=rig, title="a sphere before a plane (closed form)"), truths


def record_scene(rig: Rig, scene: SphereScene, /, *, seed: int, **plan: Any) -> Recording:
    """Return a recording and its truth: fringes of 16 px in 4 steps and their code, or changes."""
    assert rig.projector is not None
    options: dict[str, Any] = {"periods_px": (16.0,), "n_shifts": 4} | plan
    return simulate(
        rig, sequence(rig.projector.shape, **options), scene, np.random.default_rng(seed)
    )


def trace(camera: Device, projector: Device, scene: SphereScene, /) -> Truth:
    """Return what every pixel of a camera sees, from ray-sphere and ray-plane intersection."""
    origin, directions = rays(camera, pixel_grid(camera.shape))
    to_sphere = sphere_distance(origin, directions, scene.center_mm, scene.radius_mm)
    to_plane = (scene.plane_z_mm - origin[2]) / directions[..., 2]
    on_sphere = to_sphere < to_plane
    points = origin + np.where(on_sphere, to_sphere, to_plane)[..., None] * directions
    pixels = project(projector, points)
    limit = np.array([projector.n_cols, projector.n_rows]) - 0.5
    inside = ((pixels >= -0.5) & (pixels <= limit)).all(axis=-1)
    return Truth(
        points_mm=points,
        projector_xy=pixels,
        lit=inside & sees(projector, points, scene),
        on_sphere=on_sphere,
    )


def sees(device: Device, points: Points, scene: SphereScene, /) -> NDArray[np.bool_]:
    """Tell for surface points (..., 3) whether nothing stands between them and a device."""
    origin = device.center_world
    away = points - origin
    distance = np.linalg.norm(away, axis=-1)
    toward = away / distance[..., None]
    hidden = sphere_distance(origin, toward, scene.center_mm, scene.radius_mm) < distance - 1e-6
    return np.asarray(~hidden)


def sphere_distance(
    origin: Points, directions: Points, center_mm: ArrayLike, radius_mm: float, /
) -> Points:
    """Return the distance to the near side of a sphere along unit rays; inf for a miss."""
    if radius_mm <= 0:
        return np.full(directions.shape[:-1], np.inf)
    to_center = np.asarray(center_mm) - origin
    along = directions @ to_center
    chord2 = radius_mm**2 - (to_center @ to_center - along**2)
    return np.where(chord2 >= 0, along - np.sqrt(np.maximum(chord2, 0)), np.inf)


def _record(
    camera: Device,
    projector: Device,
    plan: PatternPlan,
    scene: SphereScene,
    truth: Truth,
    rng: np.random.Generator,
) -> ImageStack:
    brightness = scene.light_dn * _shading(projector, scene, truth) * _albedo(truth.points_mm)
    brightness = np.where(truth.lit, brightness, 0.0)
    x, y = truth.projector_xy[..., 0], truth.projector_xy[..., 1]
    images = np.empty((plan.n_images, *camera.shape), np.uint8)
    for index, pattern in enumerate(plan.patterns):
        light = scene.ambient_dn + brightness * intensity(pattern, x, y) ** scene.gamma
        sigma = np.sqrt(scene.noise.read_noise_dn**2 + scene.noise.gain_dn_per_e * light)
        grey = scene.black_level_dn + light + sigma * rng.standard_normal(camera.shape)
        images[index] = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    return ImageStack(
        images=images,
        plan=plan,
        device_name=camera.name,
        saturation_dn=255.0,
        black_level_dn=scene.black_level_dn,
    )


def _shading(projector: Device, scene: SphereScene, truth: Truth) -> Points:
    """Return Lambert's cosine and the inverse-square fall-off, relative to the origin."""
    away = projector.center_world - truth.points_mm
    distance = np.linalg.norm(away, axis=-1)
    on_sphere = (truth.points_mm - np.asarray(scene.center_mm)) / scene.radius_mm
    normals = np.where(truth.on_sphere[..., None], on_sphere, [0.0, 0.0, 1.0])
    cosine = np.maximum((normals * away).sum(-1) / distance, 0.0)
    reference = float(np.linalg.norm(projector.center_world))
    return np.asarray(cosine * (reference / distance) ** 2)


def _albedo(points: Points) -> Points:
    """Return a mottled surface, 0.6 to 1, without any direction of its own."""
    x, y, z = np.moveaxis(points, -1, 0)
    mottle = np.sin(1.9 * x + 0.7 * y) * np.sin(1.3 * y - 0.6 * x + z) * np.sin(0.9 * z + 0.8 * x)
    albedo: Points = 0.8 + 0.2 * mottle
    return albedo
