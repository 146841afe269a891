"""Candidates on the curve through four points of a ray, against OpenCV's projections."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from closed_phases import moved, small_rig
from cv_lens import cv_project, cv_rays
from fringe3d.correspond import _curves
from fringe3d.geometry.projection import lens_of
from fringe3d.model import Device, RigidTransform

Floats = NDArray[np.float64]

NEAR, FAR = 290.0, 400.0
"""mm; four times the depth of the volume, 33 % of the distance."""

PLACE_PX, DEPTH_MM, SLOPE = 2e-3, 1e-3, 3e-3
"""What the quartic part of a strong distortion leaves on so long a segment: a twentieth of the
least scatter of a bias; slopes, relative, over w."""

EXACT_PX, EXACT_MM = 1e-4, 1e-4

BARREL = (-0.25, 0.15, 0.002, -0.001, 0.02)
RATIONAL = (0.1, -0.05, 0.001, 0.001, 0.01, 0.15, -0.02, 0.005)


def lens(device: Device, distortion: tuple[float, ...]) -> Device:
    return moved(device, distortion=[*distortion, *[0.0] * (14 - len(distortion))])


def devices(distortion: tuple[float, ...]) -> tuple[Device, Device, Device]:
    rig = small_rig()
    assert rig.projector is not None
    return rig.cameras[0], lens(rig.cameras[1], distortion), lens(rig.projector, distortion)


class Rays:
    """Rays of C1 as the kernels take them, and the truth by OpenCV."""

    def __init__(self, c1: Device, c2: Device, projector: Device, angle: float) -> None:
        rng = np.random.default_rng(1)
        self.c2, self.device = c2, projector
        self.axis = np.array([np.cos(angle), np.sin(angle)])
        pixels = rng.uniform(0, [c1.n_cols - 1, c1.n_rows - 1], (300, 2))
        self.origin, self.directions = cv_rays(c1, pixels)
        self.along_p, self.along_2 = (
            np.ascontiguousarray(d.device_from_world.rotate(self.directions))
            for d in (projector, c2)
        )
        base_p, base_2 = (d.device_from_world.apply(self.origin) for d in (projector, c2))
        self.projector = (base_p, lens_of(projector), self.axis)
        self.camera2 = (base_2, lens_of(c2))
        self.ends = np.tile([NEAR, FAR], (len(pixels), 1))
        self.curves, self.span = np.empty((len(pixels), _curves.N_CURVE)), np.empty((300, 2))
        _curves.trace(self.ends, self.along_p, self.along_2, self.projector, self.camera2,
                      self.curves, self.span, (0, 300))  # fmt: skip

    def seen(self, depths: Floats) -> tuple[Floats, Floats]:
        """Return w in the projector and (x, y) in C2 of points of the rays."""
        points = self.origin + depths[:, None] * self.directions
        return (cv_project(self.device, points) + 0.5) @ self.axis, cv_project(self.c2, points)

    def expected(self, depths: Floats) -> Floats:
        """Return w, then t, x, y, and their slopes over w, (n, 7)."""
        w, place = self.seen(depths)
        step = 1e-3
        w_after, after = self.seen(depths + step)
        w_before, before = self.seen(depths - step)
        rise = w_after - w_before
        slopes = (after - before) / rise[:, None]
        return np.column_stack([w, depths, place, 2 * step / rise, slopes])

    def on_curve(self, w: Floats) -> Floats:
        return np.array([_curves.curve_point(*args) for args in zip(w, self.curves, strict=True)])

    def exact(self, w: Floats) -> Floats:
        return np.array([
            _curves.exact_point(w[i], self.along_p[i], self.along_2[i], self.projector,
                                self.camera2) for i in range(len(w))
        ])  # fmt: skip


@pytest.mark.parametrize("angle", [0.0, 0.3])
@pytest.mark.parametrize("distortion", [(), BARREL, RATIONAL])
def test_points_of_a_curve_are_those_of_opencv(distortion: tuple[float, ...], angle: float) -> None:
    rays = Rays(*devices(distortion), angle)
    assert np.isfinite(rays.curves).all()
    for depth in np.linspace(NEAR - 2, FAR + 2, 9):  # the guard reaches a little beyond
        expected = rays.expected(np.full(len(rays.ends), depth))
        exact = 1e-6 if not distortion else None  # for pinholes the curve is no approximation
        for found, mm, px in (
            (rays.on_curve(expected[:, 0]), exact or DEPTH_MM, exact or PLACE_PX),
            (rays.exact(expected[:, 0]), EXACT_MM, EXACT_PX),
        ):
            np.testing.assert_allclose(found[:, 0], expected[:, 1], atol=mm)
            np.testing.assert_allclose(found[:, 1:3], expected[:, 2:4], atol=px)
            np.testing.assert_allclose(found[:, 3:], expected[:, 4:], rtol=SLOPE, atol=SLOPE)


def test_span_holds_the_whole_part_of_the_ray() -> None:
    rays = Rays(*devices(BARREL), 0.2)
    w = np.array([rays.seen(np.full(300, depth))[0] for depth in np.linspace(NEAR, FAR, 50)])
    np.testing.assert_allclose(rays.span[:, 0], w.min(axis=0), atol=EXACT_PX)
    np.testing.assert_allclose(rays.span[:, 1], w.max(axis=0), atol=EXACT_PX)
    again = np.empty_like(rays.span)
    _curves.span_of(rays.ends, rays.along_p, rays.projector, again, (0, 300))
    np.testing.assert_array_equal(again, rays.span)


def test_no_curve_where_c2_does_not_see_the_whole_segment() -> None:
    c1, c2, projector = devices(())
    pose = c2.device_from_world
    further_on = pose.translation - [0.0, 0.0, 325.0]  # the near end lies behind it
    ahead = moved(c2, device_from_world=RigidTransform(
        rotation=pose.rotation, translation=further_on))  # fmt: skip
    rays = Rays(c1, ahead, projector, 0.0)
    assert np.isnan(rays.curves).all()
    assert np.isfinite(rays.span).all()
    depth = np.full(300, FAR)
    expected = rays.expected(depth)
    np.testing.assert_allclose(rays.exact(expected[:, 0])[:, 1:3], expected[:, 2:4], atol=EXACT_PX)


def test_no_curve_where_light_sheets_turn_round() -> None:
    """Fringes along the epipolar lines of a barrel lens rise and fall on one ray."""
    c1, c2, projector = devices((-0.6, 0.3))
    origin, direction = cv_rays(c1, np.array([[80.0, 64.0]]))
    near, far = cv_project(projector, origin + np.array([[NEAR], [FAR]]) * direction)
    along = far - near
    rays = Rays(c1, c2, projector, float(np.arctan2(along[0], -along[1])))
    w = np.array([rays.seen(np.full(300, depth))[0] for depth in np.linspace(NEAR, FAR, 50)])
    steps = np.diff(w, axis=0)
    turns_round = (steps > 0).any(axis=0) & (steps < 0).any(axis=0)
    assert turns_round.sum() > 3
    assert np.isnan(rays.curves[turns_round]).all()
