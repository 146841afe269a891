"""A result folder made by hand: a bump, with known figures, and words that must be escaped."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fringe3d.io.results import toml_document, write_points
from fringe3d.model import Rejection

SHAPE = (60, 80)
TITLE = "<script>alert('x')</script> & co"
N_DARK, N_SATURATED = 80 * 5, 40


def write_stored_result(folder: Path) -> Path:
    """Write it; 5 dark rows, 40 saturated pixels, all else points."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    z = 100 - 8 * np.exp(-((rows - 30) ** 2 + (cols - 40) ** 2) / 200)
    rejection = np.zeros(SHAPE, np.uint16)
    rejection[:5] = Rejection.LOW_MODULATION | Rejection.NO_MATCH
    rejection[10, :N_SATURATED] = Rejection.SATURATED
    bad = rejection != 0
    points = np.stack([(cols - 40) / 4, (rows - 30) / 4, z], axis=-1)
    points[bad] = np.nan

    def kept(values: np.ndarray) -> np.ndarray:
        return np.where(bad, np.nan, values).astype(np.float32)

    folder.mkdir(parents=True)
    write_points(folder / "points.npz", {
        "points_mm": points,
        "sigma_mm": kept(0.010 + 0.0005 * np.abs(cols - 40)),
        "skew_mm": kept(np.full(SHAPE, 0.004)),
        "order_probability": kept(1 - 0.2 * (cols > 70)),
        "offset": (100 + cols).astype(np.float32),
        "modulation": np.full(SHAPE, 50, np.float32),
        "rejection": rejection,
    })  # fmt: skip
    record = {
        "summary": "a bump", "method": "m2", "why_this_method": "it <b>fits</b>", "images_used": 9,
        "title": TITLE, "time": "2026-05-04", "versions": {"fringe3d": "0.1.0"},
        "options": {"method": "auto"}, "seconds": {"decoding": 0.1},
        "health": [{"level": "ok", "name": "a", "value": 1.0, "text": "all is well"},
                   {"level": "warning", "name": "b", "value": 2.0, "text": "gamma; expose anew"}],
        "images": {"c1": {"count": 9, "sha256": "abc"}},
        "decoding": [{"camera": "c1", "direction": "x", "period_px": 16.0}],
        "request": {"command": "fringe3d measure 'a&b' --out <here>", "scan": "a&b"},
    }  # fmt: skip
    (folder / "measure.toml").write_text(toml_document(record), encoding="utf-8")
    return folder
