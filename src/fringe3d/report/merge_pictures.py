"""Pictures of a merge: overlaps by pair, the body from all sides, deviations from a reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from fringe3d.evaluate import Deviations
from fringe3d.model import MergedCloud, PairResidual, Registration

Floats = NDArray[np.float64]

BACK = np.array([16, 18, 22], np.uint8)
BODY = np.array([214, 220, 228], float)
MOST_POINTS = 400_000
N_FRAMES, FRAME_MS = 36, 90
GIF_SIZE = 480
GIF_POINTS = 150_000
ELEVATION = np.radians(28.0)
SEED = 0
CROP_MARGIN = 8


def draw_overlaps(path: Path, found: Registration, names: Sequence[str], /) -> None:
    """Draw the residuals of all pairs that overlap, before and after, as matrices with a scale."""
    figure = Figure(figsize=(14, 6.4), dpi=100, layout="constrained")
    axes = figure.subplots(1, 2)
    for axis, pairs, word in zip(axes, (found.before, found.after), ("before", "after"),
                                 strict=True):  # fmt: skip
        matrix = pair_matrix(pairs, len(names))
        top = float(np.nanpercentile(matrix, 98)) if np.isfinite(matrix).any() else 1.0
        image = axis.imshow(matrix, cmap="viridis", vmin=0, vmax=max(top, 1e-6))
        known = matrix[np.isfinite(matrix)]
        middle = f", median {np.median(known):.1f} um" if len(known) else ""
        axis.set_title(f"{word} the adjustment{middle}", fontsize=10, loc="left")
        step = max(1, len(names) // 24)
        axis.set_xticks(range(0, len(names), step), names[::step], rotation=90, fontsize=7)
        axis.set_yticks(range(0, len(names), step), names[::step], fontsize=7)
        axis.set_facecolor("#d9dce1")
        bar = figure.colorbar(image, ax=axis, shrink=0.9, pad=0.01, extend="max")
        bar.set_label("residual of the overlap (robust rms), um", fontsize=9)
    figure.suptitle("Residuals of pairs of views; grey: no overlap", fontsize=11)
    figure.savefig(path)


def pair_matrix(pairs: Sequence[PairResidual], n: int, /) -> Floats:
    """Return residuals by pair, (n, n) um; NaN where views do not overlap."""
    matrix = np.full((n, n), np.nan)
    for pair in pairs:
        matrix[pair.first, pair.second] = matrix[pair.second, pair.first] = 1000 * pair.rms_mm
    return matrix


def draw_body(path: Path, cloud: MergedCloud, axis: Floats, /, *, title: str) -> None:
    """Draw the body from four sides: shaded, by the number of views, by sigma, by view."""
    points, normals, chosen = _thinned(cloud)
    sigma = 1000 * cloud.sigma_mm[chosen]
    top = float(np.percentile(sigma, 98))
    panels: list[tuple[str, Floats | None, tuple[str, float, float] | None]] = [
        ("shaded", None, None),
        ("views averaged", cloud.n_views[chosen].astype(float),
         ("viridis", 1.0, float(cloud.n_views.max()))),
        ("sigma along the normal, um", sigma.astype(float), ("magma_r", 0.0, top)),
        ("the view that stands for the place", cloud.source[chosen].astype(float),
         ("turbo", 0.0, float(max(cloud.source.max(), 1)))),
    ]  # fmt: skip
    figure = Figure(figsize=(14, 10.5), dpi=100, layout="constrained")
    for k, (axes, (word, values, scale)) in enumerate(
        zip(figure.subplots(2, 2).ravel(), panels, strict=True)
    ):
        look = looking(axis, np.radians(40 + 90 * (k % 2)))
        if values is None or scale is None:
            colours = shaded(normals, look)
            axes.imshow(cropped([splat(points, colours, look, 900)])[0], interpolation="nearest")
        else:
            parts = np.clip((values - scale[1]) / max(scale[2] - scale[1], 1e-9), 0, 1)
            colours = (255 * colormaps[scale[0]](parts)[:, :3]).astype(np.uint8)
            picture = cropped([splat(points, colours, look, 900)])[0]
            shown = axes.imshow(picture, interpolation="nearest",
                                cmap=scale[0], vmin=scale[1], vmax=scale[2])  # fmt: skip
            figure.colorbar(shown, ax=axes, shrink=0.8, pad=0.01)
        axes.set_title(word, fontsize=10, loc="left")
        axes.set_axis_off()
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    figure.savefig(path)


def write_turn(path: Path, cloud: MergedCloud, axis: Floats, /) -> None:
    """Write an animation (GIF) of the body turning once about an axis."""
    points, normals, _ = _thinned(cloud)
    step = -(-len(points) // GIF_POINTS)  # the smaller pictures need fewer
    points, normals = points[::step], normals[::step]
    pictures = []
    for k in range(N_FRAMES):
        look = looking(axis, 2 * np.pi * k / N_FRAMES)
        pictures.append(splat(points, shaded(normals, look), look, GIF_SIZE))
    frames = [Image.fromarray(picture) for picture in cropped(pictures)]
    palette = frames[0].quantize(96)
    small = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    small[0].save(path, save_all=True, append_images=small[1:], duration=FRAME_MS, loop=0)


def draw_reference(
    path: Path, cloud: MergedCloud, deviations: Deviations, axis: Floats, /, *, title: str,
) -> None:  # fmt: skip
    """Draw signed deviations from a reference on the body, from four sides, and their histogram."""
    signed = 1000 * deviations.signed_mm
    limit = max(float(np.nanpercentile(np.abs(signed), 97)), 1e-3)
    colours = 255 * colormaps["RdBu_r"](0.5 + np.nan_to_num(signed) / (2 * limit))[:, :3]
    colours = colours.astype(np.uint8)
    colours[~np.isfinite(signed)] = 120
    figure = Figure(figsize=(15, 9), dpi=100, layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for k in range(4):
        look = looking(axis, np.radians(40 + 90 * k))
        place = axes[(0, 1, 3, 4)[k]]
        picture = cropped([splat(cloud.points_mm, colours, look, 800)])[0]
        shown = place.imshow(picture, interpolation="nearest",
                             cmap="RdBu_r", vmin=-limit, vmax=limit)  # fmt: skip
        place.set_axis_off()
    bar = figure.colorbar(shown, ax=list(axes[[0, 1, 3, 4]]), shrink=0.8, pad=0.01, extend="both")
    bar.set_label("deviation, um: positive outside the reference", fontsize=9)
    known = np.clip(signed[np.isfinite(signed)], -1.5 * limit, 1.5 * limit)
    axes[2].hist(known, np.linspace(-1.5 * limit, 1.5 * limit, 81).tolist(), color="#54657e")
    axes[2].set_xlabel("deviation, um", fontsize=9)
    axes[2].set_yticks([])
    axes[5].set_visible(False)
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    figure.savefig(path)


def _thinned(cloud: MergedCloud) -> tuple[Floats, Floats, NDArray[np.intp]]:
    n = len(cloud.points_mm)
    chosen = np.arange(n)
    if n > MOST_POINTS:
        chosen = np.sort(np.random.default_rng(SEED).choice(n, MOST_POINTS, replace=False))
    return cloud.points_mm[chosen], cloud.normals[chosen].astype(np.float64), chosen


def looking(axis: Floats, azimuth: float, /) -> Floats:
    """Return how one looks at a body whose `axis` points up: right, down and ahead as rows (3, 3).

    Examples
    --------
    >>> look = looking(np.array([0, 0, 1.0]), 0.3)
    >>> bool(look[1] @ [0, 0, 1] < 0 and look[2] @ [0, 0, 1] < 0)
    True
    """
    up = axis / np.linalg.norm(axis)
    least = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = np.cross(up, least)
    first /= np.linalg.norm(first)
    out = np.cos(azimuth) * first + np.sin(azimuth) * np.cross(up, first)
    ahead = -(np.cos(ELEVATION) * out + np.sin(ELEVATION) * up)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(ahead, right), ahead])


def shaded(normals: Floats, look: Floats, /) -> NDArray[np.uint8]:
    """Return colours (n, 3) of a matt surface, lit from beside the eye."""
    light = -look[2] - 0.4 * look[1] - 0.3 * look[0]
    light /= np.linalg.norm(light)
    bright = 0.18 + 0.82 * np.clip(normals @ light, 0, 1)
    return np.asarray(np.clip(bright[:, None] * BODY, 0, 255), np.uint8)


def splat(points: Floats, colours: NDArray[Any], look: Floats, size: int, /) -> NDArray[np.uint8]:
    """Return a picture (row, col, 3) of points seen in parallel; the nearer hide the farther.

    Examples
    --------
    >>> points = np.array([[0, 0, 5.0], [0, 0, 1.0], [9, 0, 3.0]])
    >>> colours = np.array([[9, 9, 9], [200, 0, 0], [0, 200, 0]], np.uint8)
    >>> sorted(set(splat(points, colours, np.eye(3), 64)[..., 0].ravel().tolist()))
    [0, 16, 200]
    """
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    own = (points - middle) @ look.T
    radius = float(np.linalg.norm(np.ptp(points, axis=0))) / 2 or 1.0
    scale = 0.48 * size / radius
    spot = 2 if scale * 2 * radius / np.sqrt(max(len(points), 1)) < 2 else 3
    cols, rows = (scale * own[:, :2] + size / 2).astype(np.intp).T
    far_first = np.argsort(-own[:, 2])
    depth = np.full((size, size), np.inf)
    picture = np.tile(BACK, (size, size, 1))
    for dy in range(spot):
        for dx in range(spot):
            r, c = (np.clip(v + d - spot // 2, 0, size - 1) for v, d in ((rows, dy), (cols, dx)))
            here = np.full((size, size), -1, np.intp)
            here[r[far_first], c[far_first]] = far_first  # the last written is the nearest
            is_nearer = here >= 0
            z = np.where(is_nearer, own[here, 2], np.inf)
            is_nearer &= z < depth
            depth[is_nearer] = z[is_nearer]
            picture[is_nearer] = colours[here[is_nearer]]
    return picture


def cropped(pictures: Sequence[NDArray[np.uint8]], /) -> list[NDArray[np.uint8]]:
    """Return pictures of one size without the empty border that all have, but a margin.

    Examples
    --------
    >>> picture = np.tile(BACK, (90, 90, 1))
    >>> picture[40:50, 30:70] = 200
    >>> cropped([picture])[0].shape
    (26, 56, 3)
    """
    seen = np.any([(p != BACK).any(axis=-1) for p in pictures], axis=0)
    parts = []
    for axis in (1, 0):
        places = np.flatnonzero(seen.any(axis=axis))
        low, high = (int(places[0]), int(places[-1]) + 1) if len(places) else (0, seen.shape[0])
        parts.append(slice(max(low - CROP_MARGIN, 0), high + CROP_MARGIN))
    return [np.ascontiguousarray(p[parts[0], parts[1]]) for p in pictures]
