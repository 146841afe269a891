"""Is sigma true, and what do filters win? Errors of simulated scans over their sigma.

python -m benchmarks.pulls                                   # all of it, unfiltered: hours
python -m benchmarks.pulls --objects plane --steps 4 --noises 0.01 --filters none,medium
python -m benchmarks.pulls --steps 4 --noises 0.01 --methods m1 --places cameras,best,0.3px
python -m benchmarks.pulls --steps 3 --noises 0.003 --full-well 10000      # mostly shot noise

Places: of both cameras, of cameras and projector (best), or so with a projector whose calibration
is off by so many pixels. The pull is that of all points within six sigma; the robust one is that
of the middle half of them.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion

from benchmarks.orders import scenes
from fringe3d.evaluate import Sphere, errors_along_rays, probe_plane, probe_spheres
from fringe3d.model import Rig
from fringe3d.options import MeasureOptions
from fringe3d.pipeline import Measurement, measure

INNER_PX = 3
"""Pixels this far from the border of the object and from places that cannot be measured."""

GROSS_SIGMAS = 6.0
"""Beyond, noise has no part in it: mixed light, hidden points, wrong orders. They are counted."""

EDGE_PX = 3
BALL_RADIUS_MM, JUMP_MM = 10.0, 0.5
OUTLIER_MM = 0.1
"""Ten times the noise of unfiltered points with 4 steps."""

COLUMNS = ("object", "noise", "steps", "method", "filter", "place", "points", "sigma_um",
           "error_um", "pull", "pull_robust", "gross_%", "edge_outliers_%", "form")  # fmt: skip


def main() -> None:
    """Print one line for each scan and way to measure it."""
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    options.add_argument("--preset", default="kolibri")
    options.add_argument("--objects", default="plane,sphere,teeth")
    options.add_argument("--noises", default="0.003,0.01,0.05")
    options.add_argument("--steps", default="3,4,8,16")
    options.add_argument("--methods", default="m1,m6")
    options.add_argument("--filters", default="none")
    options.add_argument("--places", default="cameras")
    options.add_argument("--full-well", type=float, default=scenes.FULL_WELL_E)
    options.add_argument("--size", default="640x512")
    wanted = options.parse_args()
    width, height = map(int, wanted.size.split("x"))
    scenes.FULL_WELL_E = wanted.full_well
    ways = [
        (method, strength, place)
        for method in wanted.methods.split(",")
        for strength in wanted.filters.split(",")
        for place in wanted.places.split(",")
    ]
    print("  ".join(COLUMNS), flush=True)
    for thing in wanted.objects.split(","):
        for noise in map(float, wanted.noises.split(",")):
            for steps in map(int, wanted.steps.split(",")):
                scenes.STEPS = steps
                scene = scenes.Scene(wanted.preset, thing, noise, (width, height))
                for line in _lines(scene, ways):
                    print(line, flush=True)


def _lines(scene: scenes.Scene, ways: list[tuple[str, str, str]]) -> Iterator[str]:
    recording = scenes.recorded(scene)
    for method, strength, place in ways:
        options = MeasureOptions(
            method=method,  # type: ignore[arg-type]
            filter=strength,  # type: ignore[arg-type]
            best_estimate=place != "cameras",
        )
        off_px = float(place.removesuffix("px")) if place.endswith("px") else 0.0
        scan = replace(recording.scan, rig=_with_projector_off(recording.rig, off_px))
        try:
            result = measure(scan, options)
        except ValueError as problem:
            yield f"{scene}, {method}, {strength}, {place}: {problem}"
            continue
        yield _figures(scene, recording, result, (method, strength, place))


def _with_projector_off(rig: Rig, off_px: float) -> Rig:
    """Return a rig whose projector looks so much aside, and enlarges by as much at its border."""
    projector = rig.projector
    assert projector is not None
    center_px = np.add(projector.center_px, (off_px, 0.0))
    focal_px = projector.focal_px * (1 + off_px / (projector.n_cols / 2))
    return replace(rig, projector=replace(projector, center_px=center_px, focal_px=focal_px))


def _figures(
    scene: scenes.Scene,
    recording: scenes.Recording,
    result: Measurement,
    way: tuple[str, str, str],
) -> str:
    points, reference = result.points, recording.reference
    assert points is not None
    error = errors_along_rays(points.points_mm, reference.points_mm, reference.origin_mm)
    right = reference.is_right(points)
    inner = _inner(reference.seen, reference.points_mm) & right
    z = error[inner] / points.sigma_mm[inner]
    fine = np.abs(z) < GROSS_SIGMAS
    near_edge = binary_dilation(~_inner(reference.seen, reference.points_mm), iterations=EDGE_PX)
    edge = reference.seen & near_edge & points.is_valid
    outliers = np.abs(error[edge]) > OUTLIER_MM
    found = points.points_mm[points.is_valid]
    form = ""
    if scene.thing == "sphere":
        ball = probe_spheres(found, 2 * BALL_RADIUS_MM)[0].fit
        assert isinstance(ball.surface, Sphere)
        size_um = 2000 * (ball.surface.radius_mm - BALL_RADIUS_MM)
        form = f"size {size_um:+.2f} sigma {1000 * ball.sigma_mm:.2f} um"
    elif scene.thing == "plane":
        form = f"sigma {1000 * probe_plane(found).fit.sigma_mm:.2f} um"
    values = (
        scene.thing, f"{100 * scene.noise:g}%", str(scenes.STEPS), *way,
        str(int(points.is_valid.sum())), f"{1000 * np.median(points.sigma_mm[inner]):.2f}",
        f"{1000 * np.sqrt((error[inner][fine] ** 2).mean()):.2f}", f"{z[fine].std():.3f}",
        f"{1.4826 * np.median(np.abs(z - np.median(z))):.3f}", f"{100 * (~fine).mean():.2f}",
        f"{100 * outliers.mean():.2f}", form,
    )  # fmt: skip
    return "  ".join(values)


def _inner(seen: NDArray[np.bool_], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return pixels of the object that are not next to an edge in depth."""
    depth = np.where(seen, points[..., 2], np.nan)
    jump = np.zeros(seen.shape, bool)
    for axis in (0, 1):
        step = np.abs(np.diff(depth, axis=axis)) > JUMP_MM
        width = [(0, 1), (0, 0)] if axis == 0 else [(0, 0), (0, 1)]
        jump |= np.pad(step, width) | np.pad(step, [pair[::-1] for pair in width])
    return np.asarray(binary_erosion(seen & ~jump, iterations=INNER_PX))


if __name__ == "__main__":
    main()
