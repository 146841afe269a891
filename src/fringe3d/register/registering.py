"""``register``: from views that lie anywhere to one frame. The abstract of the method."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from fringe3d.errors import EmptyResultError, MethodError
from fringe3d.model import Registration, RigidTransform, SurfaceView, TableAxis
from fringe3d.register.adjust import N_SAMPLES, AdjustOptions, adjust
from fringe3d.register.coarse import place_by_angles, place_by_shape
from fringe3d.register.doubting import refuse_conflicts
from fringe3d.register.table_model import TablePrior

Angles = Literal["auto", "known", "rough", "unknown", "free"]

ROUGH_ANGLES = math.radians(2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisterOptions:
    """How views come into one frame.

    Parameters
    ----------
    angles : "known" (to `prior.angle_sigma`), "rough" (to 2 degrees), "unknown": a table that
        nobody read, "free": no table; "auto": known where all views have an angle, else free
    prior : TablePrior; how good the table is
    axis : TableAxis or None; where it is known, as from a calibration object
    n_samples : int; points of each view that the adjustment rests on
    despite_conflicts : bool; also where views that shape alone placed contradict each other
    """

    angles: Angles = "auto"
    prior: TablePrior = field(default_factory=TablePrior)
    axis: TableAxis | None = None
    n_samples: int = N_SAMPLES
    despite_conflicts: bool = False


def register(
    views: Sequence[SurfaceView],
    options: RegisterOptions | None = None,
    /,
    *,
    start: Sequence[RigidTransform] | None = None,
    step: Callable[[str, int, int], object] = lambda *_: None,
) -> Registration:
    """Bring views of a body into one frame: that of the first view.

    Parameters
    ----------
    views : sequence of SurfaceView, two at least
    options : RegisterOptions or None
    start : sequence of RigidTransform or None; ``body_from_view`` where it is roughly known
    step : called with the work, what is done and what there is to do

    Returns
    -------
    Registration

    Raises
    ------
    MethodError
        If there are too few views, angles are asked for that views do not have, or a library is
        missing.
    EmptyResultError
        If views do not overlap.
    RegistrationError
        If the shape of the body does not place views without doubt, or views that it placed
        contradict each other.

    Notes
    -----
    Coarse: neighbours are matched by features and generalised ICP; with known angles they tell the
    axis, and the angles place all others; else those fits do that no view contradicts; see
    `place_by_shape`. Fine: all overlaps at once, weighted by the covariances of the points; see
    `adjust`.
    """
    options = options or RegisterOptions()
    if len(views) < 2:
        raise MethodError(f"merge: expected at least 2 views, found {len(views)}. Name more scans")
    kind = _kind(views, options.angles)
    poses = tuple(start) if start is not None else None
    prior = _prior(kind, options.prior)
    if poses is None and kind in ("known", "rough"):
        poses = place_by_angles(views, angle_sigma=prior.angle_sigma if prior else 0.0,
                                axis=options.axis, step=step)  # fmt: skip
    by_shape = poses is None
    if poses is None:
        poses = place_by_shape(views, on_table=kind != "free", axis=options.axis, step=step)
    spacing = max(view.spacing_mm for view in views)
    wanted = AdjustOptions(n_samples=options.n_samples, reach_mm=REACH_OF_SPACING * spacing,
                           table=prior)  # fmt: skip
    found = adjust(views, poses, wanted, step=step)
    if not found.after:
        raise EmptyResultError(
            "merge: expected views that overlap, found none that do. Check that all scans show one "
            "body, and the angles of the table"
        )
    if by_shape and not options.despite_conflicts:
        refuse_conflicts(views, found)
    return found


def table_prior(
    views: Sequence[SurfaceView], options: RegisterOptions | None = None, /
) -> TablePrior | None:
    """Return what is known of the table of these views, as options say; None where they are free.

    Raises
    ------
    MethodError
        If angles are asked for that views do not have.
    """
    options = options or RegisterOptions()
    return _prior(_kind(views, options.angles), options.prior)


REACH_OF_SPACING = 8.0
"""Typical distances of points by which views may lie apart after the coarse placement."""


def _prior(kind: str, prior: TablePrior) -> TablePrior | None:
    if kind == "free":
        return None
    wanted = {"known": prior.angle_sigma, "rough": ROUGH_ANGLES, "unknown": math.inf}
    return replace(prior, angle_sigma=wanted[kind])


def _kind(views: Sequence[SurfaceView], angles: Angles) -> str:
    lacking = [v.name for v in views if v.position is None or v.position.angle is None]
    if angles == "auto":
        return "free" if lacking else "known"
    if angles in ("known", "rough") and lacking:
        raise MethodError(
            f"--angles {angles}: expected the angle of the table for each scan, found none for "
            f"{', '.join(lacking)}. Write [table] angle_deg into scan.toml, or choose unknown"
        )
    return angles
