"""Homologous points: where the devices see, and the projector lights, the same point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry import pixel_grid
from fringe3d.model import PhaseMap

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TWO_PI = 2 * np.pi

NEIGHBOURS = 4
"""Pixels a side, over which the slope of a phase is taken: between two alone noise is too much."""

MAX_JUMP_RAD = 2.5
"""From the point to a neighbour; more is a depth edge."""

MAX_BEND_RAD = 0.15
"""Rms by which neighbours may leave their plane: the slope holds within a few pixels alone."""

BILINEAR_NOISE = 2 / 3
"""Standard deviation between four pixels over that of one: (2/3)^2 is the mean of the weights."""

LEAST_SIGMA_PX = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """What a further camera sees of the points, to first order about a pixel near each of them.

    Parameters
    ----------
    device : str
    pixels : (n, 2) float, px; (x, y); NaN where it sees nothing
    ahead_px : (n, k) float, projector px; the coordinate w of the light there, less that of the
        point, for each fringe angle; NaN where it is not known
    slopes : (n, k, 2) float; change of w with x and y
    sigma_px : (n, k) float, projector px; of w
    """

    device: str
    pixels: Floats
    ahead_px: Floats
    slopes: Floats
    sigma_px: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Homologous:
    """Homologous points of one scan.

    Parameters
    ----------
    pixels_c1 : (n, 2) float, px; (x, y) in C1
    angles : tuple of float, rad; fringe angles
    position_px : (n, k) float, projector px
        The coordinate w of the light on each point; NaN where it is not known.
    sigma_px : (n, k) float, projector px
    sights : tuple of Sight; the further cameras
    name : str; of the scan
    """

    pixels_c1: Floats
    angles: tuple[float, ...]
    position_px: Floats
    sigma_px: Floats
    sights: tuple[Sight, ...] = ()
    name: str = ""

    @property
    def n_points(self) -> int:
        """Return the number of points."""
        return len(self.pixels_c1)

    def subset(self, kept: NDArray[np.intp] | Bools) -> Homologous:
        """Return some of the points."""
        return Homologous(
            pixels_c1=self.pixels_c1[kept],
            angles=self.angles,
            position_px=self.position_px[kept],
            sigma_px=self.sigma_px[kept],
            sights=tuple(
                Sight(
                    device=s.device,
                    pixels=s.pixels[kept],
                    ahead_px=s.ahead_px[kept],
                    slopes=s.slopes[kept],
                    sigma_px=s.sigma_px[kept],
                )
                for s in self.sights
            ),
            name=self.name,
        )


def homologous_points(
    phases: Sequence[PhaseMap],
    positions_px: Sequence[Floats],
    seen: Sequence[tuple[str, Floats, Sequence[PhaseMap]]],
    good: Bools,
    /,
    *,
    name: str = "",
) -> Homologous:
    """Collect homologous points of a scan.

    Parameters
    ----------
    phases : PhaseMap of C1 for each fringe angle
    positions_px : (row, col) float of each, projector px; the coordinate w, NaN where not known
    seen : (name, (row, col, 2) px, PhaseMap for each fringe angle) of further cameras
        A pixel within half a period of the homologous one.
    good : (row, col) bool; pixels of C1 to take
    name : str; of the scan

    Returns
    -------
    Homologous
        Points that no further camera sees in any direction keep what the projector tells.
    """
    turned = [m.period_px / TWO_PI for m in phases]
    sigma = [
        np.fmax(m.phase_std[good] * px, LEAST_SIGMA_PX)
        for m, px in zip(phases, turned, strict=True)
    ]
    return Homologous(
        pixels_c1=pixel_grid(good.shape)[good],
        angles=tuple(m.angle for m in phases),
        position_px=np.stack([w[good] for w in positions_px], axis=1),
        sigma_px=np.stack(sigma, axis=1),
        sights=tuple(_sight(device, pixels[good], maps, [m.phase[good] for m in phases])
                     for device, pixels, maps in seen),
        name=name,
    )  # fmt: skip


def _sight(
    device: str, pixels: Floats, maps: Sequence[PhaseMap], phases: Sequence[NDArray[np.float32]]
) -> Sight:
    found = [_near(m, pixels, phase) for m, phase in zip(maps, phases, strict=True)]
    return Sight(
        device=device,
        pixels=pixels,
        ahead_px=np.stack([ahead for ahead, _, _ in found], axis=1),
        slopes=np.stack([slopes for _, slopes, _ in found], axis=1),
        sigma_px=np.stack([sigma for _, _, sigma in found], axis=1),
    )


def _near(
    seen: PhaseMap, pixels: Floats, phase: NDArray[np.float32]
) -> tuple[Floats, Floats, Floats]:
    """Return w near pixels less that of the points, its slopes, and its standard deviation.

    The value is bilinear between the four neighbours, the slope that of a plane through 4 x 4.
    """
    n_rows, n_cols = seen.phase.shape
    ahead, sigma = np.full(len(pixels), np.nan), np.full(len(pixels), np.nan)
    slopes = np.full((len(pixels), 2), np.nan)
    x, y = pixels.T
    with np.errstate(invalid="ignore"):
        inside = (x >= 1) & (x < n_cols - 2) & (y >= 1) & (y < n_rows - 2)
        inside &= np.isfinite(phase)
    col, row = np.floor(x[inside]).astype(int), np.floor(y[inside]).astype(int)
    step = np.arange(NEIGHBOURS) - 1
    rows, cols = row[:, None, None] + step[:, None], col[:, None, None] + step
    there = seen.phase[rows, cols].astype(np.float64) - phase[inside, None, None]
    there -= TWO_PI * np.rint(there / TWO_PI)
    centred = step - 0.5
    gx = (there * centred).sum(axis=(1, 2)) / (NEIGHBOURS * (centred**2).sum())
    gy = (there * centred[:, None]).sum(axis=(1, 2)) / (NEIGHBOURS * (centred**2).sum())
    plane = there.mean(axis=(1, 2))[:, None, None] + (
        gx[:, None, None] * centred + gy[:, None, None] * centred[:, None]
    )
    bend = np.sqrt(((there - plane) ** 2).mean(axis=(1, 2)))
    fx, fy = x[inside] - col, y[inside] - row
    a, b, c, d = there[:, 1, 1], there[:, 1, 2], there[:, 2, 1], there[:, 2, 2]
    value = (a * (1 - fx) + b * fx) * (1 - fy) + (c * (1 - fx) + d * fx) * fy
    std = seen.phase_std[row, col] * BILINEAR_NOISE
    good = (np.abs(there).max(axis=(1, 2)) < MAX_JUMP_RAD) & (bend < MAX_BEND_RAD)
    to_px = seen.period_px / TWO_PI
    place = np.flatnonzero(inside)[good]
    ahead[place], sigma[place] = value[good] * to_px, np.fmax(std[good] * to_px, LEAST_SIGMA_PX)
    slopes[place] = np.stack([gx, gy], axis=1)[good] * to_px
    return ahead, slopes, sigma
