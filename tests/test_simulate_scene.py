"""Ray casting, shadows, truth maps, presets and scenes of the simulator, against closed forms.

Rays and projections are computed here once more with plain formulas or OpenCV, so that the
simulator is not its own judge. What the images look like (noise, blur, gamma) is tested elsewhere.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

import closed_form
from closed_form import SphereScene, demo_rig
from cv_lens import cv_project, cv_rays
from fringe3d.model import Device, Rig, RigidTransform, Scan
from fringe3d.patterns import method_plan
from fringe3d.pipeline import measure

pytest.importorskip("embreex")
trimesh = pytest.importorskip("trimesh")

from scipy.spatial.transform import Rotation  # noqa: E402

from fringe3d.simulate import (  # noqa: E402
    OBJECTS,
    PRESETS,
    Mesh,
    Preset,
    Scene,
    Stage,
    Surface,
    Truth,
    from_file,
    prepare,
    record,
    turntable,
)
from fringe3d.simulate.caster import Caster, Hits  # noqa: E402
from fringe3d.simulate.mesh import FLAT, join  # noqa: E402
from fringe3d.simulate.objects import plane, sphere  # noqa: E402
from fringe3d.simulate.scene import table  # noqa: E402
from fringe3d.simulate.truth import trace  # noqa: E402

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Points are computed in double precision: 1e-16 of 1 m, magnified by grazing rays.
POINT_MM = 1e-6
# The same in pixels: 10 px to a millimetre.
PIXEL = 1e-5
SEED = 20261122


# Oracles: OpenCV and school geometry


def pixels_of(device: Device, points: Floats) -> Floats:
    """Project points (..., 3) with OpenCV; NaN stays NaN."""
    pixels = np.full((*points.shape[:-1], 2), np.nan)
    known = np.isfinite(points).all(axis=-1)
    pixels[known] = cv_project(device, points[known])
    return pixels


def in_image(device: Device, pixels: Floats) -> Bools:
    limit = np.array([device.n_cols, device.n_rows]) - 0.5
    with np.errstate(invalid="ignore"):
        return np.asarray(((pixels >= -0.5) & (pixels <= limit)).all(axis=-1))


def in_cylinder(preset: Preset, points: Floats, enlarged: float = 1.0) -> Bools:
    """Tell which points lie in the upright cylinder about the origin."""
    x, y, z = np.moveaxis(points, -1, 0)
    with np.errstate(invalid="ignore"):
        return np.asarray(
            (np.hypot(x, y) <= enlarged * preset.diameter_mm / 2)
            & (np.abs(z) <= preset.height_mm / 2)
        )


def unit(vectors: ArrayLike) -> Floats:
    vectors = np.asarray(vectors, np.float64)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def angle_deg(a: Floats, b: Floats) -> float:
    return float(np.degrees(np.arccos(unit(a) @ unit(b))))


def from_above(targets: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return origins 200 to 500 mm above the ground and unit directions to targets."""
    n = len(targets)
    heights = rng.uniform(200, 500, n)
    origins = np.column_stack([*rng.uniform(-200, 200, (2, n)), heights])
    return origins, unit(targets - origins)


def quad(*corners: tuple[float, float, float]) -> Mesh:
    """Return two triangles, counter-clockwise as the corners are."""
    return Mesh(
        vertices_mm=np.array(corners, np.float64),
        faces=np.array([(0, 1, 2), (0, 2, 3)], np.int32),
    )


# Ray casting


def test_rays_meet_a_plane_where_the_formula_says() -> None:
    """A parallelogram in space; its edges are told by the coordinates along its sides."""
    rng = np.random.default_rng(SEED)
    corner, a, b = np.array([-31.0, -22.0, 3.0]), np.array([60.0, 4, 11]), np.array([-7.0, 47, -5])
    mesh = quad(*(tuple(corner + i * a + j * b) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))))
    share = rng.uniform(-0.3, 1.3, (5000, 2))
    origins, directions = from_above(corner + share @ np.array([a, b]), rng)
    hits = Caster(mesh).cast(origins, directions)

    # Single precision decides what is hit: 1e-4 of the side is far beyond it.
    clear = np.abs(share[..., None] - [0.0, 1.0]).min(axis=(1, 2)) > 1e-4
    expected: Bools = np.all((share > 0) & (share < 1), axis=1)
    np.testing.assert_array_equal(hits.is_hit[clear], expected[clear])
    assert 1500 < hits.is_hit.sum() < 2500
    normal = unit(np.cross(a, b))
    distance = ((corner - origins) @ normal) / (directions @ normal)
    hit = hits.is_hit
    points = origins + distance[:, None] * directions
    np.testing.assert_allclose(hits.points_mm[hit], points[hit], rtol=0, atol=POINT_MM)
    np.testing.assert_allclose(hits.normals[hit], normal[None].repeat(hit.sum(), 0), atol=1e-12)
    assert np.isnan(hits.points_mm[~hit]).all()
    assert np.isnan(hits.normals[~hit]).all()
    assert (hits.face[~hit] == -1).all()


def test_rays_meet_the_tilted_plane_object_where_its_angles_say() -> None:
    tilt, azimuth = np.radians([12.0, 35.0])
    normal = np.array([-np.sin(tilt) * np.cos(azimuth), -np.sin(tilt) * np.sin(azimuth),
                       np.cos(tilt)])  # fmt: skip
    mesh = plane(tilt_deg=12.0, azimuth_deg=35.0)
    offset = (mesh.vertices_mm @ normal).max()  # the top supports the body in this direction
    rng = np.random.default_rng(SEED)
    targets = np.column_stack([*rng.uniform(-18, 18, (2, 2000)), np.full(2000, 5.0)])
    origins, directions = from_above(targets, rng)
    hits = Caster(mesh).cast(origins, directions)
    top = hits.normals @ normal > 0.9
    assert top.mean() > 0.95  # the others come from the side
    distance = (offset - origins @ normal) / (directions @ normal)
    points = origins + distance[:, None] * directions
    # Vertices of solids are rounded to 1e-8 mm or so; the plane through them is as good.
    np.testing.assert_allclose(hits.points_mm[top], points[top], rtol=0, atol=POINT_MM)
    np.testing.assert_allclose(hits.normals[top], normal[None].repeat(top.sum(), 0), atol=1e-7)


def test_rays_meet_a_sphere_itself_not_its_facets() -> None:
    rng = np.random.default_rng(SEED)
    mesh = sphere(radius_mm=10.0).moved(
        RigidTransform(
            rotation=Rotation.from_rotvec([0.4, -0.9, 0.3]).as_matrix(), translation=[3, -5, 7]
        )
    )
    center = mesh.spheres[0, :3]
    targets = center + 11.0 * unit(rng.standard_normal((6000, 3)))
    origins, directions = from_above(targets, rng)
    hits = Caster(mesh).cast(origins, directions)

    # |o + t d - c| = r, solved for the smaller t.
    half_b = ((origins - center) * directions).sum(axis=1)
    c = ((origins - center) ** 2).sum(axis=1) - 100.0
    root = half_b**2 - c
    # Facets lie up to 2 um below the sphere: rays that pass the rim nearer than that may miss.
    clear = np.abs(np.sqrt(100.0 - root) - 10.0) > 0.003
    np.testing.assert_array_equal(hits.is_hit[clear], root[clear] > 0)
    hit = hits.is_hit
    assert 3000 < hit.sum() < 5900
    points = origins[hit] + (-half_b[hit] - np.sqrt(root[hit]))[:, None] * directions[hit]
    # The root loses half the digits at the rim: 1e-10 of 5e5 mm^2 there, here less.
    steep = root[hit] > 1.0
    np.testing.assert_allclose(hits.points_mm[hit][steep], points[steep], rtol=0, atol=POINT_MM)
    distance = np.linalg.norm(hits.points_mm[hit] - center, axis=1)
    np.testing.assert_allclose(distance, 10.0, rtol=0, atol=POINT_MM)
    np.testing.assert_allclose(
        hits.normals[hit], unit(hits.points_mm[hit] - center), rtol=0, atol=1e-9
    )


def test_rays_through_edges_and_corners_of_triangles_do_not_leak() -> None:
    """A fan of triangles around a corner; rays aim exactly at inner edges and at the corner."""
    angles = np.linspace(0, 2 * np.pi, 14)[:-1]
    rim = np.column_stack([30 * np.cos(angles), 30 * np.sin(angles), 0.1 * np.arange(13)])
    corners = np.vstack([[0.3, -0.7, 4.0], rim])
    faces = [(0, 1 + i, 1 + (i + 1) % 13) for i in range(13)]
    fan = Mesh(vertices_mm=corners, faces=np.array(faces, np.int32))
    rng = np.random.default_rng(SEED)
    share = np.r_[np.zeros(200), rng.uniform(0, 0.98, 20_000)]
    edge = rng.integers(1, 14, len(share))
    origins, directions = from_above(corners[0] + share[:, None] * (corners[edge] - corners[0]),
                                     rng)  # fmt: skip
    assert Caster(fan).cast(origins, directions).is_hit.all()


def test_directions_without_a_number_hit_nothing() -> None:
    """Pixels beyond the fold of a lens have no ray."""
    directions = np.array([[0, 0, -1.0], [np.nan, 0, -1], [np.nan] * 3, [0, 0, -1.0]])
    square = quad((-10, -10, 0), (10, -10, 0), (10, 10, 0), (-10, 10, 0))
    hits = Caster(square).cast(np.array([1.0, 2.0, 50.0]), directions)
    np.testing.assert_array_equal(hits.is_hit, [True, False, False, True])
    np.testing.assert_array_equal(np.isfinite(hits.points_mm).all(axis=1), hits.is_hit)


def test_a_surface_is_seen_from_its_front_and_not_through_others() -> None:
    ground = quad((-50, -50, 0), (50, -50, 0), (50, 50, 0), (-50, 50, 0))
    screen = quad((0, -50, 20), (50, -50, 20), (50, 50, 20), (0, 50, 20))
    caster = Caster(join([ground, screen]))
    x = np.linspace(-45, 45, 181)
    points = np.column_stack([x, np.zeros_like(x), np.zeros_like(x)])
    up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    place = np.array([10.0, 0.0, 200.0])
    # The ray to the place crosses z = 20 at a tenth of its way.
    crossing = x + 0.1 * (place[0] - x)
    clear = np.abs(crossing) > 0.01
    seen = caster.sees(points, up, place)
    np.testing.assert_array_equal(seen[clear], (crossing < 0)[clear])
    assert not caster.sees(points, -up, place).any()


# Occlusion and shadow


@pytest.fixture(scope="module")
def ball_scene() -> tuple[Rig, SphereScene, Scene]:
    """Return a rig and one scene twice: in closed form, and as meshes."""
    exact = SphereScene()
    lowest = np.array(exact.center_mm) - [0.0, 0.0, exact.radius_mm]
    meshes = Scene(
        thing=sphere(radius_mm=exact.radius_mm),
        world_from_object=RigidTransform(rotation=np.eye(3), translation=lowest),
        surroundings=table(height_mm=exact.plane_z_mm, width_mm=600.0),
    )
    return demo_rig(camera_size=(320, 256)), exact, meshes


def rim(mask: Bools) -> Bools:
    """Return the pixels next to the border of a region."""
    kernel, image = np.ones((3, 3), np.uint8), mask.astype(np.uint8)
    return np.asarray(cv2.dilate(image, kernel) != cv2.erode(image, kernel))


@pytest.mark.parametrize("number", [0, 1])
def test_points_and_shadows_are_those_of_the_closed_form(
    ball_scene: tuple[Rig, SphereScene, Scene], number: int
) -> None:
    rig, exact, meshes = ball_scene
    camera, other = rig.cameras[number], rig.cameras[1 - number]
    assert rig.projector is not None
    found = trace(camera, rig, meshes)
    expected = closed_form.trace(camera, rig.projector, exact)

    np.testing.assert_array_equal(
        found.is_object[~rim(expected.on_sphere)], expected.on_sphere[~rim(expected.on_sphere)]
    )
    same = found.is_object == expected.on_sphere
    # Facets are up to 2 um inside the sphere, which is a hundredth of a pixel here.
    assert (~same).sum() <= 3
    for name in ("points_mm", "projector_xy"):
        np.testing.assert_allclose(
            getattr(found, name)[same], getattr(expected, name)[same], rtol=0, atol=POINT_MM
        )
    slipped = found.lit != expected.lit
    assert not (slipped & ~rim(expected.lit)).any()
    assert slipped.sum() <= 3
    assert (~expected.lit).sum() > 500

    seen = in_image(other, pixels_of(other, expected.points_mm))
    seen &= closed_form.sees(other, expected.points_mm, exact)
    slipped = found.seen_by[other.name] != seen
    assert not (slipped & ~rim(seen) & ~rim(expected.on_sphere)).any()
    assert slipped.sum() <= 3
    assert (~seen).sum() > 500


# Truth maps of every preset

SMALL = (160, 128)


@pytest.fixture(scope="module", params=PRESETS)
def small(request: pytest.FixtureRequest) -> tuple[Preset, list[Truth]]:
    """Return each preset with small cameras, and its truths for two bodies on a table."""
    preset = PRESETS[request.param](SMALL)
    scene = preset.scene(OBJECTS["two-bodies"]())
    return preset, [trace(camera, preset.rig, scene) for camera in preset.rig.cameras]


def test_true_points_project_to_the_true_pixels(small: tuple[Preset, list[Truth]]) -> None:
    preset, truths = small
    assert preset.rig.projector is not None
    row, col = np.mgrid[: SMALL[1], : SMALL[0]]
    centres = np.stack([col, row], axis=-1).astype(np.float64)
    for camera, truth in zip(preset.rig.cameras, truths, strict=True):
        hit = np.isfinite(truth.points_mm).all(axis=-1)
        assert hit.mean() > 0.99  # the table fills the view
        maps = {camera.name: centres, "projector": truth.projector_xy, **truth.pixels}
        assert set(maps) == {device.name for device in preset.rig.devices}
        for device in preset.rig.devices:
            expected = pixels_of(device, truth.points_mm)
            np.testing.assert_allclose(maps[device.name][hit], expected[hit], rtol=0, atol=PIXEL)
        length = np.linalg.norm(truth.normals, axis=-1)[hit]
        np.testing.assert_allclose(length, 1.0, atol=1e-12)
        to_camera = camera.center_world - truth.points_mm
        assert ((to_camera * truth.normals).sum(axis=-1)[hit] > 0).all()


def test_points_in_the_volume_lie_in_the_cylinder(small: tuple[Preset, list[Truth]]) -> None:
    """The volume is a prism of 64 sides around the cylinder: 0.12 % wider at its edges."""
    preset, truths = small
    for truth in truths:
        points = truth.points_mm
        surely = in_cylinder(preset, points)
        assert truth.in_volume[surely].all()
        assert not truth.in_volume[~in_cylinder(preset, points, 1 / np.cos(np.pi / 64))].any()
        # Undecided: next to the mantle, where no object reaches.
        assert (truth.in_volume != surely).mean() < 0.002
        assert 0.01 < surely.mean() < 0.9
        # The table lies outside, all of it.
        assert (truth.is_object | ~truth.in_volume).all()


def test_each_camera_sees_what_the_other_says_it_sees(small: tuple[Preset, list[Truth]]) -> None:
    """Seen: the other camera's point at that pixel is the same; hidden: it is a nearer one.

    Compared where the surface is smooth around the other camera's pixel; the rest is edges.
    """
    preset, truths = small
    if len(truths) == 1:
        assert not truths[0].pixels
        assert not truths[0].seen_by
        return
    for here, there in (truths, truths[::-1]):
        camera = next(c for c in preset.rig.cameras if c.name == there.device_name)
        pixels, seen = here.pixels[camera.name], here.seen_by[camera.name]
        nearest = np.nan_to_num(np.rint(pixels), nan=-9)
        inside = in_image(camera, nearest)
        assert not seen[~in_image(camera, pixels)].any()
        col, row = nearest[inside].astype(np.intp).T
        ranges = np.linalg.norm(there.points_mm - camera.center_world, axis=-1).astype(np.float32)
        kernel = np.ones((3, 3), np.uint8)
        low, high = cv2.erode(ranges, kernel)[row, col], cv2.dilate(ranges, kernel)[row, col]
        own = np.linalg.norm(here.points_mm[inside] - camera.center_world, axis=-1)
        # Between pixel centres a smooth surface leaves the range of its neighbours by less than
        # that range.
        margin = high - low + 1e-3
        smooth = margin < 0.01 * ranges.mean()
        assert smooth.mean() > 0.8
        behind = own > high + margin
        assert not (own < low - margin)[smooth].any()  # or the other camera would have met it
        assert not (seen[inside] & behind & smooth).any()
        # Hidden and not behind: only at a body's rim, between the centres of pixels.
        unexplained = ~seen[inside] & ~behind & smooth
        assert unexplained.sum() < 0.002 * smooth.sum()
        assert (behind & smooth).sum() > 100
        assert seen.mean() > 0.4


# A measured scan agrees with its truth


@pytest.fixture(scope="module")
def measured() -> tuple[Stage, Scan]:
    """Return two bodies on `kolibri` by the images of M1, cameras of 320 x 256 px.

    Fringes of 24 px: at half the resolution of the preset's own cameras, 16 px would be coded
    in cells of 3 camera pixels.
    """
    preset = PRESETS["kolibri"]((320, 256))
    assert preset.rig.projector is not None
    plan = method_plan("m1", preset.rig.projector.shape, period_px=24.0, n_shifts=4)
    stage = prepare(preset.rig, preset.scene(OBJECTS["two-bodies"]()))
    return stage, record(stage, plan, seed=SEED)


def test_measured_points_agree_with_the_truth(measured: tuple[Stage, Scan]) -> None:
    stage, scan = measured
    truth, camera = stage.truths[0], stage.rig.cameras[0]
    cloud = measure(scan).points
    assert cloud is not None
    reference = truth.lit & truth.in_volume & truth.seen_by["c2"]
    assert reference.sum() > 15_000
    good = cloud.is_valid & reference
    assert good.sum() >= 0.95 * reference.sum()
    error = cloud.points_mm - truth.points_mm
    wrong = np.linalg.norm(error, axis=-1) > 0.5
    assert (wrong & good).sum() < 0.005 * good.sum()
    assert (wrong & cloud.is_valid).sum() < 0.005 * cloud.is_valid.sum()

    # Where light of two surfaces mixes (2 px from a jump of 2 mm) noise is not the question.
    height = truth.points_mm[..., 2].astype(np.float32)
    kernel = np.ones((5, 5), np.uint8)
    smooth = cv2.dilate(height, kernel) - cv2.erode(height, kernel) < 2.0
    smooth &= cv2.erode(reference.astype(np.uint8), kernel) > 0
    along = (error * unit(truth.points_mm - camera.center_world)).sum(axis=-1)
    pull = (along / cloud.sigma_mm)[good & smooth]
    spread = float(1.4826 * np.median(np.abs(pull)))
    # 1 by the noise alone; curvature and interpolation in C2 add some percent. 14,000 pixels
    # tell it to 1 %.
    assert 0.9 < spread < 1.15
    assert 0.9 < float(pull.std()) < 1.15
    assert abs(float(np.median(pull))) < 0.15


# Presets reproduce the numbers of their design


def segments(preset: Preset) -> Floats:
    """Return how many fringe periods lie on each viewing ray of C1 within the cylinder.

    Rays of a grid of pixels that includes the border; 1000 samples on each. Points need not be
    in view of the other devices, which is the cautious side.
    """
    camera, projector = preset.rig.cameras[0], preset.rig.projector
    assert projector is not None
    x, y = np.meshgrid(np.linspace(-0.5, camera.n_cols - 0.5, 25),
                       np.linspace(-0.5, camera.n_rows - 0.5, 21))  # fmt: skip
    center, directions = cv_rays(camera, np.column_stack([x.ravel(), y.ravel()]))
    reach = np.hypot(preset.diameter_mm, preset.height_mm)
    along = np.linalg.norm(center) + np.linspace(-reach, reach, 1000)
    points = center + along[:, None] * directions[:, None]
    inside = in_cylinder(preset, points)
    w = pixels_of(projector, points)[..., 0] / preset.period_px
    span = np.where(inside, w, -np.inf).max(axis=1) - np.where(inside, w, np.inf).min(axis=1)
    return np.asarray(span[inside.any(axis=1)])


def test_kolibri_reproduces_the_paper() -> None:
    """Angles, depths along the principal ray and periods of DESIGN, section 4."""
    preset = PRESETS["kolibri"]((640, 512))
    c1, c2 = preset.rig.cameras
    projector = preset.rig.projector
    assert projector is not None
    # The design's own rounding.
    assert angle_deg(c1.center_world, c2.center_world) == pytest.approx(27.0, abs=0.05)
    for camera in (c1, c2):
        tau = angle_deg(camera.center_world, projector.center_world)
        assert tau == pytest.approx(13.6, abs=0.05)
    for device in preset.rig.devices:
        assert np.linalg.norm(device.center_world) == pytest.approx(335.0)
        x, y = pixels_of(device, np.zeros((1, 3)))[0]
        np.testing.assert_allclose([x, y], device.center_px, atol=1e-9)  # it looks at the origin
    depths = np.linspace(300, 370, 70_001)
    ray = c1.center_world - depths[:, None] * unit(c1.center_world)
    inside = depths[in_cylinder(preset, ray)]
    assert [inside.min(), inside.max()] == pytest.approx([321, 349], abs=0.05)
    assert projector.shape == (768, 1024)
    assert projector.focal_px[0] == pytest.approx(64.3 / 0.020)
    assert (preset.period_px, preset.diameter_mm, preset.height_mm) == (16.0, 80.0, 25.0)
    # "at most 4.1", told to 0.1.
    assert 4.05 < segments(preset).max() < 4.15


def test_kolibri_m5_has_less_than_one_period_on_every_segment() -> None:
    guard = 0.04
    assert 0.8 < segments(PRESETS["kolibri-m5"](SMALL)).max() < 1 - 2 * guard


@pytest.mark.parametrize("name", PRESETS)
def test_the_reduced_code_tells_the_periods_on_a_segment_apart(name: str) -> None:
    """2^n classes for m periods; the paper's rig exceeds them by a tenth in some corners."""
    preset = PRESETS[name](SMALL)
    assert segments(preset).max() < 2**preset.reduced_bits + 0.15


def wrong_order_residuals(preset: Preset, slope_deg: float, n_points: int) -> Floats:
    """Return the phase residuals in C2, periods, that wrong fringe orders leave on planes.

    A wrong order moves a point X along C1's ray to X_j. C2 looks there, and its ray meets the
    plane at Y. The phase it sees there differs from that of X_j, modulo a period, by r_j.
    Points, moved points and what C2 sees lie in the measuring volume.
    """
    rng = np.random.default_rng(SEED)
    c1, c2 = preset.rig.cameras
    projector = preset.rig.projector
    assert projector is not None

    def periods(points: Floats) -> Floats:
        return np.asarray((pixels_of(projector, points)[..., 0] + 0.5) / preset.period_px)

    radius = preset.diameter_mm / 2 * np.sqrt(rng.random(n_points))
    turn, lean = 2 * np.pi * rng.random((2, n_points))
    height = preset.height_mm * (rng.random(n_points) - 0.5)
    points = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
    slope = np.radians(slope_deg)
    normals = np.column_stack(
        [
            np.sin(slope) * np.cos(lean),
            np.sin(slope) * np.sin(lean),
            np.full(n_points, np.cos(slope)),
        ]
    )
    directions = unit(points - c1.center_world)
    steps = np.linspace(-90, 90, 1001)
    phases = periods(points[:, None] + steps[None, :, None] * directions[:, None])
    own = periods(points)
    sign = np.sign(phases[:, -1] - phases[:, 0])
    found = []
    for j in [j for j in range(-9, 10) if j]:
        travel = np.array(
            [np.interp(s * (o + j), s * p, steps, np.nan, np.nan)
             for o, s, p in zip(own, sign, phases, strict=True)]
        )  # fmt: skip
        moved = points + travel[:, None] * directions
        sight = moved - c2.center_world
        part = ((points - c2.center_world) * normals).sum(axis=1) / (sight * normals).sum(axis=1)
        met = c2.center_world + part[:, None] * sight
        possible = in_cylinder(preset, moved) & in_cylinder(preset, met)
        gap = (periods(met) - own)[possible]
        found.append(np.abs(gap - np.rint(gap)))
    return np.concatenate(found)


def test_designed_has_no_wrong_order_in_the_volume() -> None:
    """Its segments hold less than a period; `wrong_order_residuals` finds none to judge."""
    designed = PRESETS["designed"](SMALL)
    assert designed.fringe_angle == pytest.approx(np.radians(20.3))
    assert designed.rig.projector is not None
    rng = np.random.default_rng(0)
    height = rng.uniform(-12.4, 12.4, 400)
    around, out = rng.uniform(0, 2 * np.pi, 400), 39.0 * np.sqrt(rng.uniform(0, 1, 400))
    points = np.column_stack([out * np.cos(around), out * np.sin(around), height])
    eye = designed.rig.cameras[0].center_world
    assert designed.rig.volume is not None
    for point in points:  # other points of the volume on the same viewing ray
        ray = (point - eye) / np.linalg.norm(point - eye)
        others = point + np.linspace(-60, 60, 241)[:, None] * ray
        others = others[designed.rig.volume.contains(others)]
        u, v = pixels_of(designed.rig.projector, others).T
        w = np.cos(designed.fringe_angle) * u + np.sin(designed.fringe_angle) * v
        assert np.ptp(w) < designed.period_px


def test_kolibri_lets_wrong_orders_pass() -> None:
    """A projector in the middle: planes that face the rig fit with every order.

    DESIGN: 0.026 periods for the first wrong order; the others leave multiples of it.
    """
    preset = PRESETS["kolibri"](SMALL)
    flat = wrong_order_residuals(preset, 0.0, 300)
    assert flat.min() < 0.03
    assert np.median(flat) < 0.06
    assert wrong_order_residuals(preset, 20.0, 300).min() < 0.01


def test_wide_depth_and_face_have_their_sizes() -> None:
    wide, face = PRESETS["wide-depth"]((640, 512)), PRESETS["face"]((640, 512))
    for camera in wide.rig.cameras:  # all at one height above the table
        top = camera.center_world[2] - wide.height_mm / 2
        assert [top, top + wide.height_mm] == pytest.approx([400.0, 700.0])
    assert face.diameter_mm == 500.0
    rim_points = 250.0 * np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    for camera in face.rig.cameras:
        assert in_image(camera, pixels_of(camera, rim_points)).all()


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("thing", ["plane", "machine-part"])
def test_top_of_an_object_lies_in_the_volume(name: str, thing: str) -> None:
    """Its foot may lie below, with the table."""
    preset = PRESETS[name](SMALL)
    scene = preset.scene(OBJECTS[thing]())
    top = scene.world_from_object.apply(scene.thing.vertices_mm)[:, 2].max()
    assert abs(top) < 0.5 * preset.height_mm - 0.01 * preset.height_mm


def test_single_has_one_camera() -> None:
    preset = PRESETS["single"](SMALL)
    assert [device.name for device in preset.rig.devices] == ["c1", "projector"]


@pytest.mark.parametrize("name", PRESETS)
def test_every_device_sees_the_volume(name: str) -> None:
    """The middle and nearly all of the rest; images are rectangles, the volume is round."""
    preset = PRESETS[name]((640, 512))
    rng = np.random.default_rng(SEED)
    radius, turn = np.sqrt(rng.random(4000)), 2 * np.pi * rng.random(4000)
    points = np.column_stack(
        [preset.diameter_mm / 2 * radius * np.cos(turn),
         preset.diameter_mm / 2 * radius * np.sin(turn),
         preset.height_mm * (rng.random(4000) - 0.5)]
    )  # fmt: skip
    for device in preset.rig.devices:
        seen = in_image(device, pixels_of(device, points))
        assert seen.mean() > 0.95
        assert seen[radius < 0.75].all()


# Meshes


def painted(value: float) -> Mesh:
    """Return a square whose albedo rises linearly from `value`."""
    square = quad((0, 0, 0), (10, 0, 0), (10, 10, 0), (0, 10, 0))
    x, y, _ = square.vertices_mm.T
    return Mesh(
        vertices_mm=square.vertices_mm,
        faces=square.faces,
        albedo=np.asarray(value + 0.01 * x + 0.02 * y, np.float32),
    )


def test_joined_meshes_keep_faces_spheres_and_brightness() -> None:
    first = sphere(radius_mm=4.0)
    second = sphere(radius_mm=7.0).moved(
        RigidTransform(rotation=np.eye(3), translation=[30.0, 0.0, 0.0])
    )
    whole = join([first, painted(0.1), second])
    assert whole.n_vertices == first.n_vertices + 4 + second.n_vertices
    np.testing.assert_allclose(whole.spheres, [[0, 0, 4, 4], [30, 0, 7, 7]], atol=1e-12)
    assert whole.albedo is not None
    assert np.isnan(whole.albedo[: first.n_vertices]).all()
    assert np.isfinite(whole.albedo[first.n_vertices : first.n_vertices + 4]).all()
    caster = Caster(whole)
    down = np.broadcast_to([0.0, 0.0, -1.0], (3, 3))
    places = np.array([[0.5, 1.0, 50.0], [5.0, 6.0, 50.0], [31.0, 2.0, 50.0]])
    hits = caster.cast(places, down)
    tops = [4 + np.sqrt(16 - 1.25), 0.0, 7 + np.sqrt(49 - 5)]
    np.testing.assert_allclose(hits.points_mm[:, 2], tops, atol=POINT_MM)
    # Single precision of a brightness.
    np.testing.assert_allclose(hits.albedo, [np.nan, 0.1 + 0.05 + 0.12, np.nan], atol=1e-6)
    assert join([first, second]).albedo is None


def test_moved_and_scaled_meshes_take_their_spheres_along() -> None:
    pose = RigidTransform(
        rotation=Rotation.from_rotvec([0.2, 0.5, -1.1]).as_matrix(), translation=[5.0, -3.0, 80.0]
    )
    mesh = sphere(radius_mm=6.0).moved(pose).scaled(2.5)
    center, radius = mesh.spheres[0, :3], mesh.spheres[0, 3]
    np.testing.assert_allclose(center, 2.5 * pose.apply([0.0, 0.0, 6.0]), atol=1e-9)
    assert radius == 15.0
    assert (mesh.sphere_of_face != FLAT).any()
    on_sphere = mesh.vertices_mm[mesh.faces[mesh.sphere_of_face != FLAT]]
    np.testing.assert_allclose(np.linalg.norm(on_sphere - center, axis=-1), radius, atol=1e-6)
    assert painted(0.2).moved(pose).scaled(3.0).albedo is not None


def test_faces_on_a_sphere_stand_for_it_and_others_do_not() -> None:
    """An octahedron with one corner pulled out: four of its faces are not on the sphere."""
    corners = np.vstack([np.eye(3), -np.eye(3)]) * 5.0
    corners[2, 2] = 6.0
    faces = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
    body = Mesh(vertices_mm=corners, faces=np.array(faces, np.int32)).with_sphere([0, 0, 0], 5.0)
    np.testing.assert_array_equal(body.sphere_of_face, [FLAT] * 4 + [0] * 4)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((3, 3)), [(0, 1, 3)], "a face names a vertex that does not exist"),
        (np.zeros((3, 3)), [(0, 1, -1)], "a face names a vertex that does not exist"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [(0, 1, 2)], "expected finite vertices"),
    ],
)
def test_impossible_meshes_are_refused(
    vertices: ArrayLike, faces: list[tuple[int, ...]], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Mesh(vertices_mm=np.asarray(vertices, np.float64), faces=np.array(faces, np.int32))


# Scenes


@pytest.mark.parametrize("texture", ["mottled", "checker", "speckle"])
def test_a_texture_moves_with_the_object_and_not_with_the_table(texture: str) -> None:
    surface = Surface(albedo=0.6, texture=texture, texture_mm=2.3, contrast=0.5, gloss=0.2)
    background = Surface(albedo=0.4, texture=texture, contrast=0.3)
    thing = quad((-20, -20, 1), (20, -20, 1), (20, 20, 1), (-20, 20, 1))
    scene = Scene(thing=thing, surface=surface, background=background,
                  surroundings=table(height_mm=-60.0, width_mm=400.0))  # fmt: skip
    motion = RigidTransform(
        rotation=Rotation.from_rotvec([0.1, -0.2, 2.0]).as_matrix(), translation=[7.0, 4.0, -3.0]
    )
    rng = np.random.default_rng(SEED)
    targets = np.column_stack([*rng.uniform(-19, 19, (2, 3000)), np.ones(3000)])
    origins, directions = from_above(targets, rng)
    here = scene.caster.cast(origins, directions)
    moved = scene.placed(motion)
    there = moved.caster.cast(motion.apply(origins), motion.rotate(directions))
    assert scene.is_thing(here).all()
    assert moved.is_thing(there).all()
    before, gloss = scene.reflectance(here)
    after, _ = moved.reflectance(there)
    # Rounding puts a few points into the next cell of a chequered texture.
    assert (np.abs(before - after) < 1e-6).mean() > 0.995
    assert before.std() > 0.03
    assert before.min() >= 0.3 - 1e-6  # single precision
    assert before.max() <= 0.6 + 1e-6
    assert (gloss == 0.2).all()

    beside = from_above(targets * [1, 1, 0] + [120.0, 0, -60.0], rng)
    first, second = scene.caster.cast(*beside), moved.caster.cast(*beside)
    table_before, gloss = scene.reflectance(first)
    assert not scene.is_thing(first).any()
    np.testing.assert_array_equal(table_before, moved.reflectance(second)[0])
    assert table_before.max() <= 0.4 + 1e-6
    assert (gloss == 0).all()


def test_a_mesh_with_its_own_brightness_keeps_it() -> None:
    scene = Scene(thing=painted(0.3), surface=Surface(albedo=0.9), background=Surface(albedo=0.5),
                  surroundings=table(height_mm=-5.0, width_mm=100.0))  # fmt: skip
    places = np.array([[2.0, 3.0, 50.0], [8.0, 1.0, 50.0], [-9.0, -9.0, 50.0]])
    hits = scene.caster.cast(places, np.broadcast_to([0.0, 0.0, -1.0], (3, 3)))
    expected = [0.3 + 0.02 + 0.06, 0.3 + 0.08 + 0.02, 0.5]
    np.testing.assert_allclose(scene.reflectance(hits)[0], expected, atol=1e-6)
    nothing = Hits(np.full((1, 3), np.nan), np.full((1, 3), np.nan),
                   np.array([-1], np.int32), np.array([np.nan], np.float32))  # fmt: skip
    assert not scene.is_thing(nothing).any()


@pytest.mark.parametrize(
    ("background", "height"), [("table", -13.5), ("wall", -38.5), ("none", None)]
)
def test_backgrounds_lie_below_the_volume(background: str, height: float | None) -> None:
    """25 mm of volume, 4 % below it the table; the wall a volume's height further."""
    preset = PRESETS["kolibri"](SMALL)
    scene = preset.scene(OBJECTS["plane"](), background=background)
    assert scene.world_from_object.translation[2] == pytest.approx(-13.5)
    if height is None:
        assert scene.surroundings is None
        return
    assert scene.surroundings is not None
    assert scene.surroundings.vertices_mm[:, 2].max() == pytest.approx(height)


def test_objects_are_fitted_to_the_volume_and_own_meshes_are_not() -> None:
    preset = PRESETS["face"](SMALL)
    thing = OBJECTS["plane"]()
    fitted = preset.scene(thing).thing
    assert np.hypot(*fitted.vertices_mm[:, :2].T).max() <= 250.0
    assert np.ptp(fitted.vertices_mm[:, 0]) > 300.0
    np.testing.assert_array_equal(preset.scene(thing, scaled=False).thing.vertices_mm,
                                  thing.vertices_mm)  # fmt: skip
    with pytest.raises(ValueError, match="background: expected table, wall or none, found 'sky'"):
        preset.scene(thing, background="sky")


def test_a_turntable_makes_a_full_turn_about_the_worlds_z_for_each_tilt() -> None:
    """Rigid poses; the object leans about its own x axis, and its middle stays on the axis."""
    box = trimesh.creation.box((20.0, 12.0, 8.0))
    thing = Mesh(vertices_mm=box.vertices + np.array([0, 0, 4.0]), faces=box.faces.astype(np.int32))
    start = RigidTransform(rotation=np.eye(3), translation=[0, 0, -13.5])
    scene = Scene(thing=thing, world_from_object=start)
    poses = [s.world_from_object for s in turntable(scene, n_positions=5, tilts_deg=(0.0, 25.0))]
    assert len(poses) == 10
    np.testing.assert_allclose(poses[0].rotation, start.rotation, atol=1e-12)
    np.testing.assert_allclose(poses[0].translation, start.translation, atol=1e-12)
    for pose in poses:
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
        np.testing.assert_allclose(pose.apply([0.0, 0.0, 4.0]), [0, 0, -9.5], atol=1e-12)
    step = np.array([[np.cos(0.4 * np.pi), -np.sin(0.4 * np.pi), 0],
                     [np.sin(0.4 * np.pi), np.cos(0.4 * np.pi), 0], [0, 0, 1]])  # fmt: skip
    for series in (poses[:5], poses[5:]):
        for now, after in zip(series, [*series[1:], series[0]], strict=True):
            np.testing.assert_allclose(after.rotation, step @ now.rotation, atol=1e-12)
    np.testing.assert_allclose(poses[5].rotate([1.0, 0, 0]), [1, 0, 0], atol=1e-12)
    assert angle_deg(poses[5].rotate([0, 0, 1.0]), np.array([0, 0, 1.0])) == pytest.approx(25.0)
    # Its y axis rises: a positive turn about x.
    assert poses[5].rotate([0, 1.0, 0])[2] > 0


# Meshes from files


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".STL"])
def test_mesh_files_stand_on_the_ground_above_the_origin(tmp_path: Path, suffix: str) -> None:
    body = trimesh.creation.box((20.0, 12.0, 8.0))
    body.apply_translation([100.0, -50.0, 30.0])
    path = tmp_path / f"part{suffix}"
    body.export(path, file_type=suffix[1:].lower())
    mesh = from_file(path)
    np.testing.assert_allclose(mesh.vertices_mm.min(axis=0), [-10, -6, 0], atol=1e-5)
    np.testing.assert_allclose(mesh.vertices_mm.max(axis=0), [10, 6, 8], atol=1e-5)
    assert len(mesh.faces) == 12
    assert mesh.albedo is None
    first, second, third = np.moveaxis(mesh.vertices_mm[mesh.faces], 1, 0)
    normals = np.cross(second - first, third - first)
    middle = mesh.vertices_mm[mesh.faces].mean(axis=1) - [0, 0, 4]
    assert ((normals * middle).sum(axis=1) > 0).all()  # still outwards


def test_colours_of_vertices_become_albedo(tmp_path: Path) -> None:
    """Luminance after ITU-R BT.601: 0.299 R + 0.587 G + 0.114 B."""
    body = trimesh.creation.box((20.0, 12.0, 8.0))
    rng = np.random.default_rng(SEED)
    colors = rng.integers(20, 256, (8, 3))
    body.visual.vertex_colors = np.column_stack([colors, np.full(8, 255)]).astype(np.uint8)
    path = tmp_path / "part.ply"
    body.export(path)
    mesh = from_file(path)
    assert mesh.albedo is not None
    # Vertices may come in another order: look each of them up.
    offset = body.vertices - body.vertices.min(axis=0) - [10, 6, 0]
    order = [int(np.linalg.norm(offset - v, axis=1).argmin()) for v in mesh.vertices_mm]
    r, g, b = colors[order].T / 255
    np.testing.assert_allclose(mesh.albedo, 0.299 * r + 0.587 * g + 0.114 * b, atol=1e-6)


def test_files_without_a_mesh_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none\.stl: expected a mesh file, found none"):
        from_file(tmp_path / "none.stl")
    (tmp_path / "text.ply").write_text("not a mesh")
    with pytest.raises(ValueError, match=r"text\.ply: expected STL, PLY or OBJ, cannot read it"):
        from_file(tmp_path / "text.ply")
    (tmp_path / "empty.obj").write_text("v 0 0 0\nv 1 0 0\n")
    with pytest.raises(ValueError, match=r"empty\.obj: expected"):
        from_file(tmp_path / "empty.obj")
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    with pytest.raises(ValueError, match=r"points\.ply: expected a mesh of triangles, found none"):
        from_file(tmp_path / "points.ply")


def test_a_scene_that_no_camera_sees_lit_is_refused() -> None:
    preset = PRESETS["kolibri"](SMALL)
    away = RigidTransform(rotation=np.eye(3), translation=[5000.0, 0, 0])
    scene = preset.scene(OBJECTS["plane"]()).placed(away)
    with pytest.raises(ValueError, match="expected a camera that sees the object lit, found none"):
        prepare(preset.rig, scene)
