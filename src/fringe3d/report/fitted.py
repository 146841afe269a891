"""A surface fitted to a cloud: its numbers and how certain they are, form, a coloured map."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringe3d.evaluate import Cone, Deviations, Fit, Plane, Sphere, fit_covariance
from fringe3d.io.atomic import new_folder
from fringe3d.io.clouds import CloudFile
from fringe3d.io.results import write_coloured_ply
from fringe3d.report.deviations import draw_deviations
from fringe3d.report.maps import deviation_colours

Surface = Plane | Sphere | Cone
Floats = NDArray[np.float64]

HELD_BY_SCALE = 0.98


def fit_record(cloud: CloudFile, fit: Fit[Any], /) -> dict[str, Any]:
    """Return the numbers of a fitted surface, their standard deviations, and the figures of form.

    Standard deviations follow from the sigma of the points, where the cloud knows it, else from
    their scatter about the surface.

    Parameters
    ----------
    cloud : CloudFile; the points of the fit
    fit : Fit of a Plane, Sphere, Cylinder or Cone to them
    """
    sigma, source = _sigma_of_distances(cloud, fit)
    covariance = fit_covariance(cloud.points_mm, fit, sigma_mm=sigma)
    std = np.sqrt(np.diagonal(covariance))
    return {
        **_numbers(fit.surface, std),
        "points": fit.n_used,
        "left_out": fit.n_rejected,
        "sigma_mm": fit.sigma_mm,
        "form_mm": fit.form_mm,
        "form95_mm": fit.form95_mm,
        "sigma_from": source,
        "covariance": covariance.tolist(),
    }


def _sigma_of_distances(cloud: CloudFile, fit: Fit[Any]) -> tuple[Floats, str]:
    noise = cloud.noise_mm
    if noise is None:
        scatter = np.full(len(cloud.points_mm), fit.sigma_mm)
        return scatter, "the scatter of the points about the surface"
    ends = [fit.surface.distances(cloud.points_mm + way * noise) for way in (0.5, -0.5)]
    return np.abs(ends[0] - ends[1]), "sigma of the points"


def _numbers(surface: Surface, std: Floats) -> dict[str, Any]:
    """Return what describes a surface, with standard deviations named `..._std`."""
    if isinstance(surface, Plane):
        return {
            "surface": "plane",
            "center_mm": surface.center_mm.tolist(),
            "normal": surface.normal.tolist(),
            "turn_std_deg": np.degrees(std[:2]).tolist(),
            "height_std_mm": float(std[2]),
        }
    if isinstance(surface, Sphere):
        return {
            "surface": "sphere",
            "center_mm": surface.center_mm.tolist(),
            "center_std_mm": std[:3].tolist(),
            "diameter_mm": 2 * surface.radius_mm,
            "diameter_std_mm": float(2 * std[3]),
        }
    found = {
        "surface": "cylinder" if surface.is_cylinder else "cone",
        "point_mm": surface.point_mm.tolist(),
        "shift_std_mm": std[2:4].tolist(),
        "axis": surface.axis.tolist(),
        "turn_std_deg": np.degrees(std[:2]).tolist(),
        "diameter_mm": 2 * surface.radius_mm,
        "diameter_std_mm": float(2 * std[4]),
    }
    if not surface.is_cylinder:
        found["half_angle_deg"] = float(np.degrees(surface.half_angle))
        found["half_angle_std_deg"] = float(np.degrees(std[5]))
    return found


def fit_text(record: dict[str, Any], /) -> str:
    """Return the fit in a few lines, with units."""
    lines = [
        f"{record['surface']} through {record['points']:,} points ({record['left_out']:,} left "
        f"out): sigma {1000 * record['sigma_mm']:.2f} um, form {1000 * record['form_mm']:.1f} um, "
        f"of 95 % {1000 * record['form95_mm']:.1f} um"
    ]
    for key, word in (("center_mm", "centre"), ("point_mm", "a point of the axis")):
        if key in record:
            lines.append(f"{word} ({_listed(record[key])}) mm{_apart(record, key)}")
    if "normal" in record:
        lines.append(f"normal ({_listed(record['normal'])}), turned by {_turns(record)} deg (sigma)"
                     f"; height sigma {1000 * record['height_std_mm']:.3f} um")  # fmt: skip
    if "axis" in record:
        lines.append(f"axis ({_listed(record['axis'])}), turned by {_turns(record)} deg (sigma)")
    if "diameter_mm" in record:
        where = " at that point" if record["surface"] == "cone" else ""
        lines.append(f"diameter{where} {record['diameter_mm']:.4f} mm, sigma "
                     f"{1000 * record['diameter_std_mm']:.3f} um")  # fmt: skip
    if "half_angle_deg" in record:
        lines.append(f"half angle {record['half_angle_deg']:.4f} deg, sigma "
                     f"{record['half_angle_std_deg']:.5f} deg")  # fmt: skip
    return "\n".join([*lines, f"sigma of these from {record['sigma_from']}, as if the noise of "
                      "neighbours were independent"])  # fmt: skip


def _listed(numbers: list[float]) -> str:
    return ", ".join(f"{round(number, 4) + 0.0:.4f}" for number in numbers)  # no -0


def _turns(record: dict[str, Any]) -> str:
    return " and ".join(f"{turn:.5f}" for turn in record["turn_std_deg"])


def _apart(record: dict[str, Any], key: str) -> str:
    """Return the standard deviations that belong to a place, where it has them."""
    std = record.get({"center_mm": "center_std_mm", "point_mm": "shift_std_mm"}[key])
    if std is None:
        return ""
    across = " across the axis" if key == "point_mm" else ""
    return f", sigma ({', '.join(f'{1000 * one:.3f}' for one in std)}) um{across}"


def write_fit(
    out: Path,
    points_mm: Floats,
    viewpoint_mm: Floats,
    fit: Fit[Any],
    record: dict[str, Any],
    command: str,
    /,
    *,
    overwrite: bool = False,
) -> None:
    """Write ``fit.md``, ``fit.json``, ``overview.png`` and ``deviations.ply``.

    Parameters
    ----------
    out : folder to make
    points_mm : (n, 3) float, mm; of the fit
    viewpoint_mm : (3,) float, mm; from where the map is seen
    fit : Fit
    record : what `fit_record` says of it
    command : what the user typed
    overwrite : bool; replace a folder that is there
    """
    signed = np.where(fit.is_used, fit.distances_mm, np.nan)
    deviations = Deviations(signed_mm=signed, reach_mm=float("inf"), covered=float("nan"))
    limit = max(deviations.quantile_mm(HELD_BY_SCALE), 1e-9)
    text = fit_text(record)
    with new_folder(out, overwrite=overwrite) as folder:
        (folder / "fit.md").write_text(
            f"# {record['surface']}\n\n```\n{text}\n```\n\n![deviations](overview.png)\n\n"
            "Least squares, all points weighed alike; deviations are square to the surface. "
            f"Points left out are grey in `deviations.ply`.\n\n`{command}`\n",
            encoding="utf-8",
        )
        (folder / "fit.json").write_text(json.dumps(record, indent=1) + "\n", "utf-8")
        draw_deviations(folder / "overview.png", points_mm, viewpoint_mm, deviations,
                        limit_mm=limit, title=text.replace("\n", "; "))  # fmt: skip
        write_coloured_ply(
            folder / "deviations.ply", points_mm, deviation_colours(signed, limit),
            viewpoint_mm=viewpoint_mm, deviation_mm=fit.distances_mm,
        )  # fmt: skip
