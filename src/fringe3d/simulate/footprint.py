"""Light paths: from the projector by way of the scene to each pixel of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry import pixel_grid, project
from fringe3d.geometry.projection import normalize
from fringe3d.model import Device
from fringe3d.simulate.caster import Hits
from fringe3d.simulate.optics import CameraOptics, ProjectorOptics
from fringe3d.simulate.scene import Scene

Floats = NDArray[np.float64]
Maps = NDArray[np.float32]

ROWS_AT_ONCE = 64
RAY_GRIDS = {1: 1, 4: 2, 9: 3, 16: 4}


@dataclass(frozen=True, slots=True, eq=False)
class Footprint:
    """Where the rays of each pixel fetch their light; pixels in reading order.

    Parameters
    ----------
    u, v : (n_pixels, n_rays) float32, projector px
    blur : (n_pixels, n_rays) float32, px**2; variance of the projector's blur there
    direct : (n_pixels, n_rays) float32; brightness for a white projector pixel; 0 where not lit
    ambient : (n_pixels,) float32; brightness without the projector, for unit ambient light
    """

    u: Maps
    v: Maps
    blur: Maps
    direct: Maps
    ambient: Maps


def footprint(
    camera: Device,
    projector: Device,
    scene: Scene,
    optics: CameraOptics,
    light: ProjectorOptics,
    /,
    *,
    n_rays: int,
    reference_mm: Floats,
) -> Footprint:
    """Follow the rays of all pixels of a camera.

    Parameters
    ----------
    camera, projector : Device
    scene : Scene
    optics, light : lens of the camera, and of the projector
    n_rays : 1, 4, 9 or 16 rays for each pixel, spread over its area (and the camera's aperture)
    reference_mm : (3,); where a white pixel gives brightness 1 on white paper facing the light
    """
    offsets = ray_offsets(n_rays)
    blocks = []
    grid = pixel_grid(camera.shape)
    for top in range(0, camera.n_rows, ROWS_AT_ONCE):
        pixels = grid[top : top + ROWS_AT_ONCE].reshape(-1, 1, 2) + offsets[:, :2]
        blocks.append(
            _paths(camera, projector, scene, optics, light, pixels, offsets, reference_mm)
        )
    return Footprint(*(np.concatenate(maps) for maps in zip(*blocks, strict=True)))


def ray_offsets(n_rays: int, /) -> Floats:
    """Return where rays start, (n_rays, 4): x, y in the pixel, px, and in the pupil.

    Pupil coordinates have unit variance. An orthogonal array over a regular grid: the mean is the
    centre and the variances are those of the whole area (1/12 for a pixel), so that a pixel's
    mean position is unbiased; from nine rays on pixel and pupil are independent as well.

    Examples
    --------
    >>> ray_offsets(4)[:, :2].round(3).tolist()
    [[-0.289, -0.289], [0.289, -0.289], [-0.289, 0.289], [0.289, 0.289]]
    """
    if n_rays not in RAY_GRIDS:
        raise ValueError(f"rays for each pixel: expected one of {list(RAY_GRIDS)}, found {n_rays}")
    m = RAY_GRIDS[n_rays]
    if m == 1:
        return np.zeros((1, 4))
    j, i = (index.ravel() for index in np.mgrid[:m, :m])
    if m == 3:
        third, fourth = (i + j) % 3, (i + 2 * j) % 3
    else:  # the field with four (or two) elements: addition is exclusive or
        third, fourth = i ^ j, i ^ np.array([0, 2, 3, 1])[j] if m == 4 else i ^ j
    places = np.stack([i, j, third, fourth], axis=1) - (m - 1) / 2
    spread: Floats = places / places.std(axis=0)
    spread[:, :2] /= np.sqrt(12)
    return spread


def _paths(
    camera: Device,
    projector: Device,
    scene: Scene,
    optics: CameraOptics,
    light: ProjectorOptics,
    pixels: Floats,
    offsets: Floats,
    reference: Floats,
) -> tuple[Maps, ...]:
    n_pixels, n_rays, _ = pixels.shape
    origins, directions = _through_lens(camera, optics, pixels, offsets, reference)
    hits = scene.caster.cast(origins.reshape(-1, 3), directions.reshape(-1, 3))
    seen = -directions.reshape(-1, 3)
    u, v, blur, lambert, albedo, gloss = illuminate(projector, scene, light, hits, reference)
    away = _unit(projector.center_world - hits.points_mm)
    direct = lambert * (albedo + gloss * _lobe(scene, hits, seen, away))
    shade = _vignetting(camera, np.asarray(directions), optics.vignetting).reshape(n_pixels, n_rays)
    direct = np.nan_to_num(direct).reshape(n_pixels, n_rays) * shade
    ambient = (albedo.reshape(n_pixels, n_rays) * shade).mean(axis=1)
    places = (a.reshape(n_pixels, n_rays) for a in (u, v, blur))
    return tuple(a.astype(np.float32) for a in (*places, direct, ambient))


def illuminate(
    projector: Device, scene: Scene, light: ProjectorOptics, hits: Hits, reference: Floats, /
) -> tuple[Floats, ...]:
    """Return projector coordinates, blur, irradiance, albedo and gloss at surface points.

    The irradiance falls off with the square of the distance, with Lambert's cosine and towards
    the border of the projector's image; it is 1 at the reference, 0 in shadow.
    """
    points = hits.points_mm
    pixels = project(projector, points)
    center = projector.center_world
    lit = inside(projector, pixels)
    lit[lit] = scene.caster.sees(points[lit], hits.normals[lit], center)
    away = center - points
    distance = np.linalg.norm(away, axis=1)
    cosine = (away * hits.normals).sum(axis=1) / distance
    depth = projector.device_from_world.apply(points)[:, 2]
    fall_off = (np.linalg.norm(center - reference) / distance) ** 2
    # Without vignetting a screen across the axis is evenly lit: cosine and distance make cos^3.
    border = (depth / distance) ** (4 * light.vignetting - 3)
    irradiance = np.where(lit, cosine * fall_off * border, 0.0)
    albedo, gloss = scene.reflectance(hits)
    blur = blur_variance(projector, light, depth, reference)
    return pixels[:, 0], pixels[:, 1], blur, irradiance, albedo, gloss


def inside(device: Device, pixels: Floats, /) -> NDArray[np.bool_]:
    """Tell which pixels (n, 2) lie in the image of a device."""
    limit = np.array([device.n_cols, device.n_rows]) - 0.5
    return np.asarray(((pixels >= -0.5) & (pixels <= limit)).all(axis=-1))


def blur_variance(
    projector: Device, light: ProjectorOptics, depth_mm: Floats, reference_mm: Floats, /
) -> Floats:
    """Return the variance of the projector's blur at depths, px**2 (thin lens).

    A pupil of diameter D blurs a point at depth z to a disc of ``D f |1/z - 1/z_focus|`` pixels;
    the variance of a disc along one axis is a sixteenth of its squared diameter.
    """
    focus = light.focus_mm or float(projector.device_from_world.apply(reference_mm)[2])
    disc = light.aperture_mm * projector.focal_px.mean() * np.abs(1 / depth_mm - 1 / focus)
    return np.asarray(light.blur_px**2 + disc**2 / 16)


def _through_lens(
    camera: Device, optics: CameraOptics, pixels: Floats, offsets: Floats, reference: Floats
) -> tuple[Floats, Floats]:
    """Return origins and unit directions, (n, rays, 3), world frame; through a pupil if it is open.

    All rays of one image point meet in the plane of focus. The pupil is a square with the
    variance of the disc.
    """
    world_from_camera = camera.device_from_world.inverse()
    flat = normalize(camera, pixels)
    aim = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1)
    start = np.zeros_like(aim)
    if optics.aperture_mm:
        focus = optics.focus_mm or float(camera.device_from_world.apply(reference)[2])
        start[..., :2] = offsets[:, 2:] * optics.aperture_mm / 4
        aim = focus * aim - start
    directions = world_from_camera.rotate(aim / np.linalg.norm(aim, axis=-1, keepdims=True))
    return world_from_camera.apply(start), directions


def _lobe(scene: Scene, hits: Hits, seen: Floats, away: Floats) -> Floats:
    """Return the glossy lobe (Blinn and Phong, normalised to keep the energy)."""
    if not (scene.surface.gloss or scene.background.gloss):
        return np.zeros(len(seen))
    exponent = np.where(
        scene.is_thing(hits), scene.surface.gloss_exponent, scene.background.gloss_exponent
    )
    half = _unit(seen + away)
    cosine = np.maximum((half * hits.normals).sum(axis=1), 0.0)
    return np.asarray((exponent + 8) / 8 * cosine**exponent)


def _vignetting(camera: Device, directions: Floats, strength: float) -> Floats:
    forward = camera.device_from_world.rotation[2]
    return np.asarray(np.nan_to_num((directions @ forward) ** (4 * strength)))


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
