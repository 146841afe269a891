"""Cast rays once: stages of the simulator from the cache on disk."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from fringe3d import geometry, simulate
from fringe3d.io.cache import cached, key_of
from fringe3d.io.rigfile import rig_text
from fringe3d.model import Rig
from fringe3d.simulate import Scene, Setup, Stage, Truth, prepare
from fringe3d.simulate.bounce import Bounce
from fringe3d.simulate.footprint import Footprint
from fringe3d.simulate.render import Progress

Arrays = dict[str, NDArray[Any]]


def prepare_cached(rig: Rig, scene: Scene, setup: Setup, /, *, progress: Progress) -> Stage:
    """Return what `prepare` returns; from an earlier run with the same rig, scene and optics."""
    stage: Stage | None = None

    def make() -> Arrays:
        nonlocal stage
        stage = prepare(rig, scene, setup, progress=progress)
        return _flat(stage)

    arrays = cached(_key(rig, scene, setup), make)
    return stage if stage is not None else _stage(arrays, rig, scene, setup)


def _key(rig: Rig, scene: Scene, setup: Setup) -> str:
    meshes = [mesh for mesh in (scene.thing, scene.surroundings) if mesh is not None]
    arrays = [getattr(m, f.name) for m in meshes for f in dataclasses.fields(m)]
    pose = scene.world_from_object
    # Rays and light paths do not depend on the sensor, nor on what happens from image to image.
    lens = {f: getattr(setup.camera, f) for f in ("aperture_mm", "focus_mm", "vignetting")}
    light = {
        f: getattr(setup.projector, f) for f in ("aperture_mm", "focus_mm", "vignetting", "blur_px")
    }
    return key_of(
        [
            rig_text(rig),
            *(a for a in arrays if a is not None),
            pose.rotation,
            pose.translation,
            repr((scene.surface, scene.background, lens, light, setup.n_rays)),
            repr(setup.recording.interreflection),
            *_sources(),
        ]
    )


def _sources() -> list[bytes]:
    """Return the code that casts the rays: another code, another stage."""
    folders = (Path(package.__file__ or "").parent for package in (simulate, geometry))
    return [file.read_bytes() for folder in folders for file in sorted(folder.glob("*.py"))]


def _flat(stage: Stage) -> Arrays:
    arrays: Arrays = {}
    for number, camera in enumerate(stage.rig.cameras):
        for kind in ("truths", "paths", "bounces"):
            item = getattr(stage, kind)[number]
            for f in dataclasses.fields(item) if item is not None else ():
                value = getattr(item, f.name)
                for name, array in value.items() if isinstance(value, dict) else [("", value)]:
                    if not isinstance(array, str):
                        arrays[f"{camera.name}/{kind}/{f.name}/{name}"] = array
    return arrays


def _stage(arrays: Arrays, rig: Rig, scene: Scene, setup: Setup) -> Stage:
    parts: dict[str, dict[str, dict[str, Any]]] = {}
    for key, array in arrays.items():
        camera, kind, field, name = key.split("/")
        item = parts.setdefault(camera, {}).setdefault(kind, {})
        if name:
            item.setdefault(field, {})[name] = array
        else:
            item[field] = array
    of = [parts[camera.name] for camera in rig.cameras]
    none: dict[str, Any] = {"pixels": {}, "seen_by": {}}
    return Stage(
        rig,
        scene,
        setup,
        tuple(
            Truth(**(none | p["truths"]), device_name=camera.name)
            for p, camera in zip(of, rig.cameras, strict=True)
        ),
        tuple(Footprint(**p["paths"]) for p in of),
        tuple(Bounce(**p["bounces"]) if "bounces" in p else None for p in of),
    )
