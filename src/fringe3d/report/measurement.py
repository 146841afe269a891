"""The report of a measurement: one page that needs nothing else."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fringe3d.io.stored import StoredResult
from fringe3d.model import Device
from fringe3d.report.advice import LEAST_PART, reason_rows
from fringe3d.report.cloud_data import CERTAIN, channels_of_result, packed_cloud
from fringe3d.report.maps import Drawer, Window, colour_map, reasons, relief, window_of
from fringe3d.report.pages import page

MOST_POINTS = 150_000
"""Points of the small 3D view: 1.8 MB of the page."""

PICTURE_INCHES, PICTURE_DPI = 7.0, 110


def report_html(stored: StoredResult, /, *, most_points: int = MOST_POINTS) -> str:
    """Return the report of a measurement as one HTML page without links to anything outside.

    Parameters
    ----------
    stored : StoredResult
    most_points : int; of the small 3D view
    """
    rows = reason_rows(stored.rejection)
    return page(
        "measurement.html",
        title=stored.record.get("title") or stored.folder.name,
        record=stored.record,
        figures=_figures(stored),
        rows=rows,
        advice=[row for row in rows if row.part >= LEAST_PART],
        pictures=_pictures(stored),
        cloud=_cloud_of(stored, most_points),
    )


def cloud_html(stored: StoredResult, /, *, most_points: int) -> str:
    """Return a page that holds the 3D view of a result and nothing else; see `report_html`."""
    title = stored.record.get("title") or stored.folder.name
    return page("cloud.html", title=title, cloud=_cloud_of(stored, most_points))


def cloud_page(
    maps: dict[str, NDArray[Any]], camera: Device | None, /, *, title: str, most_points: int
) -> str:
    """Return a page that holds a 3D view and nothing else.

    Parameters
    ----------
    maps : dict; those of ``points.npz``
    camera : Device or None; from which side one looks at first
    title : str
    most_points : int
    """
    cloud = packed_cloud(maps, camera, most=most_points) if _has_points(maps) else None
    return page("cloud.html", title=title, cloud=cloud)


def _cloud_of(stored: StoredResult, most_points: int) -> dict[str, Any] | None:
    if not _has_points(stored.maps):
        return None
    camera = stored.rig.cameras[0] if stored.rig is not None else None
    channels = channels_of_result(stored)
    return packed_cloud(stored.maps, camera, most=most_points, channels=channels)


def _has_points(maps: dict[str, NDArray[Any]]) -> bool:
    return bool((maps["rejection"] == 0).any())


def _figures(stored: StoredResult) -> list[tuple[str, str]]:
    """Return what is to be said in numbers, with units: names and values."""
    maps, total = stored.maps, stored.rejection.size
    good = stored.rejection == 0
    figures = [("points", f"{good.sum():,} of {total:,} pixels ({good.mean():.1%})")]
    if not good.any():
        return figures
    low, high = np.percentile(maps["points_mm"][good], [0, 100], axis=0)
    for axis, name in enumerate("xyz"):
        figures.append((name, f"{low[axis]:.2f} to {high[axis]:.2f} mm"))
    sigma = np.percentile(1000 * maps["sigma_mm"][good], [50, 95])
    figures.append(("sigma along the viewing ray", f"median {sigma[0]:.1f} um, "
                    f"95 % below {sigma[1]:.1f} um"))  # fmt: skip
    skew = float(np.median(1000 * maps["skew_mm"][good]))
    if skew > 0.05:  # points searched on the curve have none
        figures.append(("distance of the two rays", f"median {skew:.1f} um"))
    probability = maps["order_probability"][good]
    doubtful = (probability < CERTAIN).mean()
    figures.append(("order probability", f"least {probability.min():.3f}; {doubtful:.2%} of the "
                    f"points below {CERTAIN}"))  # fmt: skip
    return figures


def _pictures(stored: StoredResult) -> list[tuple[str, str]]:
    """Return the pictures, as captions and data addresses."""
    maps = stored.maps
    good = stored.rejection == 0
    window = window_of(np.isfinite(maps["offset"]) & (good if good.any() else True))
    sigma = colour_map("sigma along the viewing ray, um", 1000 * maps["sigma_mm"], "viridis")
    drawn: list[tuple[str, Drawer]] = [
        ("Depth", relief("depth z, mm (shaded)", maps["points_mm"][..., 2])),
        ("Uncertainty", sigma),
        ("Rejected pixels", reasons(stored.rejection)),
        ("Image", colour_map("mean brightness of C1, DN", maps["offset"], "gray")),
        ("Fringe contrast", colour_map("modulation, DN", maps["modulation"], "magma")),
    ]
    saturated = maps.get("saturated_images", np.zeros(1))
    if saturated.any():
        shown = np.where(saturated > 0, saturated, np.nan)  # a single one stays seen
        drawn.append(("Saturation", colour_map("saturated fringe images", shown, "autumn_r")))
    if "exposure" in maps:
        drawn.append(("Exposure", _exposure_map(maps["exposure"])))
    probability = maps["order_probability"]
    if np.nanmin(probability, initial=1.0) < CERTAIN:
        drawn.append(("Order probability", colour_map("of the fringe order", probability, "plasma",
                                                       limits=(0.9, 1.0))))  # fmt: skip
    if "epipolar_residual_px" in maps:
        residual = maps["epipolar_residual_px"]
        drawn.append(("Epipolar residual", colour_map("px", residual, "RdBu_r")))
    return [(caption, _picture(draw, window)) for caption, draw in drawn]


def _exposure_map(exposure: NDArray[Any]) -> Drawer:
    """Draw from which exposure each pixel comes: steps of equal size, whatever their amounts."""
    amounts, number = np.unique(exposure, return_inverse=True)
    ticks = {float(i): f"{amount:g}" for i, amount in enumerate(amounts)}
    number = number.reshape(exposure.shape).astype(np.float32)
    return colour_map("exposure that the pixel comes from", number, "cividis",
                      limits=(-0.5, len(amounts) - 0.5), ticks=ticks)  # fmt: skip


def _picture(draw: Drawer, window: Window) -> str:
    height, width = (s.stop - s.start for s in window)
    aspect = float(np.clip(height / width, 0.4, 1.5))
    size = (PICTURE_INCHES, PICTURE_INCHES * aspect * 0.9 + 0.8)
    figure = Figure(figsize=size, dpi=PICTURE_DPI, layout="constrained")
    axis = figure.subplots()
    draw(axis, window)
    axis.set_facecolor("#101216")
    axis.tick_params(labelsize=8)
    target = io.BytesIO()
    figure.savefig(target, format="png")
    return "data:image/png;base64," + base64.b64encode(target.getvalue()).decode("ascii")
