"""The rig: cameras, projector and measuring volume in one world frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fringe3d.model.bias import CalibrationBias
from fringe3d.model.covariance import RigCovariance
from fringe3d.model.device import Device
from fringe3d.model.html import table
from fringe3d.model.volume import MeasuringVolume


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig:
    """Calibrated devices and the volume in which they measure.

    Parameters
    ----------
    cameras : tuple of Device, at least one; the first is C1, the reference
    projector : Device or None (a stereo rig whose projector nobody calibrated)
    volume : MeasuringVolume or None (unbounded)
    provenance : str; where the calibration comes from
    bias : CalibrationBias or None; what is known of the calibration's error, of exactly these
        devices
    covariance : RigCovariance or None; how certain the numbers of exactly these devices are
    """

    cameras: tuple[Device, ...]
    projector: Device | None = None
    volume: MeasuringVolume | None = None
    provenance: str = ""
    bias: CalibrationBias | None = None
    covariance: RigCovariance | None = None

    def __post_init__(self) -> None:
        if not self.cameras:
            raise ValueError("rig: expected at least one device with role 'camera', found none")
        for camera in self.cameras:
            if camera.role != "camera":
                raise ValueError(f"rig: '{camera.name}' stands as camera but is a projector")
        names = [device.name for device in self.devices]
        if len(set(names)) < len(names):
            raise ValueError(f"rig: expected a different name for each device, found {names}")
        known = (
            {name.rpartition(".")[0] for name in self.covariance.names}
            if self.covariance
            else set()
        )
        if not known <= set(names):
            raise ValueError(f"rig: covariance: expected devices of {names}, found {sorted(known)}")
        if self.projector is not None and self.projector.role != "projector":
            raise ValueError(f"rig: '{self.projector.name}' stands as projector but is a camera")

    @property
    def devices(self) -> tuple[Device, ...]:
        """Return the cameras and, if there is one, the projector."""
        return (*self.cameras, *((self.projector,) if self.projector else ()))

    def with_devices(self, devices: Sequence[Device], /) -> Rig:
        """Return the rig with devices in place of those of their names.

        Bias and covariance belonged to the former devices, and are left out.
        """
        named = {device.name: device for device in devices}
        projector = self.projector
        return replace(
            self,
            cameras=tuple(named.get(camera.name, camera) for camera in self.cameras),
            projector=named.get(projector.name, projector) if projector is not None else None,
            bias=None,
            covariance=None,
        )

    def _repr_html_(self) -> str:
        first = self.cameras[0].center_world
        rows = [
            (
                device.name,
                f"{device.role}, {device.n_cols} x {device.n_rows} px, focal length "
                f"{device.focal_px.mean():.1f} px; centre of projection "
                f"{np.linalg.norm(device.center_world - first):.1f} mm from that of C1",
            )
            for device in self.devices
        ]
        known = [name for name in ("volume", "covariance", "bias") if getattr(self, name)]
        rows.append(("known", ", ".join(known) or "devices alone"))
        return table("rig", [*rows, ("provenance", self.provenance or "unknown")])
