"""The nouns: what they accept, what they refuse, and that nobody can change them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from fringe3d.model import (
    Correspondences,
    Device,
    Fringe,
    GrayBit,
    ImageStack,
    MeasuringVolume,
    NoiseModel,
    PatternPlan,
    PhaseMap,
    PointCloud,
    PointMap,
    Rejection,
    Rig,
    RigidTransform,
    Uniform,
    Unused,
)
from fringe3d.model.plan import fringes, gray_code
from fringe3d.model.rejection import count_by_reason, reject
from fringe3d.model.volume import BoxShape, CylinderShape

Floats = NDArray[np.float64]

ROUNDING_MM = 1e-9
"""A dozen float64 operations on lengths up to 1000 mm lose 1e-12 mm; a thousandfold margin."""

ANGLE_ROUNDING = 1e-12
"""float64 rounding of products of rotation matrices."""

PRISM_EXCESS = 1 / np.cos(np.pi / 64)
"""Corners of the prism of 64 sides that encloses a cylinder of radius 1."""

lengths = st.floats(-1000, 1000, width=32)
vectors = st.tuples(lengths, lengths, lengths).map(np.array)


@st.composite
def transforms(draw: st.DrawFn) -> RigidTransform:
    turn = draw(st.tuples(*[st.floats(-3, 3, width=32)] * 3))
    rotation = Rotation.from_rotvec(turn).as_matrix()
    return RigidTransform(rotation=rotation, translation=draw(vectors))


points = arrays(np.float64, st.tuples(st.integers(0, 4), st.just(3)), elements=lengths)


def device(
    *,
    name: str = "c1",
    n_rows: int = 60,
    n_cols: int = 80,
    focal_px: ArrayLike = (100.0, 110.0),
    center_px: ArrayLike = (39.5, 29.5),
    distortion: ArrayLike = (),
    device_from_world: RigidTransform | None = None,
) -> Device:
    return Device(
        name=name,
        role="camera",
        n_rows=n_rows,
        n_cols=n_cols,
        focal_px=focal_px,
        center_px=center_px,
        distortion=distortion,
        device_from_world=device_from_world,
    )


def projector(name: str = "projector") -> Device:
    return Device(
        name=name, role="projector", n_rows=4, n_cols=4, focal_px=[9, 9], center_px=[1.5, 1.5]
    )


def assert_same_transform(expected: RigidTransform, found: RigidTransform) -> None:
    np.testing.assert_allclose(expected.rotation, found.rotation, atol=ANGLE_ROUNDING)
    np.testing.assert_allclose(expected.translation, found.translation, atol=ROUNDING_MM)


class TestRigidTransform:
    @given(transforms(), transforms(), transforms())
    def test_composition_is_associative(
        self, d_from_c: RigidTransform, c_from_b: RigidTransform, b_from_a: RigidTransform
    ) -> None:
        left_first = (d_from_c @ c_from_b) @ b_from_a
        assert_same_transform(d_from_c @ (c_from_b @ b_from_a), left_first)

    @given(transforms())
    def test_identity_changes_nothing_on_either_side(self, b_from_a: RigidTransform) -> None:
        identity = RigidTransform.identity()
        assert_same_transform(b_from_a, identity @ b_from_a)
        assert_same_transform(b_from_a, b_from_a @ identity)

    @given(transforms())
    def test_inverse_composes_to_identity_on_either_side(self, b_from_a: RigidTransform) -> None:
        assert_same_transform(RigidTransform.identity(), b_from_a.inverse() @ b_from_a)
        assert_same_transform(RigidTransform.identity(), b_from_a @ b_from_a.inverse())

    @given(transforms(), transforms(), points)
    def test_composition_applies_the_right_one_first(
        self, c_from_b: RigidTransform, b_from_a: RigidTransform, points_a: Floats
    ) -> None:
        one_by_one = c_from_b.apply(b_from_a.apply(points_a))
        np.testing.assert_allclose(
            one_by_one, (c_from_b @ b_from_a).apply(points_a), atol=ROUNDING_MM
        )

    @given(transforms(), points)
    def test_apply_equals_homogeneous_matrix(
        self, b_from_a: RigidTransform, points_a: Floats
    ) -> None:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = b_from_a.rotation, b_from_a.translation
        expected = [(matrix @ [*point, 1.0])[:3] for point in points_a]
        np.testing.assert_allclose(
            np.reshape(expected, (-1, 3)), b_from_a.apply(points_a), atol=ROUNDING_MM
        )

    @given(transforms(), vectors, vectors)
    def test_rotate_maps_differences_of_points(
        self, b_from_a: RigidTransform, start: Floats, end: Floats
    ) -> None:
        expected = b_from_a.apply(end) - b_from_a.apply(start)
        np.testing.assert_allclose(expected, b_from_a.rotate(end - start), atol=ROUNDING_MM)

    def test_quarter_turn_about_z_takes_x_to_y(self) -> None:
        quarter = RigidTransform(
            rotation=[[0, -1, 0], [1, 0, 0], [0, 0, 1]], translation=[10, 20, 30]
        )
        assert quarter.apply([1, 0, 0]).tolist() == [10, 21, 30]

    def test_leading_axes_broadcast(self) -> None:
        shift = RigidTransform(rotation=np.eye(3), translation=[1, 2, 3])
        assert shift.apply(np.zeros((4, 5, 3))).shape == (4, 5, 3)

    @pytest.mark.parametrize(
        ("rotation", "translation", "message"),
        [
            (np.full((3, 3), np.nan), [0, 0, 0], "rotation: expected finite numbers"),
            (np.eye(3), [0, np.inf, 0], "translation: expected finite numbers"),
            (np.zeros((3, 3)), [0, 0, 0], "orthonormal matrix with determinant"),
            (np.diag([1.0, 1.0, -1.0]), [0, 0, 0], "determinant of -1"),
            (1.001 * np.eye(3), [0, 0, 0], "orthonormal matrix"),
            (np.eye(4), [0, 0, 0], r"rotation: expected shape \(3, 3\), found \(4, 4\)"),
            (np.eye(3), [0, 0], r"translation: expected shape \(3,\), found \(2,\)"),
        ],
    )
    def test_what_is_no_rigid_motion_is_refused(
        self, rotation: ArrayLike, translation: ArrayLike, message: str
    ) -> None:
        with pytest.raises(ValueError, match=message):
            RigidTransform(rotation=rotation, translation=translation)


class TestDevice:
    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (lambda: device(focal_px=[0, 100]), "device 'c1': focal_px: expected positive"),
            (lambda: device(focal_px=[100, -1]), "focal_px: expected positive"),
            (lambda: device(focal_px=[100, np.nan]), "focal_px: expected finite"),
            (lambda: device(focal_px=[100, 100, 100]), r"focal_px: expected shape \(2,\)"),
            (lambda: device(center_px=[np.inf, 0]), "center_px: expected finite"),
            (lambda: device(distortion=[0.1, 0.2, 0.3]), "coefficients, found 3"),
            (lambda: device(distortion=np.zeros(15)), "coefficients, found 15"),
            (lambda: device(distortion=[0, 0, 0, np.nan]), "distortion: expected finite"),
            (lambda: device(n_rows=0), "size: expected positive numbers of pixels, found 80 x 0"),
            (lambda: device(n_cols=-5), "size: expected positive numbers of pixels, found -5 x 60"),
        ],
    )
    def test_impossible_device_is_refused_by_name(
        self, make: Callable[[], Device], message: str
    ) -> None:
        with pytest.raises(ValueError, match=message):
            make()

    def test_unknown_role_is_refused(self) -> None:
        with pytest.raises(ValueError, match="expected 'camera' or 'projector', found sensor"):
            Device(
                name="c1",
                role="sensor",  # type: ignore[arg-type]
                n_rows=1,
                n_cols=1,
                focal_px=[1, 1],
                center_px=[0, 0],
            )

    @pytest.mark.parametrize("length", [0, 4, 5, 8, 12, 14])
    def test_distortion_is_padded_with_zeros_to_fourteen(self, length: int) -> None:
        coefficients = 0.01 * np.arange(1, length + 1)
        expected = [*coefficients.tolist(), *[0.0] * (14 - length)]
        assert expected == device(distortion=coefficients).distortion.tolist()

    def test_center_is_the_point_that_the_pose_maps_to_the_origin(self) -> None:
        pose = RigidTransform(
            rotation=Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix(), translation=[5, -7, 90]
        )
        center = device(device_from_world=pose).center_world
        np.testing.assert_allclose(np.zeros(3), pose.apply(center), atol=ROUNDING_MM)

    def test_camera_matrix_holds_x_before_y(self) -> None:
        expected = [[100, 0, 39.5], [0, 110, 29.5], [0, 0, 1]]
        assert expected == device().camera_matrix.tolist()

    def test_shape_is_rows_before_columns(self) -> None:
        assert device().shape == (60, 80)


class TestRig:
    def test_two_devices_of_one_name_are_refused(self) -> None:
        with pytest.raises(ValueError, match="different name for each device"):
            Rig(cameras=(device(), device()))
        with pytest.raises(ValueError, match="different name for each device"):
            Rig(cameras=(device(),), projector=projector("c1"))

    def test_rig_without_camera_is_refused(self) -> None:
        with pytest.raises(ValueError, match="at least one device with role 'camera', found none"):
            Rig(cameras=(), projector=projector())

    def test_exchanged_roles_are_refused(self) -> None:
        with pytest.raises(ValueError, match="'c2' stands as projector but is a camera"):
            Rig(cameras=(device(),), projector=device(name="c2"))
        with pytest.raises(ValueError, match="'projector' stands as camera but is a projector"):
            Rig(cameras=(projector(),))

    def test_devices_are_cameras_then_projector(self) -> None:
        rig = Rig(cameras=(device(), device(name="c2")), projector=projector())
        assert [one.name for one in rig.devices] == ["c1", "c2", "projector"]
        assert [one.name for one in Rig(cameras=(device(),)).devices] == ["c1"]


class TestMeasuringVolume:
    @given(points)
    def test_box_contains_what_lies_between_its_corners(self, some: Floats) -> None:
        lower, upper = np.array([-100.0, -400.0, 0.0]), np.array([300.0, 500.0, 700.0])
        expected = ((some >= lower) & (some <= upper)).all(axis=1)
        assert expected.tolist() == MeasuringVolume.box(lower, upper).contains(some).tolist()

    @pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0, -3), (1, 0, 0), (1, -2, 3)])
    def test_cylinder_contains_its_points_and_nothing_beyond_its_prism(
        self, axis: tuple[float, float, float]
    ) -> None:
        center = np.array([10.0, -20.0, 300.0])
        volume = MeasuringVolume.cylinder(center, axis, radius_mm=50, height_mm=30)
        some = center + np.random.default_rng(3).uniform(-80, 80, (4000, 3))
        unit = np.array(axis) / np.linalg.norm(axis)
        height = np.abs((some - center) @ unit)
        radius = np.linalg.norm(np.cross(some - center, unit), axis=1)
        inside = volume.contains(some)
        assert inside[(radius <= 50) & (height <= 15)].all()
        assert not inside[(radius > 50 * PRISM_EXCESS) | (height > 15)].any()
        assert 0 < inside.sum() < len(inside)

    def test_depth_slab_is_the_depth_in_the_frame_of_the_device(self) -> None:
        pose = RigidTransform(
            rotation=Rotation.from_rotvec([0.5, -0.4, 0.2]).as_matrix(), translation=[30, -40, 50]
        )
        slab = MeasuringVolume.depth_slab(
            device(device_from_world=pose), depth_min_mm=200, depth_max_mm=250
        )
        some = np.random.default_rng(4).uniform(-400, 400, (5000, 3))
        depth = np.array([pose.rotation[2] @ point + pose.translation[2] for point in some])
        expected = (depth >= 200) & (depth <= 250)
        assert expected.tolist() == slab.contains(some).tolist()
        assert 0 < expected.sum() < len(expected)

    @given(points)
    def test_intersection_contains_what_both_contain(self, some: Floats) -> None:
        a = MeasuringVolume.box([-500, -500, -500], [200, 300, 400])
        b = MeasuringVolume.cylinder([0, 0, 0], [1, 1, 0], radius_mm=400, height_mm=900)
        expected = a.contains(some) & b.contains(some)
        assert expected.tolist() == a.intersection(b).contains(some).tolist()

    def test_disjoint_volumes_have_nothing_in_common(self) -> None:
        a = MeasuringVolume.box([0, 0, 0], [1, 1, 1])
        b = MeasuringVolume.box([2, 0, 0], [3, 1, 1])
        some = np.random.default_rng(5).uniform(-1, 4, (1000, 3))
        assert not a.intersection(b).contains(some).any()

    def test_only_a_volume_made_as_a_whole_knows_its_shape(self) -> None:
        box = MeasuringVolume.box([-1, -1, -1], [1, 1, 1])
        cylinder = MeasuringVolume.cylinder([0, 0, 0], [0, 0, 2], radius_mm=1, height_mm=3)
        assert box.shape == BoxShape(min_mm=(-1, -1, -1), max_mm=(1, 1, 1))
        assert cylinder.shape == CylinderShape(
            center_mm=(0, 0, 0), axis=(0, 0, 2), radius_mm=1, height_mm=3
        )
        assert box.intersection(cylinder).shape is None
        assert MeasuringVolume(normals=box.normals, offsets_mm=box.offsets_mm).shape is None

    def test_nan_lies_outside(self) -> None:
        box = MeasuringVolume.box([-1, -1, -1], [1, 1, 1])
        assert box.contains([[0.0, np.nan, 0.0], [0.0, 0.0, 0.0]]).tolist() == [False, True]

    def test_length_of_a_normal_does_not_matter(self) -> None:
        plane = MeasuringVolume(normals=[[0, 0, 4]], offsets_mm=[40])
        assert plane.contains([[0, 0, 9.9], [0, 0, 10.1]]).tolist() == [True, False]
        assert plane.normals.tolist() == [[0, 0, 1]]

    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (lambda: MeasuringVolume.box([0, 0, 0], [1, 0, 1]), "min_mm below max_mm"),
            (lambda: MeasuringVolume.box([0, 0, 0], [1, np.nan, 1]), "min_mm below max_mm"),
            (lambda: MeasuringVolume.box([0, 0, 0], [1, 1, np.inf]), "offsets_mm: expected finite"),
            (
                lambda: MeasuringVolume.cylinder([0, 0, 0], [0, 0, 1], radius_mm=0, height_mm=1),
                "positive radius_mm and height_mm",
            ),
            (
                lambda: MeasuringVolume.cylinder([0, 0, 0], [0, 0, 1], radius_mm=1, height_mm=-1),
                "positive radius_mm and height_mm",
            ),
            (
                lambda: MeasuringVolume.cylinder([0, 0, 0], [0, 0, 0], radius_mm=1, height_mm=1),
                "axis: expected a non-zero vector",
            ),
            (
                lambda: MeasuringVolume.depth_slab(device(), depth_min_mm=5, depth_max_mm=5),
                "depth_min_mm below depth_max_mm",
            ),
            (
                lambda: MeasuringVolume.depth_slab(device(), depth_min_mm=-9, depth_max_mm=-5),
                "in front of device 'c1'",
            ),
            (
                lambda: MeasuringVolume(normals=[[0, 0, 0]], offsets_mm=[1]),
                "expected non-zero vectors",
            ),
            (
                lambda: MeasuringVolume(normals=[[0, 0, 1]], offsets_mm=[1, 2]),
                r"offsets_mm: expected shape \(1,\), found \(2,\)",
            ),
            (
                lambda: MeasuringVolume(normals=[[0, 0, np.nan]], offsets_mm=[1]),
                "normals: expected finite",
            ),
        ],
    )
    def test_impossible_or_empty_volume_is_refused(
        self, make: Callable[[], MeasuringVolume], message: str
    ) -> None:
        with pytest.raises(ValueError, match=message):
            make()


class TestRejection:
    @given(
        arrays(
            np.uint32,
            st.tuples(st.integers(0, 5), st.integers(0, 5)),
            elements=st.integers(0, 2 ** len(Rejection) - 1),
        )
    )
    def test_accepted_and_reasons_sum_to_all_pixels(self, rejection: NDArray[np.uint32]) -> None:
        counts = count_by_reason(rejection)
        assert rejection.size == sum(counts.values()) + int((rejection == 0).sum())
        assert 0 not in counts.values()

    @given(st.sets(st.sampled_from(list(Rejection)), min_size=1))
    def test_pixel_counts_under_its_first_reason(self, reasons: set[Rejection]) -> None:
        bits = np.array([[sum(int(reason) for reason in reasons)]], np.uint32)
        first = min(reasons, key=list(Rejection).index)
        assert {first.name: 1} == count_by_reason(bits)

    def test_every_reason_has_a_bit_of_its_own_and_words(self) -> None:
        bits = [int(reason) for reason in Rejection]
        assert [1 << i for i in range(len(bits))] == bits
        phases = [reason for reason in Rejection if reason < Rejection.REFLECTION]
        assert max(phases) < 2**16, "phases and correspondences have 16 bits"
        assert max(bits) < 2**31
        assert len(bits) == len({reason.meaning for reason in Rejection})

    def test_reject_keeps_the_reasons_that_are_there(self) -> None:
        rejection = np.array([[1, 0, 0]], np.uint16)
        reject(rejection, np.array([[True, True, False]]), Rejection.AMBIGUOUS)
        assert rejection.tolist() == [[1 | 64, 64, 0]]


def point_map(points_mm: Floats, rejection: NDArray[np.uint16]) -> PointMap:
    one = np.ones(rejection.shape, np.float32)
    return PointMap(points_mm=points_mm, sigma_mm=one, skew_mm=one, rejection=rejection)


class TestMaps:
    def test_point_without_or_with_a_reason_is_refused(self) -> None:
        some = np.zeros((1, 2, 3))
        some[0, 1] = np.nan
        assert point_map(some, np.array([[0, 4]], np.uint16)).n_points == 1
        for wrong in ([[0, 0]], [[4, 4]]):
            with pytest.raises(ValueError, match="a point or a reason, and not both"):
                point_map(some, np.array(wrong, np.uint16))

    def test_cloud_of_unequal_lists_is_refused(self) -> None:
        with pytest.raises(ValueError, match=r"cloud: grey: expected shape \(2,\), found \(3,\)"):
            PointCloud(
                points_mm=np.zeros((2, 3)),
                sigma_mm=np.zeros(2, np.float32),
                grey=np.zeros(3, np.uint8),
                source_index=np.zeros((2, 2), np.int32),
            )

    def test_correspondences_of_two_grids_are_refused(self) -> None:
        grid = np.zeros((2, 3), np.float32)
        with pytest.raises(ValueError, match=r"expected pixels of shape \(2, 3, 2\)"):
            Correspondences(
                device_name="c2",
                pixels_c1=np.zeros((2, 3, 2)),
                pixels=np.zeros((3, 2, 2)),
                sigma_px=grid,
                epipolar_residual_px=grid,
                fringe_order=grid.astype(np.int32),
                rejection=grid.astype(np.uint16),
            )

    @staticmethod
    def phase_map(class_of_order: list[int], first_order: int, rows: int = 1) -> PhaseMap:
        grid = np.full((1, 2), 0.5, np.float32)
        return PhaseMap(
            phase=grid,
            order_class=np.array([[first_order, first_order + 1]], np.int32),
            class_of_order=np.array(class_of_order, np.int32),
            phase_std=grid,
            offset=grid,
            modulation=np.ones((rows, 2), np.float32),
            rejection=np.zeros((1, 2), np.uint16),
            period_px=16.0,
            angle=0.0,
            device_name="c1",
            first_order=first_order,
        )

    def test_position_is_phase_plus_order_in_projector_pixels(self) -> None:
        phases = self.phase_map([-1, 0, 1], first_order=-1)
        expected = 16.0 * np.array([[0.5 / (2 * np.pi) - 1, 0.5 / (2 * np.pi)]])
        np.testing.assert_allclose(expected, phases.position_px, atol=ROUNDING_MM)

    def test_reduced_code_has_no_absolute_phase(self) -> None:
        phases = self.phase_map([0, 1, 0, 1], first_order=0)
        assert not phases.is_absolute
        with pytest.raises(ValueError, match="the code is reduced"):
            _ = phases.absolute_phase

    def test_phase_maps_of_two_shapes_are_refused(self) -> None:
        with pytest.raises(ValueError, match=r"expected maps .* of one shape"):
            self.phase_map([0, 1], first_order=0, rows=2)


class TestPlan:
    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (lambda: Fringe(period_px=0, shift=0), "expected period_px > 0"),
            (lambda: Fringe(period_px=np.nan, shift=0), "expected period_px > 0"),
            (lambda: Fringe(period_px=8, shift=np.inf), "a finite shift and angle"),
            (lambda: Fringe(period_px=8, shift=0, angle=np.nan), "a finite shift and angle"),
            (lambda: GrayBit(bit=3, n_bits=3, cell_px=8), "0 <= bit < n_bits"),
            (lambda: GrayBit(bit=0, n_bits=17, cell_px=8), "1 <= n_bits <= 16"),
            (lambda: GrayBit(bit=0, n_bits=1, cell_px=-8), "cell_px > 0"),
            (lambda: GrayBit(bit=0, n_bits=1, cell_px=8, angle=np.inf), "a finite angle"),
            (lambda: Uniform(level=1.5), "0 <= level <= 1"),
            (lambda: Uniform(level=np.nan), "0 <= level <= 1"),
            (lambda: fringes(16, 2), "at least 3 phase steps, found 2"),
            (lambda: PatternPlan(patterns=()), "at least one pattern, found none"),
            (lambda: NoiseModel(read_noise_dn=-1), "expected numbers >= 0"),
            (lambda: NoiseModel(read_noise_dn=1, gain_dn_per_e=np.nan), "expected numbers >= 0"),
        ],
    )
    def test_impossible_pattern_is_refused(self, make: Callable[[], object], message: str) -> None:
        with pytest.raises(ValueError, match=message):
            make()

    def test_places_of_a_mixed_plan_equal_hand_count(self) -> None:
        inverse_first = GrayBit(bit=1, n_bits=2, cell_px=8, inverted=True)
        plan = PatternPlan(
            patterns=(
                Uniform(level=0.0),
                inverse_first,
                *gray_code(8, 2),
                Unused(),
                *fringes(16, 3, angle=0.5),
                *fringes(16, 3),
                Uniform(level=0.0),
            )
        )
        (code,) = plan.gray_sets
        assert (code.bits, code.indices, code.inverses) == ((1, 0), (2, 3), (1, -1))
        assert [one.indices for one in plan.fringe_sets] == [(5, 6, 7), (8, 9, 10)]
        assert plan.angles == (0.0, 0.5)
        assert (plan.uniform_index(0.0), plan.uniform_index(1.0)) == (11, -1)

    def test_subset_keeps_order_and_projector(self) -> None:
        plan = PatternPlan(patterns=fringes(16, 4), projector_shape=(7, 9))
        part = plan.subset([2, 0])
        assert ((plan.patterns[2], plan.patterns[0]), (7, 9)) == (
            part.patterns,
            part.projector_shape,
        )


def stack(images: NDArray[np.generic]) -> ImageStack:
    plan = PatternPlan(patterns=fringes(16, 3))
    return ImageStack(
        images=images,  # type: ignore[arg-type]
        plan=plan,
        device_name="c1",
        saturation_dn=255,
    )


class TestImageStack:
    def test_wrong_number_or_type_of_images_is_refused(self) -> None:
        with pytest.raises(ValueError, match="expected 3 images as the plan lists, found 2"):
            stack(np.zeros((2, 4, 5), np.uint8))
        with pytest.raises(ValueError, match=r"camera 'c1': expected images .* of float32"):
            stack(np.zeros((3, 4, 5), np.float32))
        with pytest.raises(ValueError, match=r"found shape \(3, 4\) of uint8"):
            stack(np.zeros((3, 4), np.uint8))

    def test_subset_takes_images_and_patterns_together(self) -> None:
        images = np.arange(3, dtype=np.uint16)[:, None, None] * np.ones((1, 4, 5), np.uint16)
        whole = stack(images)
        part = whole.subset([2, 0])
        assert part.images[:, 0, 0].tolist() == [2, 0]
        assert (whole.plan.patterns[2], whole.plan.patterns[0]) == part.plan.patterns
        assert part.shape == (4, 5)


FROZEN: dict[str, Callable[[Floats], NDArray[np.generic]]] = {
    "rotation": lambda a: RigidTransform(rotation=a, translation=np.zeros(3)).rotation,
    "focal_px": lambda a: device(focal_px=a[0, :2] + 1).focal_px,
    "distortion": lambda a: device(distortion=a[0, :0]).distortion,
    "normals": lambda a: MeasuringVolume(normals=a, offsets_mm=a[0]).normals,
    "offsets_mm": lambda a: MeasuringVolume(normals=a, offsets_mm=a[0]).offsets_mm,
    "points_mm": lambda a: point_map(a[None], np.zeros((1, 3), np.uint16)).points_mm,
    "images": lambda a: stack(np.zeros((3, 2, 2), np.uint8) + a.astype(np.uint8)[0, 0]).images,
}


class TestFrozen:
    @pytest.mark.parametrize("name", FROZEN)
    def test_array_of_a_noun_cannot_be_changed(self, name: str) -> None:
        array = FROZEN[name](np.eye(3))
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0

    def test_array_of_the_caller_stays_writable(self) -> None:
        rotation, images = np.eye(3), np.zeros((3, 4, 5), np.uint8)
        RigidTransform(rotation=rotation, translation=np.zeros(3))
        stack(images)
        rotation[0, 0], images[0, 0, 0] = 7, 7
        assert (rotation[0, 0], images[0, 0, 0]) == (7, 7)

    def test_field_of_a_noun_cannot_be_replaced(self) -> None:
        with pytest.raises(AttributeError, match="cannot assign to field"):
            device().name = "c2"  # type: ignore[misc]
