"""Imports run one way. The table is the architecture; a new arrow needs a reason here."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent.parent / "src" / "fringe3d"

NOUNS = {"errors", "model"}
ALLOWED: dict[str, set[str]] = {
    "__init__": {"kernels"},
    "kernels": set(),
    "__main__": {"cli"},
    "errors": set(),
    "model": {"errors"},
    "geometry": NOUNS | {"kernels"},
    "patterns": NOUNS,
    "decode": NOUNS | {"kernels", "patterns"},
    "correspond": NOUNS | {"geometry", "kernels", "patterns"},
    "triangulate": NOUNS | {"geometry"},
    # Health judges the stages before it, so it may know their results and the geometry.
    "health": NOUNS | {"geometry", "decode", "kernels", "patterns"},
    # It judges its own fits, in the words of the other checks.
    # A ball that gives the scale is fitted as one of an acceptance test.
    "calibrate": NOUNS | {"evaluate", "geometry", "health", "patterns"},
    "simulate": NOUNS | {"geometry", "patterns"},
    # A sketch says where devices look; several exposures become one stack as they are read.
    "io": NOUNS | {"decode", "geometry", "patterns", "__init__"},
    "design": NOUNS | {"geometry", "patterns"},
    # It knows points on the grid of a camera, neither phases nor how they were measured.
    "register": NOUNS | {"geometry", "kernels"},
    # It judges any cloud, a rival's too: it knows neither rigs nor phases.
    "evaluate": {"errors", "model"},
    # What the user wants, and which method that allows: the design's counts say it beforehand.
    "options": NOUNS,
    "segments": NOUNS | {"design", "geometry"},
    "methods": NOUNS | {"correspond", "decode", "design", "options", "patterns", "segments"},
    # It asks health whether the projector belongs to the cameras before it lets it judge. How many
    # periods C2 sees on a segment is known from the images alone.
    "matching": NOUNS
    | {
        "correspond",
        "decode",
        "design",
        "geometry",
        "health",
        "kernels",
        "options",
        "patterns",
        "segments",
        "triangulate",
    },
    "measurement": NOUNS | {"decode", "health"},
    # Points of cameras and projector: it weighs the noise of phases and places.
    "combining": NOUNS | {"correspond", "geometry", "patterns"},
    "reflections": NOUNS | {"combining", "decode", "triangulate"},
    # What the cameras show, and by which method points are made of it.
    "decoding": NOUNS | {"decode", "health", "kernels", "matching", "methods", "options"},
    "pipeline": NOUNS
    | {
        "combining",
        "reflections",
        "decode",
        "decoding",
        "correspond",
        "health",
        "kernels",
        "matching",
        "measurement",
        "options",
        "devices_moved",
        "segments",
        "triangulate",
    },
    # It looks at the images, then measures as often as the question needs.
    "diagnosis": NOUNS | {"health", "options", "pipeline"},
    # It keeps what depends on the rig in a file.
    "session": NOUNS | {"correspond", "decoding", "io", "options", "pipeline"},
    # What recordings tell of a rig: it decodes and solves as a measurement does.
    "rig_bias": NOUNS | {"correspond", "decode", "matching", "options"},
    # Orders that a moved rig does not tell: it weighs them as a measurement does.
    "pose_search": NOUNS | {"correspond", "decode", "geometry", "matching"},
    "recorded_points": NOUNS | {"calibrate", "correspond", "decode", "geometry", "patterns"},
    "devices_moved": NOUNS | {"calibrate", "decode", "health", "recorded_points"},
    # The poses that recordings show: it decodes and matches as a measurement does.
    "self_calibration": NOUNS
    | {
        "calibrate",
        "decode",
        "matching",
        "methods",
        "options",
        "pose_search",
        "recorded_points",
    },
    # The rig that overlaps of views show: both sides, calibration and registration, at once.
    "rig_from_views": NOUNS | {"calibrate", "geometry", "register"},
    # What scans of a board show: it decodes them and hands the corners' light to the calibration.
    "board_scans": NOUNS | {"calibrate", "decode"},
    # Hardware, or the simulator in its place.
    "devices": NOUNS | {"io", "patterns", "simulate"},
    # It judges frames as health does, and knows from the rig which way fringes must move.
    "acquire": NOUNS | {"devices", "geometry", "health", "patterns"},
    # Cameras, measurement and what they show, all at once.
    "live": NOUNS
    | {
        "acquire",
        "decode",
        "decoding",
        "devices",
        "kernels",
        "patterns",
        "pipeline",
        "session",
    },
    "report": NOUNS
    | {
        "calibrate",
        "decode",
        "design",
        "evaluate",
        "geometry",
        "patterns",
        "health",
        "io",
        "options",
        "pipeline",
        "register",
        "rig_from_views",
        "self_calibration",
        "simulate",
        "__init__",
    },
    "view": NOUNS | {"decode", "geometry", "io", "options", "patterns", "report"},
    # For notebooks: whatever there is to see, in one line.
    "plot": NOUNS | {"geometry", "io", "options", "patterns", "pipeline", "report", "view"},
    "cli": NOUNS
    | {
        "acquire",
        "decode",
        "devices",
        "live",
        "session",
        "correspond",
        "board_scans",
        "calibrate",
        "design",
        "diagnosis",
        "evaluate",
        "geometry",
        "patterns",
        "io",
        "options",
        "rig_bias",
        "rig_from_views",
        "pipeline",
        "register",
        "report",
        "self_calibration",
        "simulate",
        "health",
        "view",
        "__init__",
    },
}

EDGE_LIBRARIES = {
    "cv2": {"io", "simulate"},
    "tifffile": {"io"},
    "tomlkit": {"io"},
    "pydantic": {"io"},
    "matplotlib": {"plot", "report", "view"},
    "viser": {"view"},
    "glfw": {"devices"},
    "moderngl": {"devices"},
    "pypylon": {"devices"},
    "viva_genicam": {"devices"},
    "jinja2": {"report"},
    "markupsafe": {"report"},
    "markdown_it": {"report"},
    "rich": {"cli"},
    "cyclopts": {"cli"},
    "numba": {"kernels", "geometry", "decode", "correspond", "health", "register", "simulate"},
    "open3d": {"register"},
    "pye57": {"io"},
}

FILES = sorted(SOURCE.rglob("*.py"))


def component(path: Path) -> str:
    """Return the top-level module or package that a file belongs to."""
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imports(path: Path) -> Iterator[str]:
    """Yield the full names of all imported modules, wherever they are imported."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert all(alias.name != "*" for alias in node.names), f"{path}: import *"
            if node.module == "fringe3d":
                yield from (f"fringe3d.{alias.name}" for alias in node.names)
            else:
                yield node.module or ""


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_every_import_is_an_arrow_of_the_architecture(path: Path) -> None:
    own = component(path)
    for name in imports(path):
        parts = name.split(".")
        if parts[0] == "fringe3d" and len(parts) > 1:
            target = "__init__" if parts[1].startswith("__") else parts[1]
            assert target == own or target in ALLOWED[own], f"{own} -> {target}"
        elif parts[0] in EDGE_LIBRARIES:
            assert own in EDGE_LIBRARIES[parts[0]], f"{own} -> {parts[0]}"


def test_the_table_has_no_cycle() -> None:
    order: list[str] = []
    while len(order) < len(ALLOWED):
        ready = [name for name in ALLOWED if name not in order and ALLOWED[name] <= set(order)]
        assert ready, f"cycle among {set(ALLOWED) - set(order)}"
        order += ready


def test_estimator_and_simulator_are_strangers() -> None:
    estimator = {"decode", "decoding", "correspond", "matching", "methods", "triangulate",
                 "health", "pipeline"}  # fmt: skip
    assert all("simulate" not in ALLOWED[name] for name in estimator)
    assert not ALLOWED["simulate"] & estimator


def test_private_modules_stay_inside_their_package() -> None:
    # The kernels evaluate the lens model at every step and cannot call back into Python.
    shared = {
        (f"correspond/{name}.py", "fringe3d.geometry._lens")
        for name in ("_curves", "_direct", "_near", "_search")
    }
    for path in FILES:
        for name in imports(path):
            if any(part.startswith("_") and not part.startswith("__") for part in name.split(".")):
                relative = path.relative_to(SOURCE).as_posix()
                same_package = name.split(".")[1] == component(path)
                assert same_package or (relative, name) in shared, f"{relative}: {name}"
