"""A projector from a measurement without any target: points and the light that fell on them.

Two calibrated cameras measure a scene by the projector's fringes without knowing the projector.
Each point then is known in space and, by its absolute phase, across the fringes in the projector:
a resection. Fringes of one direction show seven numbers of a pinhole; where the projector stands
along its own stripes, and its principal point there, have no influence on anything they measure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fringe3d.calibrate._camera import INDEX, device_of, position_and_slopes
from fringe3d.calibrate._lens import LENSES, Lens, LensTrial, choose_lens
from fringe3d.calibrate._parameters import Parameter, parameters_of
from fringe3d.calibrate._problem import (
    WORST_PX,
    Problem,
    begin,
    by_convention,
    no_projector,
    problem_of,
)
from fringe3d.calibrate._solve import Likely, Solution, with_noise
from fringe3d.calibrate.lit_points import LitPoints
from fringe3d.errors import CalibrationError, EmptyResultError
from fringe3d.geometry import project
from fringe3d.model import Device
from fringe3d.patterns import across

Floats = NDArray[np.float64]

SAMPLE = 20_000
"""Equations of the fit; more add hardly anything, for errors of neighbours agree."""

MIN_POINTS = 200
"""15 numbers, with ten points for each and some to judge them."""

NOISE_ROUNDS = 2

FLAT_PART = 0.01
"""Of the distance: less depth is a board, which leaves two of the seven numbers open."""

ROBUST_RANGE = (1.0, 99.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FittedProjector:
    """A projector and the evidence for it.

    Parameters
    ----------
    device : Device
    lens : str; the distortion terms that the data asked for
    parameters : tuple of Parameter
    covariance : (15, 15) float; of the numbers fitted, see `position_sigma_px`
    residual_px : tuple of (n, n_angles) float, px; of each `LitPoints`: model minus measurement
    trials : tuple of LensTrial
    held_out_rms_px : float, px; of the chosen lens
    noise_px : float, px; median standard deviation of a residual, as predicted from the images
    extra_px : float, px; noise that the residuals show besides, as from the calibration of the
        cameras
    n_used : int; equations of the fit
    n_directions : int; 1 or 2
    depth_part : float; by how much the points leave their common plane, over their distance
    is_determined : bool; the points are no plane, and their data hold focal length and principal
        point, as far as the fringes can show them
    """

    device: Device
    lens: Lens
    parameters: tuple[Parameter, ...]
    covariance: Floats
    residual_px: tuple[Floats, ...]
    trials: tuple[LensTrial, ...]
    held_out_rms_px: float
    noise_px: float
    extra_px: float
    n_used: int
    n_directions: int
    depth_part: float
    is_determined: bool
    _solution: Solution
    _middle_mm: Floats
    _wide_covariance: Floats

    def position_sigma_px(
        self, points_mm: ArrayLike, angle: float = 0.0, /, *, any_lens: bool = False
    ) -> Floats:
        """Return how uncertain the projector is about places in space.

        Parameters
        ----------
        points_mm : (n, 3) float, mm, world frame
        angle : float, rad; of the fringes
        any_lens : bool; count that the distortion terms left out may not be zero

        Returns
        -------
        (n,) float64, px
            Standard deviation of the coordinate w across the fringes.
        """
        points = np.asarray(points_mm, np.float64).reshape(-1, 3) - self._middle_mm
        angles = np.full(len(points), angle)
        _, slopes, _ = position_and_slopes(
            self._solution.numbers, self._solution.start, points, angles
        )
        covariance = self._wide_covariance if any_lens else self.covariance
        variance = np.einsum("ni,ij,nj->n", slopes, covariance, slopes)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def fit_projector(
    scans: Sequence[LitPoints],
    shape: tuple[int, int],
    /,
    *,
    lens: Lens | None = None,
    name: str = "projector",
) -> FittedProjector:
    """Fit a projector to points and the coordinates of the light that fell on them.

    Parameters
    ----------
    scans : sequence of LitPoints; measurements with the same rig
    shape : (n_rows, n_cols) of the projector
    lens : str or None; distortion terms, one of `LENSES`; None lets held-out points decide
    name : str; of the new device

    Returns
    -------
    FittedProjector

    Raises
    ------
    EmptyResultError
        If there are too few points.
    CalibrationError
        If no projector fits, or not the same to both directions.

    Notes
    -----
    Least squares of the coordinate w across the fringes, projector px, weighted by the noise of
    the phase and of the point, with Cauchy's loss. What the data do not hold stays where it is
    likely: focal length 1.4 times the longer side (a factor of 2 either way), principal point in
    the middle (10 % of the width, 50 % of the height), distortion 0 (5 % at the corner, k2 and k3
    3 %, p1 and p2 1 %), points in the middle of the image. With one direction the focal length
    along the fringes equals the other, unless the points then reach beyond the image.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> points = rng.uniform([-50, -50, 450], [50, 50, 550], (1000, 3))
    >>> w = 1500 * points[:, 0] / points[:, 2] + 512.0  # a projector at the origin
    >>> scan = LitPoints(points_mm=points, position_px=w[:, None], angles=[0.0], sigma_px=0.02)
    >>> fitted = fit_projector([scan], (768, 1024))
    >>> bool(np.abs(fitted.residual_px[0]).max() < 1e-3)
    True
    """
    if not scans or sum(scan.n_points for scan in scans) < MIN_POINTS:
        found = sum(scan.n_points for scan in scans)
        raise EmptyResultError(
            f"expected at least {MIN_POINTS} points to fit a projector to, found {found}. Check "
            "exposure, plan and depth range of the scans"
        )
    problem = problem_of(scans, shape, SAMPLE)
    begun = begin(problem)
    focal = float(np.exp(begun.numbers[INDEX["log_focal"]]))
    likely = Likely.of(shape, focal, problem.rows.angle)
    problem = replace(problem, likely=likely)
    for _ in range(NOISE_ROUNDS):
        begun = with_noise(problem.rows, problem.solve(begun, LENSES[-1]))
    # Of a board distortion and perspective look much alike: it holds one term at most.
    is_flat = depth_part(_all_points(scans), begun.numbers[INDEX["middle_z"]]) < FLAT_PART
    wanted = (lens,) if lens else LENSES[:2] if is_flat else LENSES
    trials, chosen = choose_lens(problem, begun, wanted)
    fitted = problem.solve(begun, chosen)
    for _ in range(NOISE_ROUNDS):
        fitted = problem.solve(with_noise(problem.rows, fitted), chosen)
    return _result(scans, problem, by_convention(problem, fitted), chosen, trials, name)


def _result(
    scans: Sequence[LitPoints],
    problem: Problem,
    fitted: Solution,
    chosen: Lens,
    trials: tuple[LensTrial, ...],
    name: str,
) -> FittedProjector:
    device = device_of(fitted.numbers, fitted.start, problem.middle_mm, problem.shape, name)
    residuals = tuple(residual_px(device, scan) for scan in scans)
    typical = float(np.median(np.abs(np.concatenate([r[np.isfinite(r)] for r in residuals]))))
    if not typical < WORST_PX:
        raise CalibrationError(no_projector(problem, typical))
    covariance = problem.covariance(fitted, chosen)
    parameters = parameters_of(problem, fitted, covariance, chosen)
    pinhole = [p for p in parameters if p.name.startswith(("focal", "center"))]
    depth = depth_part(_all_points(scans), fitted.numbers[INDEX["middle_z"]])
    _, _, sigma = replace(fitted, extra_px=0.0).predicted(problem.rows)
    return FittedProjector(
        device=device,
        lens=chosen,
        parameters=parameters,
        covariance=covariance,
        residual_px=residuals,
        trials=trials,
        held_out_rms_px=next(t.held_out_rms_px for t in trials if t.lens == chosen),
        noise_px=float(np.median(sigma)),
        extra_px=fitted.extra_px,
        n_used=len(problem.rows),
        n_directions=problem.n_directions,
        depth_part=depth,
        is_determined=depth >= FLAT_PART and all(p.held_by != "prior" for p in pinhole),
        _solution=fitted,
        _middle_mm=problem.middle_mm,
        _wide_covariance=problem.covariance(fitted, LENSES[-1]),
    )


def residual_px(device: Device, scan: LitPoints, /) -> Floats:
    """Return where a projector puts the light of points minus where it was measured to come from.

    Parameters
    ----------
    device : Device; any projector
    scan : LitPoints

    Returns
    -------
    (n, n_angles) float64, px; NaN where nothing was measured
    """
    pixels = project(device, scan.points_mm)
    columns = [across(angle, pixels[:, 0], pixels[:, 1]) for angle in scan.angles]
    return np.asarray(np.stack(columns, axis=1) - scan.position_px)


def _all_points(scans: Sequence[LitPoints]) -> Floats:
    return np.concatenate([scan.points_mm for scan in scans])


def depth_part(points_mm: Floats, distance_mm: float, /) -> float:
    """Return by how much points leave their common plane, over their distance.

    Parameters
    ----------
    points_mm : (n, 3) float, mm; finite
    distance_mm : float, mm

    Returns
    -------
    float
        The range off the plane that holds 98 % of the points, over the distance. Below `FLAT_PART`
        they tell no more than a plane.

    Examples
    --------
    >>> xy = np.mgrid[:10, :10].reshape(2, -1)
    >>> round(depth_part(np.stack([*xy, xy.sum(axis=0) % 2], axis=1).astype(float), 500.0), 4)
    0.002
    """
    middle = points_mm.mean(axis=0)
    _, axes = np.linalg.eigh((points_mm - middle).T @ (points_mm - middle))
    low, high = np.percentile((points_mm - middle) @ axes[:, 0], ROBUST_RANGE)
    return float(high - low) / distance_mm
