"""Calibrations written by OpenCV (YAML, XML, JSON) to rigs."""

from __future__ import annotations

from collections.abc import Sequence
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

FORMS = (".yml", ".yaml", ".xml", ".json")


def read_opencv_calibration(
    path: Path,
    /,
    *,
    camera_sizes: Sequence[tuple[int, int]],
    projector_size: tuple[int, int] | None = None,
    keys: CalibrationKeys | None = None,
    second_from_first: bool = True,
    camera_names: Sequence[str] = ("c1", "c2"),
) -> Rig:
    """Read a pair of devices from a file of OpenCV's FileStorage.

    The first device becomes the world frame.

    Parameters
    ----------
    path : YAML, XML or JSON file
    camera_sizes : (width, height), px, of one or two cameras
    projector_size : (width, height), px, or None; needed if the second device is a projector
    keys : names of the matrices, or None to recognise a known set
    second_from_first : bool
        OpenCV's convention ``X_second = R X_first + T``; False for the opposite direction.
    camera_names : names of one or two cameras
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
    second_name, second_size = _second(path, keys, camera_names, camera_sizes, projector_size)
    first = _device(path, storage, camera_names[0], "camera", keys.matrix1, keys.distortion1,
                    camera_sizes[0], RigidTransform.identity())  # fmt: skip
    second = _device(path, storage, second_name, keys.second_role, keys.matrix2, keys.distortion2,
                     second_size,
                     pose if second_from_first else pose.inverse())  # fmt: skip
    is_camera = keys.second_role == "camera"
    return Rig(
        cameras=(first, second) if is_camera else (first,),
        projector=None if is_camera else second,
        provenance=f"{path.name}, keys {keys.matrix1} {keys.matrix2} {keys.rotation}",
    )


def opencv_text(
    first: Device, second: Device, /, *, form: str = ".yml", second_from_first: bool = True
) -> str:
    """Return the text of a file that OpenCV, and `read_opencv_calibration`, reads.

    Parameters
    ----------
    first, second : Device; the first, a camera, becomes the world frame
    form : ".yml", ".yaml", ".xml" or ".json"
    second_from_first : bool
        OpenCV's convention ``X_second = R X_first + T``; False for the opposite direction.

    Raises
    ------
    RigError
        If the form is another, or the first device is a projector.
    """
    if form.lower() not in FORMS:
        raise RigError(f"expected a name that ends in {', '.join(FORMS)}, found '{form}'")
    if first.role != "camera":
        raise RigError(f"expected a camera as first device, found projector '{first.name}'")
    keys = next(k for k in reversed(KNOWN_KEYS[:4]) if k.second_role == second.role)
    pose = second.device_from_world @ first.device_from_world.inverse()
    pose = pose if second_from_first else pose.inverse()
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage(f"calibration{form.lower()}", flags)
    for device, matrix_key, distortion_key, size_key in (
        (first, keys.matrix1, keys.distortion1, "image_size1"),
        (second, keys.matrix2, keys.distortion2, "image_size2"),
    ):
        storage.write(matrix_key, device.camera_matrix)
        storage.write(distortion_key, _coefficients(device)[None])
        storage.write(size_key, np.array([[device.n_cols, device.n_rows]], np.int32))
    storage.write(keys.rotation, pose.rotation)
    storage.write(keys.translation, pose.translation[:, None])
    return str(storage.releaseAndGetString())


def _coefficients(device: Device) -> NDArray[np.float64]:
    """Return the distortion, 5 numbers or as many as OpenCV needs."""
    used = int(np.flatnonzero(device.distortion).max(initial=-1)) + 1
    return device.distortion[: next(n for n in (5, 8, 12, 14) if n >= used)]


def _second(
    path: Path,
    keys: CalibrationKeys,
    camera_names: Sequence[str],
    camera_sizes: Sequence[tuple[int, int]],
    projector_size: tuple[int, int] | None,
) -> tuple[str, tuple[int, int]]:
    """Return name and size of the second device."""
    if keys.second_role == "projector":
        if projector_size is None:
            raise RigError(
                f"{path}: expected the size of the projector image, found none. "
                "Give it with --projector-size WIDTHxHEIGHT"
            )
        return "projector", projector_size
    if len(camera_names) < 2:
        raise RigError(
            f"{path}: holds two cameras, but the recording has one. Name the second with "
            "--camera, or the projector's matrices with --calibration-keys ...:projector"
        )
    return camera_names[1], camera_sizes[1]


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
