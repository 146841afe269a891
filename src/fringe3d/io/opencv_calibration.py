"""Calibrations written by OpenCV (YAML, XML, JSON) to rigs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fringe3d.errors import RigError
from fringe3d.model import Device, Rig, RigidTransform
from fringe3d.model.device import Role


@dataclass(frozen=True, slots=True)
class CalibrationKeys:
    """Names under which a file keeps matrices; R and T map the first device to the second."""

    matrix1: str
    distortion1: str
    matrix2: str
    distortion2: str
    rotation: str
    translation: str
    second_role: Role


KNOWN_KEYS = (
    CalibrationKeys("M1", "D1", "M4", "D4", "Rlp", "Tlp", "projector"),
    CalibrationKeys("M1", "D1", "M2", "D2", "Rlr", "Tlr", "camera"),
    CalibrationKeys("cam_K", "cam_kc", "pro_K", "pro_kc", "R", "T", "projector"),
    CalibrationKeys("M1", "D1", "M2", "D2", "R", "T", "camera"),
    CalibrationKeys("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T",
                    "camera"),
)  # fmt: skip


def read_opencv_calibration(
    path: Path,
    /,
    *,
    first_size: tuple[int, int],
    second_size: tuple[int, int] | None = None,
    keys: CalibrationKeys | None = None,
    second_from_first: bool = True,
    names: tuple[str, str] = ("c1", ""),
) -> Rig:
    """Read a pair of devices from a file of OpenCV's FileStorage.

    The first device becomes the world frame.

    Parameters
    ----------
    path : YAML, XML or JSON file
    first_size, second_size : (width, height), px; the second defaults to the first
    keys : names of the matrices, or None to recognise a known set
    second_from_first : bool
        OpenCV's convention ``X_second = R X_first + T``; False for the opposite direction.
    names : names of the devices; an empty second one becomes "c2" or "projector"
    """
    if not path.is_file():
        raise RigError(f"{path}: expected a calibration file, found none. Check the path")
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    except (cv2.error, SystemError):
        storage = None
    if storage is None or not storage.isOpened():
        raise RigError(
            f"{path}: expected OpenCV YAML, XML or JSON, found something else. Check the file"
        )
    keys = keys or _recognise(path, storage)
    pose = RigidTransform(
        rotation=_matrix(path, storage, keys.rotation),
        translation=_matrix(path, storage, keys.translation).ravel(),
    )
    second_name = names[1] or ("c2" if keys.second_role == "camera" else "projector")
    first = _device(path, storage, names[0], "camera", keys.matrix1, keys.distortion1,
                    first_size, RigidTransform.identity())  # fmt: skip
    second = _device(path, storage, second_name, keys.second_role, keys.matrix2, keys.distortion2,
                     second_size or first_size,
                     pose if second_from_first else pose.inverse())  # fmt: skip
    is_camera = keys.second_role == "camera"
    return Rig(
        cameras=(first, second) if is_camera else (first,),
        projector=None if is_camera else second,
        provenance=f"{path.name}, keys {keys.matrix1} {keys.matrix2} {keys.rotation}",
    )


def _recognise(path: Path, storage: cv2.FileStorage) -> CalibrationKeys:
    present = set(storage.root().keys())
    for keys in KNOWN_KEYS:
        wanted = (keys.matrix1, keys.distortion1, keys.matrix2, keys.distortion2,
                  keys.rotation, keys.translation)  # fmt: skip
        # A stereo file may carry the pose of a projector from another calibration: a set counts
        # only if it is complete.
        if set(wanted) <= present:
            return keys
    raise RigError(
        f"{path}: expected one of the known sets of matrices "
        f"({'; '.join(' '.join((k.matrix1, k.matrix2, k.rotation)) for k in KNOWN_KEYS)}), found "
        f"{', '.join(sorted(present))}. Name them with --calibration-keys"
    )


def _matrix(path: Path, storage: cv2.FileStorage, key: str) -> NDArray[np.float64]:
    node = storage.getNode(key)
    matrix = None if node.empty() else node.mat()
    if matrix is None or matrix.size == 0:
        raise RigError(f"{path}: expected a matrix '{key}', found none. Check --calibration-keys")
    return np.asarray(matrix, np.float64)


def _device(
    path: Path,
    storage: cv2.FileStorage,
    name: str,
    role: Role,
    matrix_key: str,
    distortion_key: str,
    size: tuple[int, int],
    pose: RigidTransform,
) -> Device:
    matrix = _matrix(path, storage, matrix_key)
    if matrix.shape != (3, 3):
        raise RigError(f"{path}: {matrix_key}: expected a 3 x 3 matrix, found {matrix.shape}")
    return Device(
        name=name,
        role=role,
        n_rows=size[1],
        n_cols=size[0],
        focal_px=[matrix[0, 0], matrix[1, 1]],
        center_px=[matrix[0, 2], matrix[1, 2]],
        distortion=_matrix(path, storage, distortion_key).ravel(),
        device_from_world=pose,
    )
