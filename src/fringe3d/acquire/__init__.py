"""Record plans: show, wait, trigger, check every frame."""

from fringe3d.acquire.exposing import with_best_exposure
from fringe3d.acquire.latency import measure_latency
from fringe3d.acquire.opening import opened
from fringe3d.acquire.recorder import Mended, Recorded, record
from fringe3d.acquire.shooting import Devices, Shot, Trouble, shoot

__all__ = [
    "Devices",
    "Mended",
    "Recorded",
    "Shot",
    "Trouble",
    "measure_latency",
    "opened",
    "record",
    "shoot",
    "with_best_exposure",
]
