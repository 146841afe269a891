"""Images of a lit chessboard, rendered by themselves: the truth of corner detection and light."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from board_series import device
from cv_lens import cv_project, cv_rays
from fringe3d.model import Board, Fringe, GrayBit, ImageStack, PatternPlan, Uniform
from fringe3d.model.plan import fringes, gray_code

Floats = NDArray[np.float64]

CAMERA = device("c1", "camera", (480, 384), [800, 801], [238, 193], [-0.1, 0.05, 0, 0])
PROJECTOR = device("projector", "projector", (320, 240), [520, 519], [158, 130], [-0.04, 0, 0, 0],
                   [0.0, 0.25, 0.02], [-120, 5, 15])  # fmt: skip
BOARD = Board(kind="chessboard", n_cols=8, n_rows=6, pitch_mm=20.0)

SAMPLES = 2
PSF_PX = 0.5
"""Standard deviation of the lens's blur, camera px."""

WHITE, BLACK, READ_NOISE = 0.9, 0.08, 0.8

FRINGES = PatternPlan(
    patterns=(*fringes(16.0, 4), *gray_code(16.0, 5), *fringes(16.0, 4, angle=np.pi / 2),
              *gray_code(16.0, 4, angle=np.pi / 2), Uniform(level=1.0)),
    projector_shape=(240, 320),
)  # fmt: skip
GRAY = PatternPlan(
    patterns=(*gray_code(1.0, 9, inverses=True), *gray_code(1.0, 8, angle=np.pi / 2, inverses=True),
              Uniform(level=1.0), Uniform(level=0.0)),
    projector_shape=(240, 320),
)  # fmt: skip


def render(plan: PatternPlan, turn: Floats, place: Floats, *, seed: int = 0) -> ImageStack:
    """Return what the camera sees of the board, whose middle stands at `place`, mm."""
    rng = np.random.default_rng(seed)
    origin, directions = _fine_rays(CAMERA.name)
    rotation = Rotation.from_rotvec(turn).as_matrix()
    depth = ((place - origin) @ rotation[:, 2]) / (directions @ rotation[:, 2])
    world = origin + depth[..., None] * directions
    flat = (world - place) @ rotation[:, :2] + BOARD.points_mm.mean(axis=0)[:2]
    square = np.floor(flat / BOARD.pitch_mm).astype(int)
    inside = ((square >= -1) & (square <= [BOARD.n_cols - 1, BOARD.n_rows - 1])).all(axis=-1)
    reflectance = np.where(inside & (square.sum(axis=-1) % 2 == 0), BLACK, WHITE)
    light = cv_project(PROJECTOR, world)
    images = []
    for pattern in plan.patterns:
        fine = reflectance * (0.04 + 0.96 * brightness(pattern, light))
        mean = fine.reshape(CAMERA.n_rows, SAMPLES, CAMERA.n_cols, SAMPLES).mean(axis=(1, 3))
        seen = 230 * gaussian_filter(mean, PSF_PX) + rng.normal(0, READ_NOISE, CAMERA.shape)
        images.append(np.clip(np.round(seen), 0, 255).astype(np.uint8))
    return ImageStack(images=np.stack(images), plan=plan, device_name=CAMERA.name,
                      saturation_dn=255)  # fmt: skip


@cache
def _fine_rays(name: str) -> tuple[Floats, Floats]:
    """Return the rays through all parts of all pixels; only one camera is rendered here."""
    assert name == CAMERA.name
    step = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    rows, cols = np.arange(CAMERA.n_rows), np.arange(CAMERA.n_cols)
    y, x = np.meshgrid((rows[:, None] + step).ravel(), (cols[:, None] + step).ravel(),
                       indexing="ij")  # fmt: skip
    return cv_rays(CAMERA, np.stack([x, y], axis=-1))


def brightness(pattern: Any, light: Floats) -> Floats:
    """Return the light of a pattern at projector pixels (x, y), 0 to 1; whole pixels."""
    pixel = np.round(light)
    on = ((pixel >= 0) & (pixel < [PROJECTOR.n_cols, PROJECTOR.n_rows])).all(axis=-1)
    if isinstance(pattern, Uniform):
        return np.where(on, pattern.level, 0.0)
    w = pixel[..., 0 if pattern.angle == 0 else 1] + 0.5
    if isinstance(pattern, Fringe):
        value = 0.5 + 0.45 * np.cos(2 * np.pi * w / pattern.period_px - pattern.shift)
    else:
        assert isinstance(pattern, GrayBit)
        cell = np.floor(w / pattern.cell_px).astype(int) % (1 << pattern.n_bits)
        bit = ((cell ^ (cell >> 1)) >> pattern.bit) & 1
        value = np.asarray((bit == 1) != pattern.inverted, np.float64)
    return np.where(on, value, 0.0)


def true_corners(turn: Floats, place: Floats) -> tuple[Floats, Floats]:
    """Return the corners in the camera and in the projector, (n, 2) each."""
    points = BOARD.points_mm - BOARD.points_mm.mean(axis=0)
    world = Rotation.from_rotvec(turn).apply(points) + place
    return cv_project(CAMERA, world), cv_project(PROJECTOR, world)
