"""The doctor names what was done to a recording, and nothing where nothing was.

The recording is rendered in closed form; what is done to it are plain changes of its images or of
its description. How often faults are named on other scenes, `benchmarks/doctor.py` counts.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from changed_rigs import turned
from closed_form import Recording, SphereScene, record_scene
from fringe3d.cli import main
from fringe3d.decode import fuse
from fringe3d.diagnosis import diagnose
from fringe3d.errors import EmptyResultError
from fringe3d.health import Finding, check_exposure, check_sequence, light_of, lit_map, steps_of
from fringe3d.health.steadiness import displacement_px
from fringe3d.io.images import read_image
from fringe3d.io.scanfolder import write_scan
from fringe3d.model import (
    Fringe,
    GrayBit,
    ImageStack,
    MeasuringVolume,
    Pattern,
    Rejection,
    Rig,
    Scan,
)
from fringe3d.pipeline import Measurement, measure

SEED = 20261201

Change = Callable[[ImageStack], ImageStack]


@pytest.fixture(scope="module")
def alone(rig: Rig) -> Scan:
    """Return what C1 records of a sphere: four steps, seven Gray images, light and dark."""
    one = replace(rig, cameras=rig.cameras[:1])
    return record_scene(one, SphereScene(), seed=SEED, light_dark=True)[0]


def spoilt(scan: Scan, change: Change) -> Scan:
    return replace(scan, stacks=tuple(change(stack) for stack in scan.stacks))


def in_order(*places: int) -> Change:
    return lambda stack: replace(stack, images=stack.images[list(places)])


def described(change: Callable[[Pattern], Pattern]) -> Change:
    return lambda stack: replace(
        stack, plan=replace(stack.plan, patterns=tuple(change(p) for p in stack.plan.patterns))
    )


def fringes(**changes: Callable[[float], float]) -> Change:
    def change(pattern: Pattern) -> Pattern:
        if not isinstance(pattern, Fringe):
            return pattern
        return replace(pattern, **{key: f(getattr(pattern, key)) for key, f in changes.items()})

    return described(change)


def grey(change: Callable[[int, np.ndarray], np.ndarray]) -> Change:
    def changed(stack: ImageStack) -> ImageStack:
        images = [change(i, image.astype(np.float64)) for i, image in enumerate(stack.images)]
        return replace(stack, images=np.clip(np.rint(images), 0, 255).astype(np.uint8))

    return changed


def bits(change: Callable[[GrayBit], GrayBit]) -> Change:
    return described(lambda p: change(p) if isinstance(p, GrayBit) else p)


SPOILT: dict[str, tuple[Change, str]] = {
    "an image is lost": (in_order(0, 1, 2, 4, 5, 6, 7, 8, 9, 10, 11, 12, 12), "missing-image"),
    "a step is shown twice": (in_order(0, 1, 1, *range(3, 13)), "repeated-image"),
    "a bit is shown twice": (in_order(*range(8), 7, *range(9, 13)), "repeated-image"),
    "all come one late": (in_order(0, 1, 2, 3, 4, 4, *range(5, 12)), "repeated-image"),
    "steps exchanged": (in_order(1, 0, *range(2, 13)), "exchanged-images"),
    "step and bit exchanged": (in_order(0, 1, 2, 6, 4, 5, 3, *range(7, 13)), "exchanged-images"),
    "coarse bits exchanged": (in_order(0, 1, 2, 3, 5, 4, *range(6, 13)), "exchanged-images"),
    "the shift reversed": (fringes(shift=lambda d: -d), "shift-direction"),
    "a wrong period": (fringes(period_px=lambda p: 1.1 * p), "wrong-period"),
    "inverse bits": (bits(lambda p: replace(p, inverted=True)), "gray-polarity"),
    "bits from the finest": (bits(lambda p: replace(p, bit=p.n_bits - 1 - p.bit)),
                             "gray-bit-order"),
    "a lamp that flickers": (grey(lambda i, g: g * (1 + 0.03 * (i == 2))), "flicker"),
    "a gamma of the camera": (grey(lambda _, g: 255 * (g / 255) ** 0.5), "gamma"),
    "a shaking camera": (grey(lambda i, g: ndimage.shift(g, (0, 0.4 * (i == 1)), mode="nearest")),
                         "movement"),
    "a moving object": (grey(lambda i, g: np.roll(g, i >= 4, axis=0)), "movement"),
    "no focus": (grey(lambda _, g: ndimage.gaussian_filter(g, 1.5)), "defocus"),
    "too much light": (grey(lambda _, g: 2.5 * g), "saturation"),
    "too little light": (grey(lambda _, g: 0.12 * g), "too-dark"),
}  # fmt: skip


@pytest.mark.parametrize("name", SPOILT)
def test_a_fault_of_the_images_is_named(alone: Scan, name: str) -> None:
    """At least 13 kinds; and nothing else but what follows from it."""
    change, expected = SPOILT[name]
    found = diagnose(spoilt(replace(alone, rig=None), change))
    assert expected in [kind.value for kind in found.kinds]
    fault = next(f for f in found.faults if f.kind.value == expected)
    assert fault.camera == "c1"
    assert fault.cure
    assert np.isfinite([fault.value, fault.limit]).all()
    assert len(found.kinds) <= 2


def test_an_exchange_says_which_images(alone: Scan) -> None:
    change, _ = SPOILT["step and bit exchanged"]
    stack = change(alone.stacks[0])
    (fault,) = check_sequence(stack, lit_map(stack))
    assert fault.images == (3, 6)
    assert "step of 270 degrees" in fault.text


def test_a_period_is_measured_beside_the_code(alone: Scan) -> None:
    """Within 1 %: over the 60 periods of the view that is well below one of them."""
    change, _ = SPOILT["a wrong period"]
    stack = change(alone.stacks[0])
    (fault,) = check_sequence(stack, lit_map(stack))
    assert float(fault.text.split("about ")[1].split(" px")[0]) == pytest.approx(16.0, rel=0.01)


@pytest.mark.parametrize("gamma", [1.4, 2.2])
def test_harmonic_and_mean_are_those_of_the_gamma(rig: Rig, gamma: float) -> None:
    """In closed form, ((1 + cos x) / 2)**g has the mean ``Gamma(g + 1/2) / sqrt(pi) Gamma(g + 1)``
    and the second harmonic over the first ``(g - 1) / (g + 2)``."""
    one = replace(rig, cameras=rig.cameras[:1])
    scan = record_scene(one, SphereScene(gamma=gamma), seed=SEED, light_dark=True)[0]
    stack = scan.stacks[0]
    lit = lit_map(stack)
    steps, light = steps_of(stack, lit, stack.plan.fringe_sets[0]), light_of(stack, lit)
    assert steps is not None
    assert light is not None
    # 8 bits and noise of 1 %, 8,000 pixels.
    assert steps.second_harmonic == pytest.approx((gamma - 1) / (gamma + 2), abs=0.005)
    mean = math.gamma(gamma + 0.5) / math.gamma(gamma + 1) / math.sqrt(math.pi)
    assert light.middle == pytest.approx(mean, abs=0.005)


@pytest.mark.parametrize("flicker", [0.01, 0.04])
def test_flicker_is_what_it_was(alone: Scan, flicker: float) -> None:
    """One of four images brighter by f: by 3/4 f over the mean of all, to first order and up to a
    third too small."""
    stack = grey(lambda i, g: g * (1 + flicker * (i == 2)))(alone.stacks[0])
    steps = steps_of(stack, lit_map(stack), stack.plan.fringe_sets[0])
    assert steps is not None
    assert steps.flicker == pytest.approx(0.75 * flicker, abs=0.002 + 0.2 * flicker)


def test_a_sound_recording_has_no_fault(recording: Recording, alone: Scan) -> None:
    assert diagnose(alone).faults == ()
    assert diagnose(recording[0]).faults == ()


def test_a_reduced_code_without_the_size_of_the_projector_has_no_fault(rig: Rig) -> None:
    """It comes back every eight periods, which only the projector's size would tell beforehand."""
    one = replace(rig, cameras=rig.cameras[:1])
    scan, _ = record_scene(one, SphereScene(), seed=SEED, light_dark=True, gray_bits=3)
    (stack,) = scan.stacks
    unknown = replace(stack, plan=replace(stack.plan, projector_shape=None))
    assert check_sequence(unknown, lit_map(unknown)) == []


def test_a_wrong_calibration_is_told_from_exchanged_cameras(recording: Recording) -> None:
    scan, _ = recording
    assert scan.rig is not None
    c1, c2 = scan.rig.cameras
    rig = replace(scan.rig, cameras=(c1, turned(c2, "x", 2.0)))
    assert [k.value for k in diagnose(replace(scan, rig=rig)).kinds] == ["wrong-calibration"]
    first, second = scan.stacks
    names = replace(first, device_name="c2"), replace(second, device_name="c1")
    exchanged = replace(scan, stacks=names[::-1])
    assert [k.value for k in diagnose(exchanged).kinds] == ["cameras-exchanged"]


@pytest.mark.parametrize(("part", "kinds"), [(0.5, []), (1.2, ["cameras-exchanged"])])
def test_cameras_are_exchanged_only_where_that_finds_more(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, part: float, kinds: list[str]
) -> None:
    """Most pixels see a table outside the volume; `part` of the points are found exchanged."""
    scan, _ = recording
    assert scan.rig is not None
    whole = measure(scan)
    assert whole.points is not None
    places = np.argwhere(whole.points.is_valid)
    lost = Finding("warning", "lost_part", 0.85, "85 % of the pixels have no possible point")

    def found(shown: Scan, _: object = None) -> Measurement:
        assert shown.rig is not None
        assert whole.points is not None
        if shown.rig.volume is None:
            raise EmptyResultError("nothing without the volume")
        is_described = shown.stacks[0].images is scan.stacks[0].images
        left_out = places[int(0.5 * (1 if is_described else part) * len(places)) :]
        rejection = whole.points.rejection.copy()
        points = whole.points.points_mm.copy()
        rejection[tuple(left_out.T)], points[tuple(left_out.T)] = Rejection.NO_MATCH, np.nan
        kept = replace(whole.points, points_mm=points, rejection=rejection)
        other = [f for f in whole.findings if f.name != "lost_part"]
        return replace(whole, points=kept, findings=(*other, *([lost] if is_described else [])))

    monkeypatch.setattr("fringe3d.diagnosis.measure", found)
    assert [k.value for k in diagnose(scan).kinds] == kinds


def test_an_object_outside_the_volume_is_told(recording: Recording) -> None:
    scan, _ = recording
    assert scan.rig is not None
    high = MeasuringVolume.box([-45, -45, 40], [45, 45, 70])
    (fault,) = diagnose(replace(scan, rig=replace(scan.rig, volume=high))).faults
    assert fault.kind.value == "outside-volume"
    assert fault.value == 0


def test_the_command_says_what_helps_and_draws_it(
    alone: Scan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scan(tmp_path / "sound", alone)
    main(["doctor", str(tmp_path / "sound")])
    assert "nothing wrong was found" in capsys.readouterr().out
    folder, picture = tmp_path / "spoilt", tmp_path / "new" / "spoilt.png"
    write_scan(folder, spoilt(alone, SPOILT["steps exchanged"][0]))
    with pytest.raises(SystemExit) as stopped:
        main(["doctor", str(folder), "--out", str(picture)])
    assert stopped.value.code == 1
    said = capsys.readouterr().out
    assert "exchanged-images: camera 'c1': images 0 (step of 0 degrees) and 1" in said
    assert "what helps: put the sequence" in said
    assert read_image(picture).shape[0] > 100
    (folder / "c1" / "005.png").unlink()
    with pytest.raises(SystemExit) as stopped:
        main(["doctor", str(folder), "--json"])
    assert stopped.value.code == 1
    (fault,) = json.loads(capsys.readouterr().out)["faults"]
    assert fault["fault"] == "missing-files"
    assert "index 5 is missing" in fault["text"]


def lit_by(light: np.ndarray, _index: int, image: np.ndarray) -> np.ndarray:
    return np.asarray(image * light)


@pytest.mark.parametrize("name", [None, "a lamp that flickers", "a gamma of the camera"])
def test_a_series_of_exposures_is_judged_as_one(rig: Rig, name: str | None) -> None:
    """Reflectance of 3 to 100 %, four exposures: every part is lit in one of them, and a fault
    that all exposures share is named."""
    one = replace(rig, cameras=rig.cameras[:1])
    scan = record_scene(one, SphereScene(), seed=SEED, light_dark=True)[0]
    stack = scan.stacks[0]
    share = np.geomspace(0.03, 1, stack.shape[1])
    change = SPOILT[name][0] if name else lambda stack: stack
    exposures = [1.0, 3.0, 9.0, 27.0]
    stacks = [change(grey(partial(lit_by, share * exposure))(stack)) for exposure in exposures]
    fused = fuse(stacks, exposures)
    lit = lit_map(fused).lit
    # Where the scene is lit at all: the darkest columns as much as the brightest.
    plain = lit_map(stack).lit
    assert lit[plain].mean() > 0.9
    expected = {None: [], "a lamp that flickers": ["flicker"], "a gamma of the camera": ["gamma"]}
    found = [k.value for k in diagnose(Scan(stacks=(fused,))).kinds]
    assert found == expected[name]


def test_other_light_is_no_movement_and_movement_of_a_small_part_is(alone: Scan) -> None:
    """Other light shades the surface otherwise than the projector does; the dark image shows it.
    A part that moves by 0.5 px is told though all else stands still."""
    (stack,) = alone.stacks
    rows = np.linspace(0, 1, stack.shape[0])[:, None]
    other = 12 * np.sin(rows * 20) ** 2
    lit = grey(lambda _, g: np.minimum(g * 0.8 + other, 254))(stack)
    assert displacement_px(lit, lit_map(lit)) == 0
    part = np.zeros(stack.shape, bool)
    part[80:180, 100:200] = True

    def move(index: int, image: np.ndarray) -> np.ndarray:
        moved = ndimage.shift(image, (0.0, 0.5), mode="nearest")
        return np.where(part & (index >= 4), moved, image)

    moved = grey(move)(lit)
    assert displacement_px(moved, lit_map(moved)) == pytest.approx(0.5, abs=0.15)


def test_a_small_bright_object_may_be_saturated_before_a_large_table(alone: Scan) -> None:
    """One percent of the lit pixels in one piece is a loss; the same scattered are glints."""
    (stack,) = alone.stacks
    lit = np.argwhere(lit_map(stack).lit)
    rng = np.random.default_rng(SEED)
    middle = lit[len(lit) // 2]
    patch = lit[np.argsort(np.abs(lit - middle).max(axis=1))[: len(lit) // 100]]
    glints = lit[rng.choice(len(lit), len(lit) // 100, replace=False)]
    for places, kinds in ((patch, ["saturation"]), (glints, [])):
        images = stack.images.copy()
        images[:, places[:, 0], places[:, 1]] = 255
        found = check_exposure(replace(stack, images=images), lit_map(stack))
        assert [fault.kind.value for fault in found] == kinds


def test_a_table_outside_the_volume_accuses_nothing(recording: Recording) -> None:
    """Of a volume that holds only the upper part of the sphere, nine pixels of ten see nothing."""
    scan, _ = recording
    assert scan.rig is not None
    low = MeasuringVolume.box([-45, -45, 7], [45, 45, 70])
    found = diagnose(replace(scan, rig=replace(scan.rig, volume=low)))
    assert next(f.value for f in found.findings if f.name == "lost_part") > 0.8
    assert found.faults == ()
