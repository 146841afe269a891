"""Rigs to try: each a rig, with the optics and the scale of objects that suit it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringe3d.geometry import above, looking_at_origin
from fringe3d.model import Device, MeasuringVolume, Rig, RigidTransform
from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.objects import HEIGHT_MM
from fringe3d.simulate.optics import Surface
from fringe3d.simulate.scene import Scene, table

BELOW_VOLUME = 0.04
"""Part of the volume's height by which the table lies below it."""

CAMERA_LENSES = ((-0.21, 0.35, 0.0007, -0.0011, 0.0), (-0.19, 0.28, -0.0009, 0.0006, 0.0))
PROJECTOR_LENS = (-0.12, 0.3, 0.0012, -0.0008, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Preset:
    """A rig that a user may have.

    Parameters
    ----------
    name : str
    about : str; one line
    rig : Rig
    period_px : float, projector px; fringes that suit it
    reduced_bits : int; a cyclic Gray code of so many bits numbers the periods on a segment, and
        40 % more: the table below the volume is seen, too
    diameter_mm, height_mm : float, mm; of the measuring volume, about the origin
    fringe_angle : float, rad; fringes that suit it
    lift_mm : float, mm; by which objects are held above the table, to be in the volume
    """

    name: str
    about: str
    rig: Rig
    period_px: float
    reduced_bits: int
    diameter_mm: float
    height_mm: float
    fringe_angle: float = 0.0
    lift_mm: float = 0.0

    @property
    def table_mm(self) -> float:
        """Return the z of the table's top, below the measuring volume, mm."""
        return -(0.5 + BELOW_VOLUME) * self.height_mm

    def scale(self) -> float:
        """Return the factor that fits the objects into the volume."""
        return min(self.diameter_mm / 80.0, self.height_mm / (HEIGHT_MM + 1))

    def scene(
        self,
        thing: Mesh,
        surface: Surface | None = None,
        *,
        background: str = "table",
        scaled: bool = True,
    ) -> Scene:
        """Stand an object on (or hold it above) a table, hang it before a wall, or in empty space.

        Parameters
        ----------
        thing : Mesh; standing on z = 0
        surface : Surface or None (default)
        background : "table", "wall" (a volume's height behind the table) or "none"
        scaled : bool; fit the object to the volume; leave a user's own mesh as it is
        """
        behind = {"table": 0.0, "wall": self.height_mm}
        width = 8 * self.diameter_mm
        if background not in (*behind, "none"):
            raise ValueError(f"background: expected table, wall or none, found '{background}'")
        surroundings = None
        if background in behind:
            surroundings = table(height_mm=self.table_mm - behind[background], width_mm=width)
        return Scene(
            thing=thing.scaled(self.scale()) if scaled else thing,
            surface=surface or Surface(),
            world_from_object=RigidTransform(
                rotation=np.eye(3), translation=[0, 0, self.table_mm + self.lift_mm]
            ),
            surroundings=surroundings,
        )


def _rig(
    cameras: Sequence[NDArray[np.float64]],
    projector: NDArray[np.float64],
    camera_size: tuple[int, int],
    *,
    field_mm: float,
    projector_focal_px: float,
    volume: MeasuringVolume,
    name: str,
) -> Rig:
    """Return a rig whose cameras see `field_mm` across the width of their image."""
    width, height = camera_size

    def camera(number: int, place: NDArray[np.float64]) -> Device:
        focal = width * float(np.linalg.norm(place)) / field_mm
        return Device(
            name=f"c{number + 1}",
            role="camera",
            n_rows=height,
            n_cols=width,
            focal_px=[focal, 1.001 * focal],
            center_px=[0.505 * width - 0.5, 0.49 * height - 0.5],
            distortion=CAMERA_LENSES[number],
            device_from_world=looking_at_origin(place),
        )

    light = Device(
        name="projector",
        role="projector",
        n_rows=768,
        n_cols=1024,
        focal_px=[projector_focal_px, 1.001 * projector_focal_px],
        center_px=[515.0, 371.0],
        distortion=PROJECTOR_LENS,
        device_from_world=looking_at_origin(projector),
    )
    return Rig(
        cameras=tuple(camera(number, place) for number, place in enumerate(cameras)),
        projector=light,
        volume=volume,
        provenance=f"fringe3d simulate {name}",
    )


def _upright(diameter_mm: float, height_mm: float) -> MeasuringVolume:
    return MeasuringVolume.cylinder(
        [0, 0, 0], [0, 0, 1], radius_mm=diameter_mm / 2, height_mm=height_mm
    )


def _kolibri_like(
    name: str,
    about: str,
    projector: NDArray[np.float64],
    camera_size: tuple[int, int],
    *,
    reduced_bits: int = 3,
    n_cameras: int = 2,
    fringe_angle_deg: float = 0.0,
) -> Preset:
    """Return the rig of the source paper with its projector at another place."""
    cameras = [above(27.0, azimuth, 335.0) for azimuth in (-31.0, 31.0)]
    rig = _rig(
        cameras[:n_cameras],
        projector,
        camera_size,
        field_mm=93.0,
        projector_focal_px=64.3 / 0.020,
        volume=_upright(80.0, 25.0),
        name=name,
    )
    return Preset(name=name, about=about, rig=rig, period_px=16.0, reduced_bits=reduced_bits,
                  diameter_mm=80.0, height_mm=25.0,
                  fringe_angle=float(np.radians(fringe_angle_deg)))  # fmt: skip


def kolibri(camera_size: tuple[int, int] = (640, 512)) -> Preset:
    """Return the rig that reproduces the source paper's numbers."""
    about = "the source paper's rig: angles 27 deg (C1-C2) and 13.6 deg (C-P)"
    return _kolibri_like("kolibri", about, above(22.0, 0.0, 335.0), camera_size)


def kolibri_m5(camera_size: tuple[int, int] = (640, 512)) -> Preset:
    """Return the rig whose projector is so near C1 that a segment holds less than one period."""
    about = f"as kolibri, the projector {M5_ANGLE_DEG:g} deg from C1: no Gray code needed (M5)"
    first, second = (above(27.0, azimuth, 335.0) for azimuth in (-31.0, 31.0))
    place = _towards(first, second, M5_ANGLE_DEG)
    return _kolibri_like("kolibri-m5", about, place, camera_size, reduced_bits=1)


M5_ANGLE_DEG = 2.9
"""The principal rays alone would allow 3.18 deg; the whole volume and a guard band less."""


def _towards(
    a: NDArray[np.float64], b: NDArray[np.float64], angle_deg: float
) -> NDArray[np.float64]:
    """Return `a`, turned about the origin towards `b`."""
    axis = a / np.linalg.norm(a)
    across = b - (b @ axis) * axis
    across /= np.linalg.norm(across)
    angle = np.radians(angle_deg)
    return np.asarray(np.linalg.norm(a) * (np.cos(angle) * axis + np.sin(angle) * across))


def designed(camera_size: tuple[int, int] = (640, 512)) -> Preset:
    """Return a rig whose projector stands where four images tell all periods apart."""
    about = "projector and turned fringes by the optimiser: four images, no Gray code"
    return _kolibri_like(
        "designed", about, above(*DESIGNED_PLACE, 335.0), camera_size, reduced_bits=1,
        fringe_angle_deg=DESIGNED_FRINGES_DEG,
    )  # fmt: skip


DESIGNED_PLACE, DESIGNED_FRINGES_DEG = (34.9, -24.2), 20.3
"""Tilt, azimuth and angle of the fringes, as ``fringe3d design kolibri --optimise`` recommends: 8.6
deg from C1, fringes so nearly along its epipolar lines that a segment holds less than a period."""


def single(camera_size: tuple[int, int] = (640, 512)) -> Preset:
    """Return one camera and a projector."""
    about = "one camera and the projector, 13.6 deg apart"
    return _kolibri_like("single", about, above(22.0, 0.0, 335.0), camera_size, n_cameras=1)


def wide_depth(camera_size: tuple[int, int] = (640, 512)) -> Preset:
    """Return a rig for depths of 400 to 700 mm."""
    cameras = [np.array([x, 0.0, 550.0]) for x in (-110.0, 110.0)]
    rig = _rig(
        cameras,
        np.array([-30.0, -40.0, 550.0]),
        camera_size,
        field_mm=330.0,
        projector_focal_px=1500.0,
        volume=_upright(240.0, 300.0),
        name="wide-depth",
    )
    return Preset(name="wide-depth", about="depths of 400 to 700 mm, field 300 mm", rig=rig,
                  period_px=16.0, reduced_bits=4, diameter_mm=240.0, height_mm=300.0,
                  lift_mm=120.0)  # fmt: skip


def face(camera_size: tuple[int, int] = (640, 512)) -> Preset:
    """Return a rig for a face: a field of 500 mm."""
    cameras = [np.array([x, 0.0, 1150.0]) for x in (-190.0, 190.0)]
    rig = _rig(
        cameras,
        np.array([60.0, -90.0, 1150.0]),
        camera_size,
        field_mm=560.0,
        projector_focal_px=1800.0,
        volume=_upright(500.0, 170.0),
        name="face",
    )
    return Preset(name="face", about="a field of 500 mm at 1.15 m", rig=rig,
                  period_px=16.0, reduced_bits=3, diameter_mm=500.0, height_mm=170.0)  # fmt: skip


PRESETS: dict[str, Callable[[tuple[int, int]], Preset]] = {
    "kolibri": kolibri,
    "kolibri-m5": kolibri_m5,
    "designed": designed,
    "wide-depth": wide_depth,
    "face": face,
    "single": single,
}
