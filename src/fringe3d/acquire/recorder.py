"""A plan recorded by all cameras, with every frame checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fringe3d.acquire.checks import Reference, check_content, largest_change, reference_of
from fringe3d.acquire.direction import goes_backwards
from fringe3d.acquire.shooting import Devices, Shot, Trouble, shoot
from fringe3d.devices import Frame, Grey
from fringe3d.errors import DeviceError
from fringe3d.health import Fault, Kind, check_sequence, lit_map
from fringe3d.model import Fringe, GrayBit, ImageStack, Pattern, PatternPlan, Rig
from fringe3d.patterns import pattern_image

Progress = Callable[[str, int, int], None]

MOST_TRIES = 4
"""Times that one pattern is taken; each waits longer than the one before."""

LONGER_S = 0.1
"""What each further try waits beyond the one before, s."""

MOST_SATURATED, TOO_SATURATED = 0.02, 0.3
"""Parts of the lit pixels that white saturates: a warning; too many for the images to agree."""

MOST_ROUNDS = 2
"""Times that images which contradict the others are recorded again."""

RECORD_AGAIN = frozenset({
    Kind.REPEATED_IMAGE, Kind.MISSING_IMAGE, Kind.EXCHANGED_IMAGES, Kind.SHIFT_DIRECTION,
    Kind.PERIOD, Kind.GRAY_POLARITY, Kind.GRAY_ORDER,
})  # fmt: skip
"""Faults of the order of the images; single exchanged ones may look like any of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mended:
    """One thing that went wrong while recording, and was recorded again or passed over.

    Parameters
    ----------
    image : int; place in the plan, -1 for the images of white and black
    attempt : int; from 1
    trouble : Trouble
    """

    image: int
    attempt: int
    trouble: Trouble


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recorded:
    """What was recorded.

    Parameters
    ----------
    stacks : tuple of ImageStack, one for each camera
    times_s : (camera, image) float64, s; when each image was exposed, from the first one on
    mended : tuple of Mended
    warnings : tuple of str; what could not be mended and may be harmless
    """

    stacks: tuple[ImageStack, ...]
    times_s: NDArray[np.float64]
    mended: tuple[Mended, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(slots=True, eq=False)
class _Sequence:
    """A recording as it grows."""

    devices: Devices
    plan: PatternPlan
    rig: Rig | None
    references: Mapping[str, Reference]
    images: dict[str, list[Grey | None]]
    times: dict[str, list[float]]
    last: dict[str, int]
    mended: list[Mended] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def _silent(_work: str, _done: int, _total: int) -> None:
    pass


def record(
    devices: Devices, plan: PatternPlan, rig: Rig | None = None, /, *, progress: Progress = _silent
) -> Recorded:
    """Record a plan: white and black first, then every pattern, each checked as it arrives.

    A frame that is missing, not whole, late, repeated, or of another brightness than its pattern is
    recorded again. At the end the images of each camera are compared with the plan together; those
    that contradict it are recorded again, too.

    Parameters
    ----------
    devices : Devices, open
    plan : PatternPlan
    rig : Rig or None; says which way the fringes move in the images
    progress : called as the images are there

    Returns
    -------
    Recorded

    Raises
    ------
    DeviceError
        If a frame stays wrong, or a device does not answer.
    """
    last = dict.fromkeys((camera.name for camera in devices.cameras), -1)
    mended: list[Mended] = []
    references, saturated = _references(devices, last, mended)
    names = list(last)
    run = _Sequence(
        devices=devices,
        plan=plan,
        rig=rig,
        references=references,
        images={name: [None] * plan.n_images for name in names},
        times={name: [0.0] * plan.n_images for name in names},
        last=last,
        mended=mended,
        warnings=saturated,
    )
    shape = devices.projector.open()
    devices.projector.load([pattern_image(pattern, shape) for pattern in plan.patterns])
    for place in range(plan.n_images):
        _take(run, place)
        progress("recording", place + 1, plan.n_images)
    if max(reference.saturated for reference in references.values()) < TOO_SATURATED:
        _mend_sequence(run, progress)
    return _recorded(run)


def _references(
    devices: Devices, last: dict[str, int], mended: list[Mended]
) -> tuple[dict[str, Reference], list[str]]:
    """Take white and black with all cameras; wait longer where they do not differ."""
    shape = devices.projector.open()
    devices.projector.load([np.full(shape, 255, np.uint8), np.zeros(shape, np.uint8)])
    for attempt in range(1, MOST_TRIES + 1):
        longer_s = LONGER_S * (attempt - 1)
        white, black = (_uniform(devices, i, last, mended, longer_s) for i in (0, 1))
        try:
            references = {
                name: reference_of(name, white[name].image, black[name].image, info)
                for name, info in devices.infos.items()
            }
            break
        except DeviceError as problem:
            if attempt == MOST_TRIES:
                raise
            trouble = Trouble(kind="brightness", camera="", text=str(problem))
            mended.append(Mended(image=-1, attempt=attempt, trouble=trouble))
    saturated = [
        f"camera '{name}': {100 * reference.saturated:.0f} % of the lit pixels are saturated by "
        "white. Expose shorter, or let --expose auto find the exposure"
        for name, reference in references.items()
        if reference.saturated > MOST_SATURATED
    ]
    return references, saturated


def _uniform(
    devices: Devices, index: int, last: dict[str, int], mended: list[Mended], longer_s: float
) -> Mapping[str, Frame]:
    """Take white or black until the frames of all cameras are whole."""
    for attempt in range(1, MOST_TRIES + 1):
        shot = shoot(devices, index, last, longer_s=longer_s + LONGER_S * (attempt - 1))
        _note(mended, -1, attempt, shot.notes, shot.troubles)
        last.update({name: frame.number for name, frame in shot.frames.items()})
        if not shot.troubles:
            return shot.frames
    raise DeviceError(_given_up("the white or the black image", shot.troubles))


def _take(run: _Sequence, place: int, *, may_go_back: bool = True) -> None:
    """Record one pattern until nothing is wrong with it.

    Where it looks like an earlier image again and again, that one may be wrong: it is recorded
    again first.
    """
    said: list[str] = []
    for attempt in range(1, MOST_TRIES + 1):
        shot = shoot(run.devices, place, run.last, longer_s=LONGER_S * (attempt - 1))
        run.last.update({name: max(frame.number, run.last[name])
                         for name, frame in shot.frames.items()})  # fmt: skip
        troubles = [*shot.troubles] or _contradictions(run, place, shot)
        _note(run.mended, place, attempt, shot.notes, troubles)
        said.append("; ".join(trouble.text for trouble in troubles))
        if not troubles or _may_look_alike(run.plan.patterns[place], said):
            _keep(run, place, shot)
            return
        like = max(trouble.like for trouble in troubles)
        if may_go_back and like >= 0 and said.count(said[-1]) > 1:
            _forget(run, [like])
            _take(run, like, may_go_back=False)
            may_go_back = False
    raise DeviceError(_given_up(f"image {place}", troubles))


def _note(
    mended: list[Mended],
    place: int,
    attempt: int,
    notes: Sequence[Trouble],
    troubles: Sequence[Trouble],
) -> None:
    mended += [
        Mended(image=place, attempt=attempt, trouble=trouble) for trouble in (*notes, *troubles)
    ]


def _may_look_alike(pattern: Pattern, said: list[str]) -> bool:
    """Tell whether the cameras may see a part in which this bit and the one before are the same."""
    return (
        isinstance(pattern, GrayBit)
        and len(said) > 1
        and said[-1] == said[-2]
        and "shows again" in said[-1]
    )


def _contradictions(run: _Sequence, place: int, shot: Shot) -> list[Trouble]:
    pattern = run.plan.patterns[place]
    troubles = []
    for name, frame in shot.frames.items():
        reference = run.references[name]
        earlier = {
            other: (run.plan.patterns[other], reference.part_of(image))
            for other in _comparable(run.plan, place)
            if (image := run.images[name][other]) is not None
        }
        troubles += check_content(name, pattern, frame.image, reference, earlier)
    return troubles


def _comparable(plan: PatternPlan, place: int) -> list[int]:
    """Return the images that a wrong one may repeat: the one before, and the same fringes'."""
    pattern = plan.patterns[place]
    alike = [
        other
        for other, known in enumerate(plan.patterns)
        if isinstance(pattern, Fringe)
        and isinstance(known, Fringe)
        and (known.period_px, known.angle) == (pattern.period_px, pattern.angle)
        and largest_change(pattern, known) > 0
        and other != place
    ]
    return sorted({*alike, *([place - 1] if place else [])})


def _keep(run: _Sequence, place: int, shot: Shot) -> None:
    for name, frame in shot.frames.items():
        run.images[name][place] = frame.image
        run.times[name][place] = frame.time_s


def _forget(run: _Sequence, places: Sequence[int]) -> None:
    for images in run.images.values():
        for place in places:
            images[place] = None


def _given_up(what: str, troubles: Sequence[Trouble]) -> str:
    found = "; ".join(dict.fromkeys(trouble.text for trouble in troubles))
    return (
        f"{what}: expected a frame that fits its pattern, found after {MOST_TRIES} tries: {found}. "
        "Check cable, bandwidth and trigger of the camera, and that the projector shows the "
        "patterns; nothing was written"
    )


def _mend_sequence(run: _Sequence, progress: Progress) -> None:
    """Record again what contradicts the other images; refuse what stays wrong."""
    for round_ in range(MOST_ROUNDS + 1):
        faults = [fault for stack in _stacks(run) for fault in _of_order(stack, run.rig)]
        wrong = [
            f for f in faults if _concerned(run.plan, f) and (round_ == 0 or f.value > f.limit)
        ]
        again = sorted({place for fault in wrong for place in _concerned(run.plan, fault)})
        texts = list(dict.fromkeys(fault.text for fault in faults))
        if not again:
            run.warnings += texts  # of what is the same when recorded again, and not clear
            return
        if round_ == MOST_ROUNDS:
            raise DeviceError(
                f"recording: expected the images of the plan, found after {MOST_ROUNDS} rounds: "
                f"{'; '.join(texts)}. Wait longer for the projector (--measure-latency), hold the "
                "object still, and see that the projector's image is not mirrored or scaled; "
                "nothing was written"
            )
        run.mended += [
            Mended(image=min(_concerned(run.plan, fault)), attempt=round_ + 1,
                   trouble=Trouble(kind=fault.kind.value, camera=fault.camera, text=fault.text))
            for fault in wrong
        ]  # fmt: skip
        _forget(run, again)
        for done, place in enumerate(again):
            _take(run, place)
            progress("recording again", done + 1, len(again))


def _of_order(stack: ImageStack, rig: Rig | None) -> list[Fault]:
    """Return what is wrong with the order of the images of one camera."""
    lit = lit_map(stack)
    faults = check_sequence(stack, lit)
    if faults or rig is None:
        return faults
    return [
        Fault(
            kind=Kind.SHIFT_DIRECTION,
            camera=stack.device_name,
            figure="period_px",
            value=fringes.period_px,
            limit=0.0,
            text=f"camera '{stack.device_name}': the fringes of {fringes.period_px:g} px move the "
            "other way than the calibrated rig says (two images exchanged, or the projector's "
            "image mirrored)",
            images=fringes.indices,
        )
        for fringes in goes_backwards(stack, lit, rig)
    ]


def _concerned(plan: PatternPlan, fault: Fault) -> list[int]:
    """Return the images to record again: with one step all of its fringes, and after a missing
    image all later ones, for which of them is wrong is not certain.
    """
    if fault.kind not in RECORD_AGAIN:
        return []
    if not fault.images:
        return list(range(plan.n_images))
    named = fault.images
    if len(named) == 1:
        named = tuple(range(named[0], plan.n_images))
    sets = [s.indices for s in plan.fringe_sets if set(s.indices) & set(named)]
    return sorted({*named, *(place for indices in sets for place in indices)})


def _stacks(run: _Sequence) -> list[ImageStack]:
    stacks = []
    for name, images in run.images.items():
        info = run.devices.infos[name]
        stacks.append(
            ImageStack(
                images=np.stack([image for image in images if image is not None]),
                plan=run.plan,
                device_name=name,
                saturation_dn=info.saturation_dn,
                black_level_dn=info.black_level_dn,
                noise=info.noise,
            )
        )
    return stacks


def _recorded(run: _Sequence) -> Recorded:
    times = np.array(list(run.times.values()))
    return Recorded(
        stacks=tuple(_stacks(run)),
        times_s=times - times.min(),
        mended=tuple(run.mended),
        warnings=tuple(dict.fromkeys(run.warnings)),
    )
