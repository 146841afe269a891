"""Light, lenses, sensor and events of the simulator against closed forms and sampled statistics.

Nothing here calls the code under test for what it expects: pinholes, planes, shading, phases and
form factors are worked out in this file.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numba
import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from fringe3d.model import (
    Device,
    Fringe,
    GrayBit,
    Pattern,
    PatternPlan,
    Rig,
    RigidTransform,
    Uniform,
)
from fringe3d.model.plan import fringes

pytest.importorskip("embreex")

from fringe3d.simulate.mesh import Mesh
from fringe3d.simulate.optics import (
    CameraOptics,
    ProjectorOptics,
    Recording,
    Surface,
)
from fringe3d.simulate.render import Setup, Stage, prepare, record
from fringe3d.simulate.scene import Scene, table
from fringe3d.simulate.sensor import expose

Floats = NDArray[np.float64]

SIGMAS = 4.5
"""Sampled statistics may be off by so many of their standard errors; seeds are fixed."""

EXACT = 1e-4
"""Noise-free light: single precision, 16 bits, a full well of 1e12 electrons; all below 5e-5."""


N_THREADS = numba.get_num_threads()


@contextmanager
def threads(number: int) -> Iterator[None]:
    before = numba.get_num_threads()
    numba.set_num_threads(number)
    try:
        yield
    finally:
        numba.set_num_threads(before)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    """Thousands of tiny images: to wake a second thread would take longer than they do."""
    with threads(1):
        yield


# --- an independent model of the geometry -------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Pinhole:
    """A lens without distortion that looks from a place at the world's origin."""

    place: tuple[float, float, float]
    focal: tuple[float, float]
    size: tuple[int, int]  # width, height
    center: tuple[float, float]

    @property
    def axes(self) -> Floats:
        forward = -np.array(self.place) / math.hypot(*self.place)
        right = np.array([1.0, 0.0, 0.0]) - forward[0] * forward
        right /= math.hypot(*right)
        return np.array([right, np.cross(forward, right), forward])

    def device(self, name: str) -> Device:
        return Device(
            name=name,
            role="projector" if name == "projector" else "camera",
            n_rows=self.size[1],
            n_cols=self.size[0],
            focal_px=self.focal,
            center_px=self.center,
            device_from_world=RigidTransform(
                rotation=self.axes, translation=-self.axes @ np.array(self.place)
            ),
        )

    def flat(self) -> Floats:
        """Return the pixel centres on the plane at depth 1, (row, col, 3)."""
        y, x = np.mgrid[: self.size[1], : self.size[0]].astype(float)
        flat_x = (x - self.center[0]) / self.focal[0]
        flat_y = (y - self.center[1]) / self.focal[1]
        return np.stack([flat_x, flat_y, np.ones_like(flat_x)], axis=-1)

    def cosine(self) -> Floats:
        """Return the cosine of each pixel's ray against the optical axis."""
        return np.asarray(1 / np.linalg.norm(self.flat(), axis=-1))

    def on_plane(self, normal: Floats, point: Floats) -> Floats:
        """Return where each pixel sees a plane, (row, col, 3)."""
        directions = self.flat() @ self.axes
        room = (point - np.array(self.place)) @ normal
        points: Floats = self.place + (room / (directions @ normal))[..., None] * directions
        return points

    def depth(self, points: Floats) -> Floats:
        return np.asarray((points - np.array(self.place)) @ self.axes[2])

    def image(self, points: Floats) -> Floats:
        inside = (points - np.array(self.place)) @ self.axes.T
        return np.asarray(inside[..., :2] / inside[..., 2:] * self.focal + self.center)

    def covers(self, points: Floats, margin: float) -> NDArray[np.bool_]:
        """Tell which points lie in the image, `margin` pixels from its border."""
        low, high = -0.5 + margin, np.array(self.size) - 0.5 - margin
        pixels = self.image(points)
        return np.asarray(((pixels >= low) & (pixels <= high)).all(axis=-1))


CAMERA = Pinhole(place=(-20, 30, 310), focal=(150, 153), size=(96, 80), center=(45, 42))
PROJECTOR = Pinhole(place=(90, -40, 280), focal=(200, 204), size=(200, 160), center=(103, 76))


def a_rig(camera: Pinhole = CAMERA, projector: Pinhole = PROJECTOR) -> Rig:
    return Rig(cameras=(camera.device("c1"),), projector=projector.device("projector"))


def quad(corner: ArrayLike, first: ArrayLike, second: ArrayLike) -> Mesh:
    """Return a parallelogram; its normal is the first edge times the second."""
    a, b, c = (np.asarray(v, float) for v in (corner, first, second))
    return Mesh(
        vertices_mm=np.stack([a, a + b, a + b + c, a + c]),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A square plate of 800 mm, tilted about the y axis."""

    height: float = 0.0
    tilt_deg: float = 0.0
    surface: Surface = field(default_factory=lambda: Surface(albedo=0.7))

    @property
    def point(self) -> Floats:
        return np.array([0.0, 0.0, self.height])

    @property
    def across(self) -> Floats:
        tilt = math.radians(self.tilt_deg)
        return np.array([math.cos(tilt), 0.0, math.sin(tilt)])

    @property
    def normal(self) -> Floats:
        tilt = math.radians(self.tilt_deg)
        return np.array([-math.sin(tilt), 0.0, math.cos(tilt)])

    def scene(self) -> Scene:
        corner = self.point - 400 * self.across - np.array([0.0, 400.0, 0.0])
        return Scene(thing=quad(corner, 800 * self.across, [0, 800, 0]), surface=self.surface)

    def seen(self, camera: Pinhole = CAMERA) -> Floats:
        return camera.on_plane(self.normal, self.point)


def irradiance(
    points: Floats, normal: Floats, projector: Pinhole = PROJECTOR, *, vignetting: float = 0.0
) -> Floats:
    """Return the light of a white pixel, 1 at the origin.

    A screen across the axis at depth z gets (z0 / z)^2 and its part of the natural fall-off
    cos^4; a surface that is not parallel to the screen gets it in the ratio of the cosines.
    """
    away = np.array(projector.place) - points
    distance = np.linalg.norm(away, axis=-1)
    depth = projector.depth(points)
    on_screen = (math.hypot(*projector.place) / depth) ** 2
    off_axis = depth / distance
    cosine = np.maximum(away @ normal, 0) / distance
    return np.asarray(on_screen * off_axis ** (4 * vignetting) * cosine / off_axis)


def pure_camera(optics: CameraOptics | None = None) -> CameraOptics:
    """Return a camera whose images are the light itself, without noise."""
    return replace(
        optics or CameraOptics(exposure=0.5, black_level_dn=0, blur_px=0, vignetting=0),
        full_well_e=1e12,
        read_noise_e=0.0,
        bit_depth=16,
    )


PURE = Setup(
    camera=pure_camera(),
    projector=ProjectorOptics(dark=0, blur_px=0, vignetting=0),
    recording=Recording(ambient=0),
    n_rays=1,
)
"""Neither noise, nor blur, nor fall-off towards the border; one ray for each pixel."""


def pure(
    *,
    camera: CameraOptics | None = None,
    projector: ProjectorOptics | None = None,
    recording: Recording | None = None,
    n_rays: int = 1,
) -> Setup:
    return Setup(
        camera=camera or PURE.camera,
        projector=projector or PURE.projector,
        recording=recording or PURE.recording,
        n_rays=n_rays,
    )


def plan_of(*patterns: Pattern) -> PatternPlan:
    return PatternPlan(patterns=patterns)


def images_of(stage: Stage, *patterns: Pattern, seed: int = 1, camera: int = 0) -> Floats:
    return record(stage, plan_of(*patterns), seed=seed).stacks[camera].images.astype(float)


def light_of(stage: Stage, *patterns: Pattern) -> Floats:
    """Return the light of noise-free images, 1 for white paper at the origin."""
    optics = stage.setup.camera
    images = images_of(stage, *patterns)
    return (images - optics.black_level_dn) / (65535 - optics.black_level_dn) / optics.exposure


LIGHT, DARK = Uniform(level=1.0), Uniform(level=0.0)


# --- 1: the sensor, EMVA 1288 -------------------------------------------------------------------

FULL_WELL_E, READ_E, BLACK_DN = 9000.0, 11.0, 60.0
GAIN = (4095 - BLACK_DN) / FULL_WELL_E


def noisy(seed: int, *patterns: Pattern) -> tuple[Floats, Floats]:
    """Return images of 12 bits of a tilted plane and their means in electrons, worked out here."""
    plane = Plane(tilt_deg=10)
    optics = CameraOptics(
        exposure=0.8,
        full_well_e=FULL_WELL_E,
        read_noise_e=READ_E,
        bit_depth=12,
        black_level_dn=BLACK_DN,
        blur_px=0.5,
        vignetting=0,
    )
    stage = prepare(a_rig(), plane.scene(), replace(PURE, camera=optics))
    levels = [round(p.level * 255) / 255 for p in patterns if isinstance(p, Uniform)]
    shade = 0.7 * irradiance(plane.seen(), plane.normal)
    mean = np.array(levels)[:, None, None] * shade * 0.8 * FULL_WELL_E
    images = images_of(stage, *patterns, seed=seed)
    inner = np.s_[:, 4:-4, 4:-4]  # the lens blur repeats the border
    return images[inner], mean[inner]


def test_photon_transfer() -> None:
    levels, n_frames = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0), 40
    patterns = [Uniform(level=level) for level in levels]
    images, electrons = noisy(3, *(p for p in patterns for _ in range(n_frames)))
    frames = images.reshape(len(levels), n_frames, -1)
    mean = frames.mean(axis=(1, 2))
    variance = frames.var(axis=1, ddof=1).mean(axis=1)
    electrons = electrons.reshape(frames.shape).mean(axis=(1, 2))
    # Sampling 39 x 6300 values leaves 0.3 %.
    np.testing.assert_allclose(variance, (READ_E**2 + electrons) * GAIN**2 + 1 / 12, rtol=0.015)
    np.testing.assert_allclose((mean - BLACK_DN) / GAIN, electrons, atol=1, rtol=EXACT)
    # The slope of the photon transfer curve; the last points weigh most: 0.3 % of sampling.
    slope, dark = np.polyfit(mean - BLACK_DN, variance, 1)
    assert slope == pytest.approx(GAIN, rel=0.01)
    assert dark == pytest.approx((READ_E * GAIN) ** 2 + 1 / 12, rel=0.05)


def correlation(a: Floats, b: Floats) -> float:
    """Return the mean product of normalised noise, in standard errors of nothing."""
    return float((a * b).mean() * math.sqrt(a.size))


def test_noise_is_independent() -> None:
    frames = [Uniform(level=0.6)] * 30
    images, electrons = noisy(4, *frames)
    other, _ = noisy(5, *frames)
    sigma = GAIN * np.sqrt(READ_E**2 + electrons)
    noise = (images - BLACK_DN - GAIN * electrons) / sigma
    noise_of_other = (other - BLACK_DN - GAIN * electrons) / sigma
    assert abs(correlation(noise[:, :, 1:], noise[:, :, :-1])) < SIGMAS
    assert abs(correlation(noise[:, 1:], noise[:, :-1])) < SIGMAS
    assert abs(correlation(noise[1:], noise[:-1])) < SIGMAS
    assert abs(correlation(noise[5:], noise[:-5])) < SIGMAS
    assert abs(correlation(noise, noise_of_other)) < SIGMAS
    # It is normal: mean 0, variance 1 (and 1/12 DN^2), skewness 0, excess 0.
    n = noise.size
    assert abs(noise.mean()) < SIGMAS / math.sqrt(n) + EXACT
    assert (noise**2).mean() == pytest.approx(1, abs=SIGMAS * math.sqrt(2 / n) + 1e-3)
    # Poisson's skewness of 1 / sqrt(4000) is left out above 50 electrons, as stated there.
    assert abs((noise**3).mean()) < SIGMAS * math.sqrt(15 / n)
    assert (noise**4).mean() == pytest.approx(3, abs=SIGMAS * math.sqrt(96 / n) + 5e-3)


def test_cameras_have_their_own_noise() -> None:
    one, two = CAMERA.device("c1"), CAMERA.device("c2")
    rig = Rig(cameras=(one, two), projector=PROJECTOR.device("projector"))
    setup = replace(PURE, camera=CameraOptics(bit_depth=12, blur_px=0, vignetting=0))
    scan = record(prepare(rig, Plane().scene(), setup), plan_of(*[LIGHT] * 10), seed=1)
    first, second = (stack.images.astype(float) for stack in scan.stacks)
    # The mean of all twenty takes away a twentieth of each.
    expected = (first.mean(axis=0) + second.mean(axis=0)) / 2
    a, b = first - expected, second - expected
    assert (a * b).mean() / (a**2).mean() == pytest.approx(-1 / 19, abs=SIGMAS / math.sqrt(a.size))


@pytest.mark.parametrize("electrons", [0.5, 3.0, 20.0, 45.0])
def test_few_electrons_are_counted(electrons: float) -> None:
    counts, expected = counted(electrons, read_noise_e=0.0)
    whole = np.rint(counts)
    # Grey values are rounded to 1/65 electron.
    np.testing.assert_allclose(counts, whole, atol=0.01)
    n, mean = whole.size, expected.mean()
    assert whole.mean() == pytest.approx(mean, abs=SIGMAS * math.sqrt(mean / n))
    rest = (whole - expected) / np.sqrt(expected)
    # Standard errors for Poisson's distribution: its central moments.
    fourth = 3 + 1 / mean
    assert (rest**2).mean() == pytest.approx(1, abs=SIGMAS * math.sqrt((fourth - 1) / n))
    sixth = 15 + 25 / mean + 1 / mean**2
    assert (rest**3).mean() == pytest.approx(mean**-0.5, abs=SIGMAS * math.sqrt(sixth / n))
    for count in range(4):
        share = mean**count * math.exp(-mean) / math.factorial(count)
        error = math.sqrt(share / n) + 1 / n
        assert (whole == count).mean() == pytest.approx(share, abs=SIGMAS * error)


def test_few_electrons_are_read_with_noise() -> None:
    counts, expected = counted(6.0, read_noise_e=3.0)
    rest = counts - expected
    n, mean = counts.size, expected.mean()
    assert rest.mean() == pytest.approx(0, abs=SIGMAS * math.sqrt((mean + 9) / n))
    assert (rest**2).mean() == pytest.approx(mean + 9, rel=SIGMAS * math.sqrt(3 / n))
    # The third moment is that of the electrons alone.
    spread = math.sqrt(20 * (mean + 9) ** 3 / n)
    assert (rest**3).mean() == pytest.approx(mean, abs=SIGMAS * spread)


@pytest.mark.parametrize("electrons", [49.0, 53.0])
def test_counted_and_normal_electrons_join(electrons: float) -> None:
    counts, expected = counted(electrons, read_noise_e=5.0)
    n, mean = counts.size, expected.mean()
    rest = counts - expected
    assert rest.mean() == pytest.approx(0, abs=SIGMAS * math.sqrt((mean + 25) / n))
    assert (rest**2).mean() == pytest.approx(mean + 25, rel=SIGMAS * math.sqrt(2 / n))


def counted(electrons: float, *, read_noise_e: float) -> tuple[Floats, Floats]:
    """Return electrons read from 16-bit images of 1000 electrons, and their means."""
    black = 2000.0
    optics = CameraOptics(
        exposure=electrons / 1000 / 0.7,
        full_well_e=1000,
        read_noise_e=read_noise_e,
        bit_depth=16,
        black_level_dn=black,
        blur_px=0,
        vignetting=0,
    )
    near = replace(CAMERA, focal=(3000.0, 3000.0))  # the same light for all pixels, to 1 %
    stage = prepare(a_rig(near), Plane().scene(), replace(PURE, camera=optics))
    images = images_of(stage, *[LIGHT] * 20)
    expected = electrons * irradiance(Plane().seen(near), Plane().normal)
    return (images - black) / ((65535 - black) / 1000), np.broadcast_to(expected, images.shape)


@pytest.mark.parametrize(
    ("bit_depth", "black", "dtype"),
    [(8, 3, np.uint8), (10, 17, np.uint16), (12, 64, np.uint16), (16, 900, np.uint16)],
)
def test_range_of_grey_values(bit_depth: int, black: float, dtype: type) -> None:
    top = 2**bit_depth - 1
    optics = CameraOptics(
        exposure=0.5, bit_depth=bit_depth, black_level_dn=black, blur_px=0, vignetting=0
    )
    plane = Plane()
    setup = replace(PURE, camera=optics)
    stage = prepare(a_rig(), plane.scene(), setup)
    stack = record(stage, plan_of(*[DARK] * 8, *[LIGHT] * 8), seed=1).stacks[0]
    assert stack.images.dtype == dtype
    assert (stack.saturation_dn, stack.black_level_dn) == (top, black)
    gain = (top - black) / 10_000
    assert stack.noise is not None
    assert stack.noise.gain_dn_per_e == pytest.approx(gain)
    assert stack.noise.read_noise_dn**2 == pytest.approx((12 * gain) ** 2 + 1 / 12)
    dark, lit = stack.images[:8].astype(float), stack.images[8:].astype(float)
    sigma = math.sqrt((12 * gain) ** 2 + 1 / 12)
    assert dark.mean() == pytest.approx(black, abs=SIGMAS * sigma / math.sqrt(dark.size))
    # The variance of a normal distribution after rounding: 1/12 more where it is wide enough.
    spread = 12 * gain * math.sqrt(2)
    edges = np.arange(-6 * spread - 1, 6 * spread + 1).round() + 0.5
    shares = np.diff([math.erf(e / spread) / 2 for e in edges])
    variance = (shares * (edges[1:] - 0.5) ** 2).sum()
    # 1 % of sampling for 61 000 values.
    assert dark.var() == pytest.approx(variance, rel=0.04)
    mean = black + (top - black) * 0.5 * 0.7 * irradiance(plane.seen(), plane.normal).mean()
    noise = gain * math.sqrt(5000)
    assert lit.mean() == pytest.approx(mean, abs=SIGMAS * noise / math.sqrt(lit.size) + 1e-5 * top)
    # All of it clipped, and half of it.
    over = prepare(a_rig(), plane.scene(), replace(setup, camera=replace(optics, exposure=3.0)))
    assert (record(over, plan_of(LIGHT), seed=1).stacks[0].images == top).all()
    light = 0.7 * irradiance(plane.seen(), plane.normal)
    half = replace(optics, exposure=1 / float(np.median(light)))
    images = images_of(prepare(a_rig(), plane.scene(), replace(setup, camera=half)), LIGHT)[0]
    assert images.max() == top
    assert (images == top).mean() == pytest.approx(0.5, abs=0.02)
    clear = light * half.exposure > 1.05  # 5 sigma of shot noise
    assert clear.any()
    assert (images[clear] == top).all()


def test_values_below_black_are_clipped_at_zero() -> None:
    optics = CameraOptics(bit_depth=12, black_level_dn=0, read_noise_e=30, blur_px=0)
    stage = prepare(a_rig(), Plane().scene(), replace(PURE, camera=optics))
    images = images_of(stage, DARK)
    sigma = 30 * 4095 / 10_000
    below_half = 0.5 * (1 + math.erf(0.5 / sigma / math.sqrt(2)))
    assert (images == 0).mean() == pytest.approx(below_half, abs=SIGMAS * 0.5 / 96)


# --- 2: phase -----------------------------------------------------------------------------------

PERIOD = 16.0


def bucket(images: Floats) -> tuple[Floats, Floats, Floats]:
    """Return mean, modulation and phase of N equal steps (rows of the first axis)."""
    n = len(images)
    step = 2 * np.pi * np.arange(n)[:, None, None] / n
    c, s = (images * np.cos(step)).sum(axis=0), (images * np.sin(step)).sum(axis=0)
    return images.mean(axis=0), 2 / n * np.hypot(c, s), np.arctan2(s, c)


def wrap(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("n", [3, 4, 8, 16])
@pytest.mark.parametrize(("full_well", "read"), [(5000.0, 10.0), (50_000.0, 250.0)])
def test_phase_noise(n: int, full_well: float, read: float) -> None:
    optics = CameraOptics(full_well_e=full_well, read_noise_e=read, bit_depth=12, black_level_dn=64)
    setup = Setup(camera=optics, projector=ProjectorOptics(gamma=1.0))
    scene, rig = Plane(tilt_deg=8).scene(), a_rig()
    stage = prepare(rig, scene, setup)
    still = prepare(rig, scene, replace(setup, camera=pure_camera(optics)))
    patterns = fringes(PERIOD, n)
    mean, modulation, _ = bucket(light_of(still, *patterns))
    gain = (4095 - 64) / full_well
    sigma = np.sqrt(gain**2 * (read**2 + mean * optics.exposure * full_well) + 1 / 12)
    # Three steps: shot noise varies with the phase, evenly about the mean; 6 periods average it.
    of_phase = math.sqrt(2 / n) * sigma / (modulation * optics.exposure * (4095 - 64))
    rest = []
    for seed in (1, 3):
        a, b = (bucket(images_of(stage, *patterns, seed=seed + i))[2] for i in (0, 1))
        rest.append(wrap(a - b) / (math.sqrt(2) * of_phase))
    normalised = np.array(rest)
    # 15 360 values: 0.6 %. Phase noise stays below 0.05 rad, where it is linear to 0.2 %.
    assert of_phase.max() < 0.05
    assert np.sqrt((normalised**2).mean()) == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize("angle_deg", [0.0, 90.0, 30.0, -45.0])
def test_phase_is_that_of_the_projector_pixel(angle_deg: float) -> None:
    plane, angle = Plane(height=12, tilt_deg=20), math.radians(angle_deg)
    stage = prepare(a_rig(), plane.scene(), replace(PURE, projector=ProjectorOptics()))
    _, _, phase = bucket(light_of(stage, *fringes(PERIOD, 4, angle=angle)))
    u, v = np.moveaxis(PROJECTOR.image(plane.seen()), -1, 0)
    w = math.cos(angle) * (u + 0.5) + math.sin(angle) * (v + 0.5)
    lit = PROJECTOR.covers(plane.seen(), margin=5)
    assert lit.mean() > 0.9
    error = wrap(phase - 2 * np.pi * w / PERIOD)[lit]
    # The projector's image has 8 bits (0.5 / 127 rad, spread over 4 steps and by the blur) and
    # is sampled twice a pixel. 0.01 rad are 0.025 px.
    assert np.abs(error).max() < 0.01
    assert abs(error.mean()) < 5e-4


# --- 3: defocus of the projector ----------------------------------------------------------------

STEEP = Pinhole(place=(-150, 10, 270), focal=(260, 260), size=(96, 80), center=(50, 40))
UPRIGHT = Pinhole(place=(0, 0, 300), focal=(220, 220), size=(260, 200), center=(128, 101))


def variance_of(contrast: Floats, period: float) -> Floats:
    """Return the variance of the blur that leaves this contrast, px^2; a pixel's box taken off."""
    box = math.sin(math.pi / period) / (math.pi / period)
    return np.asarray(-np.log(contrast / box) * period**2 / (2 * np.pi**2))


SAMPLING_PX2 = 0.03
"""Two samples a pixel and lines between them blur by 0.021 px^2 more than a pixel's box."""


@pytest.mark.parametrize("angle", [0.0, math.pi / 2])
@pytest.mark.parametrize(("aperture", "focus"), [(30.0, 280.0), (45.0, 0.0), (60.0, 330.0)])
def test_defocus_of_a_tilted_plane(aperture: float, focus: float, angle: float) -> None:
    period, blur = 12.0, 0.8
    light = ProjectorOptics(
        dark=0, blur_px=blur, aperture_mm=aperture, focus_mm=focus, vignetting=0
    )
    plane = Plane(tilt_deg=-35)
    stage = prepare(a_rig(STEEP, UPRIGHT), plane.scene(), replace(PURE, projector=light))
    mean, modulation, _ = bucket(light_of(stage, *fringes(period, 8, angle=angle)))
    points = plane.seen(STEEP)
    # Away from the border of the image by five times the widest blur.
    lit = UPRIGHT.covers(points, margin=20)
    nearness = 1 / UPRIGHT.depth(points)[lit]
    measured = variance_of(modulation[lit] / mean[lit], period)
    in_focus = focus or 300.0  # the optical axes meet at the origin
    disc = aperture * 220 * np.abs(nearness - 1 / in_focus)
    expected = blur**2 + disc**2 / 16
    assert np.ptp(expected) > 1.5
    assert lit.sum() > 2000
    # Lines between two samples a pixel lose up to 1 - cos(pi / 24) = 0.9 % of the contrast, on
    # the mean half of it, and the 8 bits of the pattern raise it by 0.3 %.
    contrast = np.exp(-2 * np.pi**2 * (expected - measured) / period**2)
    np.testing.assert_allclose(contrast, 1, atol=0.01)
    # The thin lens, from the images alone: variance is a parabola of 1 / z.
    square, slope, offset = np.polyfit(nearness, measured, 2)
    assert -2 * square / slope == pytest.approx(in_focus, rel=1e-3)
    assert 4 * math.sqrt(square) / 220 == pytest.approx(aperture, rel=5e-3)
    assert offset - slope**2 / (4 * square) == pytest.approx(blur**2, abs=SAMPLING_PX2)


@pytest.mark.parametrize("period", [8.0, 16.0])
def test_contrast_in_focus_is_that_of_blur_and_pixel(period: float) -> None:
    blurs = (0.5, 1.0, 1.5)
    measured = []
    for blur in blurs:
        light = ProjectorOptics(dark=0, blur_px=blur, vignetting=0)
        stage = prepare(a_rig(), Plane().scene(), replace(PURE, projector=light))
        mean, modulation, _ = bucket(light_of(stage, *fringes(period, 8)))
        lit = PROJECTOR.covers(Plane().seen(), margin=8)
        measured.append(float((modulation / mean)[lit].mean()))
    box = math.sin(math.pi / period) / (math.pi / period)
    expected = [box * math.exp(-2 * (math.pi * blur / period) ** 2) for blur in blurs]
    # What the sampling blurs besides.
    less = 1 - math.exp(-2 * np.pi**2 * SAMPLING_PX2 / period**2)
    np.testing.assert_allclose(measured, expected, rtol=less + 1e-3)


# --- 4: brightness ------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.6, 1.0, 2.2])
@pytest.mark.parametrize("dark", [0.0, 0.02])
def test_gamma_and_black_of_the_projector(gamma: float, dark: float) -> None:
    light = ProjectorOptics(gamma=gamma, dark=dark, blur_px=0.5, vignetting=0)
    stage = prepare(a_rig(), Plane().scene(), replace(PURE, projector=light))
    levels = (0.0, 0.25, 0.5, 0.75, 1.0)
    lit = PROJECTOR.covers(Plane().seen(), margin=5)
    images = light_of(stage, *(Uniform(level=level) for level in levels))[:, lit]
    white = 0.7 * irradiance(Plane().seen(), Plane().normal)[lit]
    np.testing.assert_allclose(images[-1], white, rtol=EXACT)
    np.testing.assert_allclose(images[0], dark * white, atol=EXACT)
    # The projector's image has 8 bits.
    shown = np.array([64, 128, 191]) / 255
    lifted = (images[1:4] - images[0]) / (images[4] - images[0])
    slope = np.log(lifted.mean(axis=1)) / np.log(shown)
    np.testing.assert_allclose(slope, gamma, rtol=1e-3)


@pytest.mark.parametrize("gamma", [0.45, 1.0, 1.8])
def test_response_of_the_camera(gamma: float) -> None:
    optics = replace(pure_camera(), gamma=gamma, black_level_dn=500, exposure=0.9)
    stage = prepare(a_rig(), Plane().scene(), replace(PURE, camera=optics))
    levels = np.array([51, 102, 153, 204, 255]) / 255
    images = images_of(stage, *(Uniform(level=level) for level in levels))
    light = 0.9 * 0.7 * irradiance(Plane().seen(), Plane().normal)
    expected = 500 + (65535 - 500) * (levels[:, None, None] * light) ** gamma
    lit = PROJECTOR.covers(Plane().seen(), margin=1)
    np.testing.assert_allclose(images[:, lit], expected[:, lit], rtol=EXACT, atol=1)
    noise = record(stage, plan_of(LIGHT), seed=1).stacks[0].noise
    assert (noise is None) == (gamma != 1)  # it would be wrong for a bent response


@pytest.mark.parametrize(
    ("of_camera", "of_projector"), [(0, 0), (1, 0), (0, 1), (0.5, 0.3), (1.0, 1.0)]
)
@pytest.mark.parametrize(("tilt", "height"), [(0, 0), (25, 15), (-40, -20)])
def test_light_of_a_plane(
    of_camera: float, of_projector: float, tilt: float, height: float
) -> None:
    plane = Plane(height=height, tilt_deg=tilt)
    setup = pure(
        camera=replace(PURE.camera, vignetting=of_camera),
        projector=replace(PURE.projector, vignetting=of_projector, blur_px=0.5),
    )
    wide = replace(CAMERA, focal=(90.0, 92.0))
    image = light_of(prepare(a_rig(wide), plane.scene(), setup), LIGHT)[0]
    points = plane.seen(wide)
    shade = irradiance(points, plane.normal, vignetting=of_projector)
    expected = 0.7 * shade * wide.cosine() ** (4 * of_camera)
    lit, beside = PROJECTOR.covers(points, margin=4), ~PROJECTOR.covers(points, margin=-1)
    assert lit.mean() > 0.3
    assert beside.any()
    np.testing.assert_allclose(image[lit], expected[lit], rtol=EXACT, atol=EXACT)
    assert (image[beside] == 0).all()
    if of_camera == 1:  # the corners lose a third and more: nothing above is near 1 by chance
        assert wide.cosine().min() ** 4 < 0.66


@pytest.mark.parametrize("exponent", [30.0, 200.0])
@pytest.mark.parametrize("tilt", [0.0, 12.0])
def test_glossy_lobe(exponent: float, tilt: float) -> None:
    matt = Plane(tilt_deg=tilt)
    glossy = replace(matt, surface=Surface(albedo=0.7, gloss=0.3, gloss_exponent=exponent))
    setup = replace(PURE, camera=replace(PURE.camera, exposure=0.05))
    images = [light_of(prepare(a_rig(), p.scene(), setup), LIGHT)[0] for p in (matt, glossy)]
    points = matt.seen()
    lit = PROJECTOR.covers(points, margin=4)
    lambert = irradiance(points, matt.normal)
    lobe = np.where(lit, images[1] - images[0], 0) / lambert / 0.3
    # The peak lies where the plane mirrors the projector.
    lamp, eye = np.array(PROJECTOR.place), np.array(CAMERA.place)
    mirrored = lamp - 2 * (lamp @ matt.normal) * matt.normal
    part = (eye @ matt.normal) / ((eye - mirrored) @ matt.normal)
    x, y = CAMERA.image(eye + part * (mirrored - eye))
    row, col = np.unravel_index(lobe.argmax(), lobe.shape)
    # One pixel on either side: fractions of a pixel, and Lambert's cosine is divided out.
    assert abs(col - x) <= 1
    assert abs(row - y) <= 1
    assert lobe.max() == pytest.approx((exponent + 8) / 8, rel=0.01)
    # The angle between the normal and the half-way direction, everywhere.
    to_lamp, to_eye = lamp - points, eye - points
    to_lamp /= np.linalg.norm(to_lamp, axis=-1, keepdims=True)
    to_eye /= np.linalg.norm(to_eye, axis=-1, keepdims=True)
    half = to_lamp + to_eye
    cosine = half @ matt.normal / np.linalg.norm(half, axis=-1)
    expected = (exponent + 8) / 8 * cosine**exponent
    # The exposure of a twentieth: ten times the rounding of other tests, over a gloss of 0.3.
    np.testing.assert_allclose(lobe[lit], expected[lit], atol=0.01)


def test_glossy_lobe_keeps_the_energy() -> None:
    exponent = 200.0
    plane = Plane(surface=Surface(albedo=0.5, gloss=1.0, gloss_exponent=exponent))
    setup = replace(PURE, camera=replace(PURE.camera, exposure=0.03))
    image = light_of(prepare(a_rig(), plane.scene(), setup), LIGHT)[0]
    points = plane.seen()
    lit = PROJECTOR.covers(points, margin=4)
    to_lamp, to_eye = np.array(PROJECTOR.place) - points, np.array(CAMERA.place) - points
    to_lamp /= np.linalg.norm(to_lamp, axis=-1, keepdims=True)
    to_eye /= np.linalg.norm(to_eye, axis=-1, keepdims=True)
    half = to_lamp + to_eye
    tilt = np.arccos(half[..., 2] / np.linalg.norm(half, axis=-1))
    lobe = image / irradiance(points, plane.normal) - 0.5
    order = np.argsort(tilt[lit])
    # Seen from above, light from the angle t has its half-way direction at t / 2.
    angle = np.linspace(0, np.pi / 4, 2000)
    at_angle = np.interp(angle / 2, tilt[lit][order], lobe[lit][order])
    reflected = 2 * np.pi * np.trapezoid(at_angle / np.pi * np.cos(angle) * np.sin(angle), angle)
    # Exactly n (n + 8) / ((n + 2) (n + 4)) = 1.0095 for the normalisation by (n + 8) / 8.
    assert reflected == pytest.approx(1, abs=0.015)


# --- 5: what happens while images are recorded --------------------------------------------------


@pytest.mark.parametrize("background", ["none", "mottled", "checker"])
def test_ambient_light(background: str) -> None:
    # A plate of 60 mm: most pixels look past it into empty space.
    plate = quad([-30, -30, 0], [60, 0, 0], [0, 60, 0])
    scene = Scene(thing=plate, surface=Surface(albedo=0.6), background=Surface(texture=background))
    setup = pure(
        camera=replace(PURE.camera, vignetting=1.0),
        recording=Recording(ambient=0.25),
    )
    image = light_of(prepare(a_rig(), scene, setup), DARK)[0]
    x, y, _ = np.moveaxis(Plane().seen(), -1, 0)
    on_plate = (np.abs(x) < 30) & (np.abs(y) < 30)
    expected = np.where(on_plate, 0.25 * 0.6 * CAMERA.cosine() ** 4, 0.0)
    np.testing.assert_allclose(image, expected, atol=EXACT)


def test_ambient_light_adds_to_that_of_the_lamp() -> None:
    setup = pure(recording=Recording(ambient=0.2))
    lit, dark = light_of(prepare(a_rig(), Plane().scene(), setup), LIGHT, DARK)
    without = light_of(prepare(a_rig(), Plane().scene(), PURE), LIGHT)[0]
    np.testing.assert_allclose(lit - without, 0.2 * 0.7, atol=EXACT)
    np.testing.assert_allclose(dark, 0.2 * 0.7, atol=EXACT)


def test_hot_pixels() -> None:
    share = 0.03
    optics = CameraOptics(bit_depth=12, black_level_dn=64, hot_pixels=share, blur_px=0.7)
    stage = prepare(a_rig(), Plane().scene(), replace(PURE, camera=optics))
    frames = images_of(stage, *[DARK] * 6, *[LIGHT] * 6, seed=8)
    offset = frames[:6].mean(axis=0) - 64
    gain = (4095 - 64) / 10_000
    noise = math.hypot(12 * gain, 12**-0.5)
    hot = offset > 8 * noise  # 40 DN; the weakest hot pixel shows 400
    n = hot.size
    assert hot.mean() == pytest.approx(share, abs=SIGMAS * math.sqrt(share / n))
    assert np.abs(offset[~hot]).max() < 6 * noise / math.sqrt(6)
    assert offset[hot].min() > 0.1 * 4031 - 6 * noise
    # Even from a tenth to the whole full well.
    spread = math.sqrt(0.81 / 12 / hot.sum())
    assert offset[hot].mean() / 4031 == pytest.approx(0.55, abs=SIGMAS * spread)
    # Constant from image to image, and added to the light of the scene.
    assert frames[:6, hot].std(axis=0, ddof=1).mean() == pytest.approx(noise, rel=0.1)
    clean = prepare(a_rig(), Plane().scene(), replace(stage.setup, camera=replace(
        optics, hot_pixels=0.0)))  # fmt: skip
    gained = (frames - images_of(clean, *[DARK] * 6, *[LIGHT] * 6, seed=8))[6:, hot].mean(axis=0)
    low = offset[hot] < 500  # not clipped
    assert low.any()
    np.testing.assert_allclose(gained[low], offset[hot][low], atol=6 * noise)
    # Another camera of that kind has others.
    other = images_of(stage, DARK, seed=9)[0] - 64 > 8 * noise
    assert (other & hot).sum() < 0.3 * hot.sum()


SMALL = replace(CAMERA, size=(24, 20), center=(11, 10), focal=(100.0, 100.0))


def test_flicker() -> None:
    n = 1500
    setup = pure(projector=replace(PURE.projector, flicker=0.04), recording=Recording(ambient=0.2))
    stage = prepare(a_rig(SMALL), Plane().scene(), setup)
    light = light_of(stage, *[LIGHT] * n) - 0.2 * 0.7
    steady = 0.7 * irradiance(Plane().seen(SMALL), Plane().normal)
    lamp = light / steady
    # The lamp alone flickers, and all of the image alike.
    assert np.ptp(lamp, axis=(1, 2)).max() < 5e-4
    lamp = lamp.mean(axis=(1, 2))
    assert lamp.std() == pytest.approx(0.04, rel=SIGMAS / math.sqrt(2 * n))
    assert lamp.mean() == pytest.approx(1, abs=SIGMAS * 0.04 / math.sqrt(n))
    rest = (lamp - lamp.mean()) / lamp.std()
    assert abs(correlation(rest[1:], rest[:-1])) < SIGMAS


@pytest.mark.parametrize("angle_deg", [0, 90, 45])
def test_vibration(angle_deg: float) -> None:
    n, vibration, angle = 800, 0.6, math.radians(angle_deg)
    setup = pure(projector=replace(PURE.projector, blur_px=1.0, vibration_px=vibration))
    stage = prepare(a_rig(SMALL), Plane().scene(), setup)
    pattern = Fringe(period_px=PERIOD, shift=0.0, angle=angle)
    steady = 0.7 * irradiance(Plane().seen(SMALL), Plane().normal)
    images = light_of(stage, *[pattern] * n) / steady
    u, v = np.moveaxis(PROJECTOR.image(Plane().seen(SMALL)), -1, 0)
    phase = 2 * np.pi / PERIOD * (math.cos(angle) * (u + 0.5) + math.sin(angle) * (v + 0.5))
    model = np.stack([np.ones(phase.size), np.cos(phase).ravel(), np.sin(phase).ravel()], axis=1)
    _, c, s = np.linalg.lstsq(model, images.reshape(n, -1).T, rcond=None)[0]
    moved = PERIOD / (2 * np.pi) * np.arctan2(s, c)
    # At 45 degrees the axes must be independent to give the same.
    assert moved.std() == pytest.approx(vibration, rel=SIGMAS / math.sqrt(2 * n))
    assert moved.mean() == pytest.approx(0, abs=SIGMAS * vibration / math.sqrt(n))
    rest = (moved - moved.mean()) / moved.std()
    assert abs(correlation(rest[1:], rest[:-1])) < SIGMAS


@pytest.mark.parametrize(
    ("dropped", "repeated", "shown"),
    [
        ((), (), [0, 1, 2, 3, 4, 5]),
        ((1,), (), [0, 2, 3, 4, 5, None]),
        ((0, 5), (), [1, 2, 3, 4, None, None]),
        ((), (2,), [0, 1, 1, 3, 4, 5]),
        ((), (2, 3), [0, 1, 1, 1, 4, 5]),
        ((3,), (2,), [0, 1, 1, 4, 5, None]),
        ((1,), (2,), [0, 1, 3, 4, 5, None]),
    ],
)
def test_lost_and_repeated_images(
    dropped: tuple[int, ...], repeated: tuple[int, ...], shown: list[int | None]
) -> None:
    levels = np.array([0.9, 0.2, 0.5, 0.3, 0.7, 0.4])
    setup = pure(recording=Recording(ambient=0.1, dropped=dropped, repeated=repeated))
    stage = prepare(a_rig(), Plane().scene(), setup)
    images = light_of(stage, *(Uniform(level=level) for level in levels))
    white = 0.7 * irradiance(Plane().seen(), Plane().normal)
    lit = PROJECTOR.covers(Plane().seen(), margin=4)
    for image, index in zip(images, shown, strict=True):
        if index is None:
            assert (image == 0).all()
            continue
        level = round(255 * levels[index]) / 255
        np.testing.assert_allclose(image[lit], (level * white + 0.07)[lit], atol=EXACT)


def turned(angle_deg: float, shift: ArrayLike) -> RigidTransform:
    a = math.radians(angle_deg)
    c, s = math.cos(a), math.sin(a)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return RigidTransform(rotation=rotation, translation=shift)


MOVING = Recording(ambient=0.05, frame_ms=40, velocity_mm_s=(150, -60, 220), spin_deg_s=200)


def wedge(pose: RigidTransform) -> Scene:
    """Return a small slope above a table."""
    slope = quad([-15, -20, 4], [40, 0, 12], [0, 30, 0])
    return Scene(
        thing=slope,
        surface=Surface(albedo=0.9),
        world_from_object=pose,
        surroundings=table(height_mm=-30, width_mm=600),
    )


def in_motion(*, dropped: tuple[int, ...] = (), repeated: tuple[int, ...] = ()) -> Stage:
    light = replace(PURE.projector, blur_px=0.5, aperture_mm=20)
    recording = replace(MOVING, dropped=dropped, repeated=repeated)
    scene = wedge(turned(25, [12, 3, 5]))
    return prepare(a_rig(), scene, pure(projector=light, recording=recording))


def standing(seconds: list[float], patterns: list[Pattern]) -> Floats:
    """Return images of wedges that stand where the moving one is at these times."""
    light = replace(PURE.projector, blur_px=0.5, aperture_mm=20)
    still = pure(projector=light, recording=Recording(ambient=0.05))
    images = []
    for time, pattern in zip(seconds, patterns, strict=True):
        # Where it began, (12, 3, 5), turned about the world's axis, then shifted.
        angle = math.radians(200 * time)
        x = 12 * math.cos(angle) - 3 * math.sin(angle) + 150 * time
        y = 12 * math.sin(angle) + 3 * math.cos(angle) - 60 * time
        pose = turned(25 + 200 * time, [x, y, 5 + 220 * time])
        images.append(light_of(prepare(a_rig(), wedge(pose), still), pattern)[0])
    return np.array(images)


STRIPES = GrayBit(bit=0, n_bits=2, cell_px=9.0, angle=0.2)
FIVE: list[Pattern] = [LIGHT, *fringes(PERIOD, 3), STRIPES]

OTHER_SIDE = 1e-3
"""The same arithmetic but for rounding, which may send a ray to the other side of an edge."""


def test_motion() -> None:
    images = light_of(in_motion(), *FIVE)
    expected = standing([-0.08, -0.04, 0, 0.04, 0.08], FIVE)
    assert (np.abs(images - expected) > EXACT).mean() < OTHER_SIDE
    moved = np.abs(images - standing([0] * 5, FIVE)).max(axis=(1, 2)) > 0.1
    assert moved.tolist() == [True, True, False, True, True]


def test_a_lost_image_does_not_stop_the_motion() -> None:
    images = light_of(in_motion(dropped=(1,)), *FIVE)
    expected = standing([-0.08, 0, 0.04, 0.08], [FIVE[i] for i in (0, 2, 3, 4)])
    assert (np.abs(images[:4] - expected) > EXACT).mean() < OTHER_SIDE


def test_a_repeated_pattern_does_not_stop_the_motion() -> None:
    images = light_of(in_motion(repeated=(1, 4)), *FIVE)
    expected = standing([-0.08, -0.04, 0, 0.04, 0.08], [FIVE[i] for i in (0, 0, 2, 3, 3)])
    assert (np.abs(images - expected) > EXACT).mean() < OTHER_SIDE


def test_a_pattern_shown_again_is_blurred_for_the_depth_it_meets() -> None:
    # A plate comes nearer by 60 mm in each frame, out of focus; the pattern is one object.
    light = replace(PURE.projector, blur_px=0.3, aperture_mm=40)
    still = pure(projector=light)
    setup = replace(still, recording=Recording(ambient=0, velocity_mm_s=(0, 0, 6000)))
    pattern = Fringe(period_px=8.0, shift=0.0)
    images = light_of(prepare(a_rig(), Plane().scene(), setup), pattern, pattern, pattern)
    for image, height in zip(images, (-60, 0, 60), strict=True):
        expected = light_of(prepare(a_rig(), Plane(height=height).scene(), still), pattern)[0]
        np.testing.assert_allclose(image, expected, atol=EXACT)


def test_truth_is_that_of_the_middle_image() -> None:
    pose = turned(25, [12, 3, 5])
    stage = prepare(a_rig(), wedge(pose), pure(recording=MOVING))
    x, y, z = np.moveaxis(stage.truths[0].points_mm, -1, 0)
    a = math.radians(25)
    own_x = math.cos(a) * (x - 12) + math.sin(a) * (y - 3)
    on_slope = stage.truths[0].is_object
    assert on_slope.sum() > 100
    np.testing.assert_allclose((z - 5)[on_slope], (4 + 0.3 * (own_x + 15))[on_slope], atol=1e-6)
    middle = light_of(stage, LIGHT, LIGHT, LIGHT)[1]
    still = light_of(prepare(a_rig(), wedge(pose), pure(recording=Recording(ambient=0.05))), LIGHT)
    np.testing.assert_allclose(middle, still[0], atol=EXACT)  # rounding of the pose


# --- 6: the same again --------------------------------------------------------------------------


def bytes_of(seed: int, n_threads: int) -> list[bytes]:
    """Return the images of a recording in which everything happens at once."""
    setup = Setup(
        camera=CameraOptics(hot_pixels=0.01, aperture_mm=5),
        projector=ProjectorOptics(aperture_mm=10, flicker=0.02, vibration_px=0.2),
        recording=Recording(interreflection=True),
        n_rays=9,
    )
    rig = Rig(
        cameras=(CAMERA.device("c1"), STEEP.device("c2")),
        projector=PROJECTOR.device("projector"),
    )
    with threads(n_threads):
        stage = prepare(rig, wedge(turned(25, [12, 3, 5])), setup)
        scan = record(stage, plan_of(*FIVE), seed=seed)
    return [image.tobytes() for stack in scan.stacks for image in stack.images]


def test_the_same_seed_gives_the_same_bytes() -> None:
    one = bytes_of(7, 1)
    several = min(2, N_THREADS)
    assert bytes_of(7, 1) == one
    assert bytes_of(7, several) == one
    assert all(a != b for a, b in zip(bytes_of(8, several), one, strict=True))
    assert len(set(one)) == len(one)


# --- 7: light by way of another surface ---------------------------------------------------------

FLOOR, WALL = 0.7, 0.5  # albedo
HALF_WIDTH = 60.0
ABOVE = Pinhole(place=(190, 0, 230), focal=(600, 600), size=(96, 80), center=(48, 40))
LAMP = Pinhole(place=(200, 30, 220), focal=(250, 250), size=(256, 200), center=(127.5, 99.5))


def corner(side: float = 70.0) -> Scene:
    """Return a floor (z = 0) and a wall (x = 0) at right angles."""
    return Scene(
        thing=quad([0, -HALF_WIDTH, 0], [side, 0, 0], [0, 2 * HALF_WIDTH, 0]),
        surface=Surface(albedo=FLOOR),
        surroundings=quad([0, -HALF_WIDTH, 0], [0, 2 * HALF_WIDTH, 0], [0, 0, side]),
        background=Surface(albedo=WALL, texture="none"),
    )


def seen_of_corner() -> tuple[Floats, NDArray[np.bool_]]:
    """Return points of the corner (row, col, 3), and which lie on the floor."""
    x, z = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
    floor, wall = ABOVE.on_plane(z, 0 * z), ABOVE.on_plane(x, 0 * x)
    on_floor = floor[..., 0] > 0
    return np.where(on_floor[..., None], floor, wall), on_floor


def from_the_other(points: Floats, on_floor: NDArray[np.bool_], side: float) -> Floats:
    """Return the irradiance that the other half of the corner sends to points (n, 3).

    The integral of ``albedo E cos cos / (pi r^2)`` by the midpoint rule on cells of 1 mm.
    """
    up, along = np.mgrid[0.5:side, 0.5 - HALF_WIDTH : HALF_WIDTH]
    up, along, zero = up.ravel(), along.ravel(), np.zeros(up.size)
    received = np.empty(len(points))
    for of_floor in (True, False):
        to, sender = (np.eye(3)[[2, 0]]) if of_floor else np.eye(3)[[0, 2]]
        cells = np.stack([zero, along, up] if of_floor else [up, along, zero], axis=1)
        sent = (WALL if of_floor else FLOOR) * irradiance(cells, sender, LAMP)
        chosen = on_floor == of_floor
        away = cells - points[chosen][:, None]
        square = (away**2).sum(axis=-1)
        kernel = (away @ to) * -(away @ sender) / (np.pi * square**2)
        received[chosen] = kernel @ sent
    return received


def indirect(scene: Scene, *patterns: Pattern, vignetting: float = 0.0) -> Floats:
    """Return the light that is there because of other surfaces."""
    camera = replace(PURE.camera, vignetting=vignetting)

    def images(there: bool) -> Floats:
        setup = pure(camera=camera, recording=Recording(ambient=0, interreflection=there))
        return light_of(prepare(a_rig(ABOVE, LAMP), scene, setup), *patterns)

    return images(True) - images(False)


@pytest.mark.parametrize("side", [70.0, 22.0])
def test_light_between_two_planes(side: float) -> None:
    light = indirect(corner(side), LIGHT)[0]
    points, on_floor = seen_of_corner()
    distance = np.hypot(points[..., 0], points[..., 2])
    # Nearer to the edge 1 mm cells of the quadrature and 4 mm of the coarse grid are too wide.
    chosen = np.zeros(light.shape, bool)
    chosen[::3, ::3] = True
    chosen &= (distance > 6) & (distance < side - 4)
    expected = from_the_other(points[chosen], on_floor[chosen], side)
    measured = light[chosen] / np.where(on_floor, FLOOR, WALL)[chosen]
    ratio = measured / expected
    assert expected.max() > 2 * expected.min()
    # 48 directions, spread evenly: each counts 2 % of the hemisphere; the mean of many points
    # has a random turn for each.
    for part in (on_floor[chosen], ~on_floor[chosen]):
        assert part.sum() > 100
        assert ratio[part].mean() == pytest.approx(1, abs=0.02)
    assert ratio.std() < 0.06
    assert np.abs(ratio - 1).max() < 0.2


def test_light_between_two_planes_fades_towards_the_border() -> None:
    plain = indirect(corner(), LIGHT)[0]
    shaded = indirect(corner(), LIGHT, vignetting=30.0)[0]
    # An absurd fall-off, to see it in a narrow view: cos^120.
    np.testing.assert_allclose(shaded, plain * ABOVE.cosine() ** 120, atol=EXACT)
    assert ABOVE.cosine().min() ** 120 < 0.6


def test_indirect_light_comes_from_where_the_pattern_is() -> None:
    # Bright from the column on that sees the edge of the corner: the floor.
    lamp_u = LAMP.image(np.array([[0.0, y, 0.0] for y in (-40, 0, 40)]))[:, 0]
    half = GrayBit(bit=0, n_bits=1, cell_px=float(lamp_u.mean()) + 0.5)
    assert np.ptp(lamp_u) < 12
    light, all_light = indirect(corner(), half, LIGHT)
    points, on_floor = seen_of_corner()
    far = (np.hypot(points[..., 0], points[..., 2]) > 12) & (np.abs(points[..., 1]) < 15)
    # The column follows the edge to some pixels, so a strip of the wall is lit.
    assert light[far & on_floor].mean() < 0.1 * all_light[far & on_floor].mean()
    assert light[far & ~on_floor].mean() > 0.8 * all_light[far & ~on_floor].mean()


def test_a_single_plane_sends_itself_nothing() -> None:
    scene = Plane(tilt_deg=15).scene()
    assert (indirect(scene, LIGHT, *fringes(PERIOD, 3)) == 0).all()
    # Nor do planes send light through their backs: a wall that looks away from the floor.
    away = replace(corner(), surroundings=quad([0, -60, 0], [0, 0, 70], [0, 120, 0]))
    on_floor = seen_of_corner()[1]
    assert (indirect(away, LIGHT)[0][on_floor] == 0).all()
    # Nor a roof, lit from above, on what it covers.
    roof = quad([-90, -60, 60], [80, 0, 0], [0, 120, 0])
    covered = replace(corner(), surroundings=roof)
    assert (indirect(covered, LIGHT)[0] == 0).all()


# --- 8: edges -----------------------------------------------------------------------------------

OVERHEAD = Pinhole(place=(0, 0, 300), focal=(400, 400), size=(96, 80), center=(47, 41))


def edge(height: float, slope: float, *, turn: bool = False) -> Scene:
    """Return a bright half of a plane, x < slope y, beside a dark one; exchange x and y if asked.

    Seen from overhead, the edge lies at column 47 - slope (row - 41), or at row
    41 - slope (column - 47), whatever the height.
    """
    along = np.array([slope, 1.0, 0.0])
    start = np.array([0, 0, height]) - 200 * along
    halves = (
        quad(start - [200, 0, 0], [200, 0, 0], 400 * along),
        quad(start, [200, 0, 0], 400 * along),
    )
    if turn:  # the reversed faces keep the normals up
        halves = (_exchanged(halves[0]), _exchanged(halves[1]))
    return Scene(
        thing=halves[0],
        surface=Surface(albedo=0.8),
        surroundings=halves[1],
        background=Surface(albedo=0.22, texture="none"),
    )


def _exchanged(mesh: Mesh) -> Mesh:
    return Mesh(vertices_mm=mesh.vertices_mm[:, [1, 0, 2]], faces=mesh.faces[:, ::-1])


def darkness(scene: Scene, camera: CameraOptics = PURE.camera, *, n_rays: int = 16) -> Floats:
    """Return 0 on the bright side, 1 on the dark one; in ambient light alone, which is even."""
    setup = pure(camera=camera, recording=Recording(ambient=1.0), n_rays=n_rays)
    image = light_of(prepare(a_rig(OVERHEAD), scene, setup), DARK)[0]
    return np.asarray((0.8 - image) / 0.58)


SLOPE = 11 / 80
"""Eighty rows pass through all fractions of a pixel, in equal steps."""


def assert_spread(dark: Floats, variance: float, *, turn: bool) -> None:
    """Check where the edge lies and how far it is spread along the rows (or the columns).

    Differences of neighbouring pixels are the line spread of lens and pixel (1/12 px^2), on the
    grid of the pixels (1/12 px^2 once more). A sloping cut through the edge sees a spread along
    the edge as well, slope^2 of it.
    """
    profile = dark.T[:, ::-1] if turn else dark
    n_lines, n_pixels = profile.shape
    lines = np.arange(n_lines)
    place = n_pixels - 1 - 41 + SLOPE * (lines - 47) if turn else 47 - SLOPE * (lines - 41)
    whole = slice(0, 80)
    away = (np.arange(n_pixels - 1) + 0.5 - place[:, None])[whole]
    # Far away squares would raise the rounding of grey values above the spread.
    spread = np.where(np.abs(away) < 15, np.diff(profile, axis=1)[whole], 0)
    np.testing.assert_allclose(spread.sum(axis=1), 1, atol=2 * EXACT)
    # Each of the rays crosses the edge between two pixels; all fractions of a pixel occur.
    assert (spread * away).sum(axis=1).mean() == pytest.approx(0, abs=0.02)
    expected = (1 + SLOPE**2) * (variance + 1 / 12) + 1 / 12
    assert (spread * away**2).sum(axis=1).mean() == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize(
    ("height", "aperture", "focus", "n_rays"),
    [
        (0, 0, 0, 16),
        (0, 40, 0, 16),
        (0, 40, 0, 9),
        (30, 40, 0, 16),
        (-40, 50, 0, 16),
        (0, 50, 330, 16),
        (0, 50, 270, 9),
        (30, 50, 270, 16),
    ],
)
def test_aperture_spreads_an_edge(
    height: float, aperture: float, focus: float, n_rays: int, turn: bool
) -> None:
    camera = replace(PURE.camera, aperture_mm=aperture, focus_mm=focus)
    dark = darkness(edge(height, SLOPE, turn=turn), camera, n_rays=n_rays)
    disc = aperture * 400 * abs(1 / (300 - height) - 1 / (focus or 300))
    assert_spread(dark, disc**2 / 16, turn=turn)


@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize("blur", [0.7, 1.0, 2.0])
def test_blur_of_the_camera_spreads_an_edge(blur: float, turn: bool) -> None:
    dark = darkness(edge(0, SLOPE, turn=turn), replace(PURE.camera, blur_px=blur))
    assert_spread(dark, blur**2, turn=turn)


@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize("slope", [0.0131, 0.31, 0.83])
def test_pixel_mixes_by_area(slope: float, turn: bool) -> None:
    dark = darkness(edge(0, slope, turn=turn))
    # The share of each pixel beyond the edge, on a grid of 40 x 40 points.
    fine = (np.arange(40) + 0.5) / 40 - 0.5
    row = np.arange(80)[:, None, None, None] + fine[:, None]
    col = np.arange(96)[None, :, None, None] + fine
    beyond = row < 41 - slope * (col - 47) if turn else col > 47 - slope * (row - 41)
    area = beyond.mean(axis=(2, 3))
    mixed = (area > 0) & (area < 1)
    assert mixed.sum() > 75
    error = (dark - area)[mixed]
    assert abs(error.mean()) < 0.01
    # A column of four rays passes an upright edge at once: steps of a quarter, rms 1/4 / sqrt(12).
    assert error.std() < (1 / 16 if slope > 0.1 else 0.08)
    # Sixteen rays in columns of four: an upright edge passes four at once, between them 1/8,
    # and the grid is 3 % wider than even spacing to keep the variance of the area.
    assert np.abs(error).max() < 0.15
    assert np.abs((dark - area)[~mixed]).max() < EXACT


@pytest.mark.parametrize("blur", [0.2, 0.3, 0.4, 0.5, 0.69, 0.72, 1.0, 2.0])
def test_the_lens_blur_has_the_variance_as_set(blur: float) -> None:
    """Of a bright point; 16 bits resolve its wings. OpenCV cuts its kernel at 3 to 4 sigma."""
    light = np.zeros((41, 41), np.float32)
    light[20, 20] = 1.0
    optics = CameraOptics(bit_depth=16, black_level_dn=0, full_well_e=1e12, read_noise_e=0,
                          exposure=1.0, blur_px=blur)  # fmt: skip
    spread = expose(light, optics, np.random.default_rng(0), np.zeros_like(light)).astype(float)
    offsets = np.arange(41) - 20.0
    for axis in (0, 1):
        profile = spread.sum(axis=axis) / spread.sum()
        assert profile @ offsets == pytest.approx(0, abs=1e-6)
        assert profile @ offsets**2 == pytest.approx(blur**2, rel=0.03, abs=1e-4)


@pytest.mark.parametrize("n_rays", [1, 4])
def test_an_open_aperture_needs_rays_to_fill_it(n_rays: int) -> None:
    with pytest.raises(ValueError, match=r"aperture_mm: expected at least 9 rays .* found \d"):
        Setup(camera=CameraOptics(aperture_mm=2.0), n_rays=n_rays)
