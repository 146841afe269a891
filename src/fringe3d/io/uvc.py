"""UVC cameras by OpenCV."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

MOST_CAMERAS = 10


class VideoSource:
    """Images of a UVC camera, or of a video file, as OpenCV reads them.

    Parameters
    ----------
    place : int (number of a camera) or Path (of a video)
    """

    def __init__(self, place: int | Path, /) -> None:
        self._capture = cv2.VideoCapture(place if isinstance(place, int) else str(place))
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)

    @property
    def is_open(self) -> bool:
        """Tell whether there is something to read."""
        return bool(self._capture.isOpened())

    @property
    def frames_per_s(self) -> float:
        """Return how many frames come in a second; 0 where nobody knows."""
        return float(self._capture.get(cv2.CAP_PROP_FPS))

    def expose(self, exposure_ms: float, gain_db: float, /) -> None:
        """Set exposure and gain by hand, as far as driver and camera let."""
        self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1)
        self._capture.set(cv2.CAP_PROP_EXPOSURE, 10 * exposure_ms)  # in units of 0.1 ms (V4L2)
        self._capture.set(cv2.CAP_PROP_GAIN, gain_db)

    def read(self) -> NDArray[np.unsignedinteger[Any]] | None:
        """Return the next image as grey values (row, col), None where there is none."""
        was_read, image = self._capture.read()
        if not was_read:
            return None
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
        return np.asarray(grey)

    def close(self) -> None:
        """Let go."""
        self._capture.release()


def uvc_cameras() -> list[int]:
    """Return the numbers of the UVC cameras of this machine (of Linux: /dev/videoN)."""
    nodes = sorted(Path("/dev").glob("video[0-9]*")) if Path("/dev").is_dir() else []
    return [int(node.name.removeprefix("video")) for node in nodes[:MOST_CAMERAS]]
