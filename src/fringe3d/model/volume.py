"""The measuring volume: a convex set of half-spaces in the world frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.model._array import frozen, require_finite, require_shape
from fringe3d.model.device import Device

CYLINDER_SIDES = 64
"""Sides of the prism around a cylinder; its corners stand out by 0.12 % of the radius."""

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class BoxShape:
    """An axis-parallel box of the world frame, mm."""

    min_mm: Vector
    max_mm: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class CylinderShape:
    """A cylinder of the world frame, mm."""

    center_mm: Vector
    axis: Vector
    radius_mm: float
    height_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SlabShape:
    """The depths between two distances along the principal ray of a device, mm."""

    device: str
    depth_min_mm: float
    depth_max_mm: float


Shape = BoxShape | CylinderShape | SlabShape


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuringVolume:
    """Points with ``normals @ point <= offsets_mm``, in the world frame.

    Parameters
    ----------
    normals : (n, 3) float; pointing outwards, made unit length
    offsets_mm : (n,) float, mm
    shape : BoxShape, CylinderShape, SlabShape or None
        What the half-spaces stand for, where that is known; it has no influence on them.

    Examples
    --------
    >>> cube = MeasuringVolume.box([-5, -5, 95], [5, 5, 105])
    >>> cube.contains([[0, 0, 100], [0, 0, 90]]).tolist()
    [True, False]
    """

    normals: NDArray[np.float64]
    offsets_mm: NDArray[np.float64]
    shape: Shape | None

    def __init__(
        self, *, normals: ArrayLike, offsets_mm: ArrayLike, shape: Shape | None = None
    ) -> None:
        raw, offsets = np.asarray(normals, np.float64), np.asarray(offsets_mm, np.float64)
        require_shape("volume: normals", raw, (-1, 3))
        require_shape("volume: offsets_mm", offsets, (len(raw),))
        require_finite("volume: normals", raw)
        require_finite("volume: offsets_mm", offsets)
        lengths = np.linalg.norm(raw, axis=1)
        if (lengths == 0).any():
            raise ValueError("volume: normals: expected non-zero vectors, found a zero vector")
        object.__setattr__(self, "normals", frozen(raw / lengths[:, None], np.float64))
        object.__setattr__(self, "offsets_mm", frozen(offsets / lengths, np.float64))
        object.__setattr__(self, "shape", shape)

    @staticmethod
    def box(lower_mm: ArrayLike, upper_mm: ArrayLike) -> MeasuringVolume:
        """Return the axis-parallel box between two corners (world frame, mm)."""
        lower, upper = np.asarray(lower_mm, np.float64), np.asarray(upper_mm, np.float64)
        if not (lower < upper).all():
            raise ValueError(
                "volume: expected min_mm below max_mm on every axis, "
                f"found {lower.tolist()} and {upper.tolist()}"
            )
        return MeasuringVolume(
            normals=np.vstack([np.eye(3), -np.eye(3)]),
            offsets_mm=np.concatenate([upper, -lower]),
            shape=BoxShape(min_mm=_vector(lower), max_mm=_vector(upper)),
        )

    @staticmethod
    def cylinder(
        center_mm: ArrayLike, axis: ArrayLike, *, radius_mm: float, height_mm: float
    ) -> MeasuringVolume:
        """Return a cylinder around `center_mm`, as a prism that encloses it."""
        if radius_mm <= 0 or height_mm <= 0:
            raise ValueError(
                "volume: expected positive radius_mm and height_mm, "
                f"found {radius_mm} and {height_mm}"
            )
        center = np.asarray(center_mm, np.float64)
        direction = np.asarray(axis, np.float64)
        if not np.linalg.norm(direction) > 0:
            raise ValueError(
                f"volume: axis: expected a non-zero vector, found {direction.tolist()}"
            )
        direction = direction / np.linalg.norm(direction)
        _, _, basis = np.linalg.svd(direction[None])
        angles = 2 * np.pi * np.arange(CYLINDER_SIDES) / CYLINDER_SIDES
        sides = np.cos(angles)[:, None] * basis[1] + np.sin(angles)[:, None] * basis[2]
        normals = np.vstack([sides, direction, -direction])
        reach = np.r_[np.full(CYLINDER_SIDES, radius_mm), height_mm / 2, height_mm / 2]
        shape = CylinderShape(
            center_mm=_vector(center),
            axis=_vector(axis),
            radius_mm=float(radius_mm),
            height_mm=float(height_mm),
        )
        return MeasuringVolume(normals=normals, offsets_mm=normals @ center + reach, shape=shape)

    @staticmethod
    def depth_slab(device: Device, *, depth_min_mm: float, depth_max_mm: float) -> MeasuringVolume:
        """Return the slab between two depths along the principal ray of `device`."""
        if not depth_min_mm < depth_max_mm:
            raise ValueError(
                "volume: expected depth_min_mm below depth_max_mm, "
                f"found {depth_min_mm} and {depth_max_mm}"
            )
        if depth_max_mm <= 0:
            raise ValueError(
                f"volume: expected depths in front of device '{device.name}' (> 0 mm), found "
                f"{depth_min_mm} to {depth_max_mm} mm, which lie behind it"
            )
        forward = device.device_from_world.rotation[2]
        offset = device.device_from_world.translation[2]
        return MeasuringVolume(
            normals=np.vstack([forward, -forward]),
            offsets_mm=[depth_max_mm - offset, offset - depth_min_mm],
            shape=SlabShape(
                device=device.name,
                depth_min_mm=float(depth_min_mm),
                depth_max_mm=float(depth_max_mm),
            ),
        )

    def intersection(self, other: MeasuringVolume) -> MeasuringVolume:
        """Return the points that lie in both volumes."""
        return MeasuringVolume(
            normals=np.vstack([self.normals, other.normals]),
            offsets_mm=np.concatenate([self.offsets_mm, other.offsets_mm]),
        )

    def contains(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Tell for points (..., 3), mm, whether they lie inside; NaN lies outside."""
        points = np.asarray(points, np.float64)
        inside = np.ones(points.shape[:-1], bool)
        for normal, offset in zip(self.normals, self.offsets_mm, strict=True):
            inside &= points @ normal <= offset
        return inside


def _vector(values: ArrayLike) -> Vector:
    x, y, z = np.asarray(values, np.float64).tolist()
    return x, y, z
