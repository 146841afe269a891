"""How nouns show themselves in a notebook: a table, and a map as a small picture.

No drawing library is loaded for that: `fringe3d.plot` makes real pictures.
"""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Iterable
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

SHOWN_PX = 320
"""Maps are thinned to about this size."""

COLOURS = np.array(
    [[122, 4, 3], [208, 47, 5], [251, 126, 33], [238, 207, 58], [164, 252, 60],
     [50, 242, 152], [40, 188, 235], [70, 107, 227], [48, 18, 59]], np.float64
)  # fmt: skip
"""Evenly spaced colours of matplotlib's turbo, the other way round, as in other pictures."""

GREYS = np.array([[0, 0, 0], [255, 255, 255]], np.float64)
MISSING = (16, 18, 22)


def table(title: str, rows: Iterable[tuple[str, object]], /, *, more: str = "") -> str:
    """Return a titled table of names and values as HTML; nothing in them is markup.

    Parameters
    ----------
    title : str
    rows : pairs of a name and a value
    more : str; HTML that follows

    Examples
    --------
    >>> table("plan", [("images", 4)])
    '<div><b>plan</b><table><tr><th>images</th><td>4</td></tr></table></div>'
    """
    cells = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows
    )
    return f"<div><b>{escape(title)}</b><table>{cells}</table>{more}</div>"


def picture(values: NDArray[Any], /, *, grey: bool = False) -> str:
    """Return a map (row, col) as an HTML picture, in colours from the least to the greatest value.

    Parameters
    ----------
    values : (row, col) number; NaN is dark
    grey : bool; in grey levels
    """
    rows, cols = values.shape
    step = max(1, -(-max(rows, cols) // SHOWN_PX))
    shown = np.asarray(values[::step, ::step], np.float64)
    finite = shown[np.isfinite(shown)]
    low, high = np.percentile(finite, [1, 99]) if finite.size else (0.0, 1.0)
    part = np.nan_to_num(np.clip((shown - low) / max(high - low, 1e-12), 0, 1))
    ramp = GREYS if grey else COLOURS
    stops = np.linspace(0, 1, len(ramp))
    pixels = np.stack([np.interp(part, stops, channel) for channel in ramp.T], axis=-1)
    pixels[~np.isfinite(shown)] = MISSING
    data = base64.b64encode(png(pixels.astype(np.uint8))).decode("ascii")
    return f'<img alt="{low:.4g} to {high:.4g}" src="data:image/png;base64,{data}">'


def png(pixels: NDArray[np.uint8], /) -> bytes:
    """Return a picture (row, col, rgb) as the bytes of a PNG file."""
    rows, cols, _ = pixels.shape
    lines = np.concatenate([np.zeros((rows, 1), np.uint8), pixels.reshape(rows, -1)], axis=1)
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", cols, rows, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(lines.tobytes())),
        (b"IEND", b""),
    )
    chunks = (
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)
