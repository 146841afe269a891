"""A check of two cameras by the texture of the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fringe3d.geometry import epipolar_curve, epipolar_segment
from fringe3d.health import _contrast, _correlate
from fringe3d.health.finding import Finding
from fringe3d.kernels import over_rows
from fringe3d.model import Correspondences, Device, PhaseMap

TILES_PER_SIDE = 3
MIN_TILE_POINTS = 1_000
SAMPLE, TILE_SAMPLE = 40_000, 2_000
MAX_WRONG_TILES = 0.25
"""Part of the telling tiles that may lie elsewhere by chance or by repeating texture."""

FAR_MM = 1e5

SMOOTH_PX, BLOCK_PX = 8, 4
"""The slow changes of the brightness: a Gaussian over the means of small blocks."""

TEXTURE_REACH = 5
"""Shifts up to this part of the image are tried."""

TEXTURE_STEP_PX = 3
"""The texture is smoothed by 1 px; its correlation is about 5 px wide."""

ROUGH_STEP, N_PEAKS = 4, 8
"""Every fourth point of a tile, some 500, tells correlations within 0.045: the eight best shifts
are looked at with all."""

TEXTURE_MIN_PEAK = 0.25
TEXTURE_MAX_SHIFT_PX = 3
TEXTURE_CLEAR = 0.12
"""The peak of the texture correlation must stand out this far to accuse the calibration."""

CORRELATION = "correlation"
"""Key of the figure: of the texture, at the matched points."""

PEAK_WIDTH_PX, PEAK_CLEAR, PEAK_SURE = 10, 0.06, 0.4
"""Half of the width of a peak. It stands for a match if it is sure, or if those at other shifts are
lower by more than their uncertainty: the slow shading of a small round body gives several low ones.
"""

TEXTURE_MIN_SIGNAL = 4.0
FINE_FILTER_PIXELS = 4 * np.pi
"""Pixels that a Gaussian of 1 px averages over."""


def check_texture(
    matches: Correspondences, phases1: PhaseMap, phases2: PhaseMap, c1: Device, c2: Device, /
) -> list[Finding]:
    """Compare the texture of two cameras at phase-matched points.

    Fringes of one direction show no epipolar error: a wrong calibration gives a pretty, wrong
    cloud. But the surface itself, seen by both cameras, must agree at the matched points, and
    disagree a few pixels beside the epipolar curve. Judged in tiles of the image, because a
    turned camera may be right in the middle and wrong at the rim.
    """
    tiles = texture_tiles(matches, phases1, phases2, c1, c2)
    agree = [tile for tile in tiles if tile.agrees]
    elsewhere = [tile for tile in tiles if tile.lies_elsewhere]
    name = "texture_shift_px"
    wrong = "the calibration does not belong to these images. Check the rig file"
    if len(elsewhere) > MAX_WRONG_TILES * (len(agree) + len(elsewhere)):
        shift = float(np.median([abs(tile.best_shift) for tile in elsewhere]))
        text = (
            f"in {len(elsewhere)} of {len(tiles)} parts of the image the texture of both cameras "
            f"agrees not at the matched points, but about {shift:.0f} px beside the epipolar "
            f"curves: {wrong}"
        )
        return [Finding("error", name, shift, text)]
    if agree:
        typical = float(np.median([tile.here for tile in agree]))
        text = (
            f"the texture of both cameras agrees at the matched points (in {len(agree)} of "
            f"{len(tiles)} parts of the image, correlation {typical:.2f})"
        )
        return [Finding("ok", name, 0.0, text, {CORRELATION: typical})]
    if not tiles or texture_signal(phases1) < TEXTURE_MIN_SIGNAL:
        return [Finding("ok", name, float("nan"), "too little texture to check the calibration")]
    text = (
        f"the texture of both cameras does not agree at the matched points: {wrong}, unless the "
        "surface shines like a mirror"
    )
    return [Finding("warning", name, float("nan"), text)]


@dataclass(frozen=True, slots=True)
class TextureTile:
    """Correlation of the textures in one part of the image: at the matched points, and at best.

    `rival` is the largest at a shift clearly apart from the best.
    """

    here: float
    best: float
    best_shift: int
    rival: float = 0.0

    @property
    def agrees(self) -> bool:
        """Tell whether the textures agree at the matched points."""
        return self.here >= TEXTURE_MIN_PEAK and self.best - self.here <= TEXTURE_CLEAR

    @property
    def lies_elsewhere(self) -> bool:
        """Tell whether the textures agree clearly better beside the epipolar curves."""
        is_peak = self.best >= PEAK_SURE or self.best - self.rival > PEAK_CLEAR
        is_better = self.best - self.here > TEXTURE_CLEAR
        return self.best >= TEXTURE_MIN_PEAK and is_peak and is_better


def texture_signal(phases: PhaseMap, /) -> float:
    """Return how far the texture of the surface stands out of the noise."""
    texture = _texture(phases)
    good = np.isfinite(texture)
    if not good.any():
        return 0.0
    # sigma_A = sigma_I / sqrt(N) = sigma_phase B / sqrt(2); the filter averages 12 pixels.
    noise = phases.phase_std[good] * phases.modulation[good] / np.sqrt(2 * FINE_FILTER_PIXELS)
    return float(np.std(texture[good]) / np.median(noise / np.maximum(phases.offset[good], 1.0)))


def texture_tiles(
    matches: Correspondences, phases1: PhaseMap, phases2: PhaseMap, c1: Device, c2: Device, /
) -> list[TextureTile]:
    """Correlate the textures in tiles of C1, for shifts across the epipolar curves in C2.

    Only tiles with enough matched points are returned.
    """
    texture1, texture2 = _texture(phases1), _texture(phases2)
    index = np.flatnonzero((matches.rejection == 0) & np.isfinite(texture1))
    index = index[:: max(1, len(index) // SAMPLE) | 1]  # an odd step leaves out no column
    usable = np.column_stack(np.unravel_index(index, texture1.shape))
    if len(usable) < MIN_TILE_POINTS:
        return []
    normal = _across_epipolar(c1, c2, matches)
    reach = max(c2.n_rows, c2.n_cols) // TEXTURE_REACH
    shifts = np.arange(-reach, reach + 1)
    near = np.abs(shifts) <= TEXTURE_MAX_SHIFT_PX
    shifts = shifts[near | (shifts % TEXTURE_STEP_PX == 0)]
    near = np.abs(shifts) <= TEXTURE_MAX_SHIFT_PX
    low, high = usable.min(axis=0), usable.max(axis=0) + 1
    number = ((usable - low) * TILES_PER_SIDE // (high - low)) @ [TILES_PER_SIDE, 1]
    tiles = []
    for tile in range(TILES_PER_SIDE**2):
        rows, cols = usable[number == tile].T
        if len(rows) < MIN_TILE_POINTS:
            continue
        thin = slice(None, None, max(1, len(rows) // TILE_SAMPLE))
        values, pixels = texture1[rows[thin], cols[thin]], matches.pixels[rows[thin], cols[thin]]
        tiles.append(_correlated(values, pixels, texture2, normal, shifts, near))
    return tiles


def _correlated(
    values: NDArray[np.float32],
    pixels: NDArray[np.float64],
    texture: NDArray[np.float32],
    normal: NDArray[np.float64],
    shifts: NDArray[np.intp],
    near: NDArray[np.bool_],
) -> TextureTile:
    """Correlate a tile at shifts: a quarter of its points tells where it is worth looking."""
    part, rough = slice(None, None, ROUGH_STEP), np.empty(len(shifts))
    least = MIN_TILE_POINTS // 2
    over_rows(
        _correlate.profile, len(shifts), values[part], pixels[part], texture, normal, shifts,
        least // ROUGH_STEP, rough, least=1,
    )  # fmt: skip
    looked_at = shifts[np.argsort(-np.where(near, np.inf, rough))[: near.sum() + N_PEAKS]]
    profile = np.empty(len(looked_at))
    over_rows(_correlate.profile, len(looked_at), values, pixels, texture, normal, looked_at,
              least, profile, least=1)  # fmt: skip
    peak = int(np.argmax(profile))
    here = float(profile[np.abs(looked_at) <= TEXTURE_MAX_SHIFT_PX].max())
    apart = np.abs(shifts - looked_at[peak]) > PEAK_WIDTH_PX
    rival = float(rough[apart].max()) if apart.any() else 0.0
    return TextureTile(here, float(profile[peak]), int(looked_at[peak]), rival)


def _texture(phases: PhaseMap) -> NDArray[np.float32]:
    """Return the local contrast of the surface: brightness without its slow changes."""
    lit = phases.rejection == 0
    bright = np.log(np.maximum(phases.offset, np.float32(1)))
    bright[~lit] = np.nan
    contrast = np.empty_like(bright)
    over_rows(_contrast.fine_contrast, len(bright), bright, _slow_part(bright),
              np.float32(BLOCK_PX), contrast)  # fmt: skip
    return contrast


def _slow_part(bright: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the brightness without its fine structure, at the centres of blocks of pixels."""
    shape = [-(-n // BLOCK_PX) for n in bright.shape]
    total, count = np.zeros(shape), np.zeros(shape)
    for row in range(BLOCK_PX):  # row by row of all blocks: a sum over short axes is slow
        line = bright[row::BLOCK_PX]
        for col in range(BLOCK_PX):
            part = line[:, col::BLOCK_PX]
            known = np.isfinite(part)
            total[: part.shape[0], : part.shape[1]] += np.where(known, part, 0)
            count[: part.shape[0], : part.shape[1]] += known
    total, count = (ndimage.gaussian_filter(image, SMOOTH_PX / BLOCK_PX, mode="constant")
                    for image in (total, count))  # fmt: skip
    return np.asarray(total / np.maximum(count, 1e-9), np.float32)


def _across_epipolar(c1: Device, c2: Device, matches: Correspondences) -> NDArray[np.float64]:
    """Return the unit normal of the epipolar curve in C2, for the middle of the matched pixels."""
    index = np.flatnonzero(matches.rejection == 0)
    row, col = divmod(int(index[len(index) // 2]), matches.rejection.shape[1])
    middle = np.array([col, row], np.float64)
    near, far = epipolar_segment(c1, c2, middle, None)
    curve = epipolar_curve(
        c1, c2, middle, np.geomspace(float(near), min(float(far), FAR_MM), 3)[1:]
    )
    tangent = curve[1] - curve[0]
    normal: NDArray[np.float64] = np.array([-tangent[1], tangent[0]]) / np.linalg.norm(tangent)
    return normal if normal[1] >= 0 else -normal
