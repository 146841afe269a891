"""The bundle adjustment against finite differences, SciPy and OpenCV."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from board_series import BOARD, C1, C2, RIG, board_views, errors, sizes
from fringe3d.calibrate import BoardOptions, calibrate_board
from fringe3d.calibrate._adjusting import adjusted, eliminated, moved
from fringe3d.calibrate._board_start import groups_of
from fringe3d.calibrate._bundle import (
    N_POSE,
    Loss,
    Problem,
    State,
    batch_slopes,
    batches_of,
    cost_of,
    loss_and_weight,
    normal_equations,
    residuals,
)
from fringe3d.calibrate._projecting import image, image_and_slopes

Floats = NDArray[np.float64]

LENS = np.array([1750.0, 1752, 640, 510, -0.1, 0.08, 5e-4, -3e-4, 0.02, 0.03, -0.02, 0.01])


def problem_and_state(*, shape: bool = False, loss: Loss = "cauchy") -> tuple[Problem, State]:
    """Return a small problem, and a state beside its solution."""
    views = board_views(n_poses=4, seed=3, noise_px=0.3)
    names, poses = [d.name for d in RIG], [f"pose-{k}" for k in range(4)]
    free = np.zeros((3, 18), bool)
    free[:, :12] = True
    free[1:, 12:] = True
    found = calibrate_board(BOARD, views, sizes(), BoardOptions(lens="k1 p1 p2", shape="flat"))
    rng = np.random.default_rng(5)
    points = BOARD.points_mm
    problem = Problem(
        points=points, batches=batches_of(groups_of(views, names, poses)), free=free,
        shape_free=np.full(points.shape, shape), shape_sigma=np.full(3, 0.5), loss=loss,
        noise=np.array([1.0, 2.0, 1.5]),
    )  # fmt: skip
    lens = np.where(np.arange(12) < 8, found._state.lens, LENS)
    start = replace(found._state, lens=lens, shape=rng.normal(0, 0.05 * shape, points.shape))
    n = problem.n_free + N_POSE * 4
    step = rng.normal(0, 1, n) * 1e-4
    return problem, moved(problem, start, step, np.zeros((0, 3)))


def test_the_image_is_that_of_opencv_and_its_slopes_are_differences() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-150, -120, 450], [150, 120, 600], (40, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), C1.camera_matrix, LENS[4:])
    lens = np.r_[C1.focal_px, C1.center_px, LENS[4:]]
    pixels, by_point, by_lens = image_and_slopes(points, lens)
    np.testing.assert_allclose(pixels, expected.reshape(-1, 2), atol=1e-9)
    np.testing.assert_allclose(image(points, lens), expected.reshape(-1, 2), atol=1e-9)
    for k in range(3):
        step = 1e-4 * np.eye(3)[k]
        slope = (image(points + step, lens) - image(points - step, lens)) / 2e-4
        np.testing.assert_allclose(by_point[:, :, k], slope, atol=1e-6)  # rounding of differences
    for k in range(12):
        step = 1e-5 * max(abs(lens[k]), 1) * np.eye(12)[k]
        slope = (image(points, lens + step) - image(points, lens - step)) / (2 * step[k])
        np.testing.assert_allclose(by_lens[:, :, k], slope, rtol=1e-5, atol=1e-5)


def test_slopes_of_poses_and_points_are_differences() -> None:
    problem, at = problem_and_state(shape=True)
    n = problem.n_free + N_POSE * 4
    columns = np.cumsum(problem.free).reshape(problem.free.shape) - 1
    for batch in problem.batches:
        _, by_device, by_pose, by_board = batch_slopes(problem, at, batch)
        for key in range(12, 18):
            if problem.free[batch.device, key]:
                number = columns[batch.device, key]
                np.testing.assert_allclose(
                    by_device[:, :, key],
                    difference(problem, at, n, number)[batch.device],
                    rtol=1e-5,
                    atol=1e-3,
                )
        number, pose, rows = batch.views[0]
        for key in range(N_POSE):
            slope = difference(problem, at, n, problem.n_free + N_POSE * pose + key)
            np.testing.assert_allclose(
                by_pose[rows, :, key], slope[batch.device][rows], rtol=1e-5, atol=1e-3
            )
        for axis in range(3):
            ahead, back = (shifted_shape(at, axis, sign * 1e-4) for sign in (1, -1))
            by_step = (together(problem, ahead) - together(problem, back)) / 2e-4
            own = together_rows(problem)[batch.device]
            np.testing.assert_allclose(by_board[:, :, axis], by_step[own], rtol=1e-5, atol=1e-3)


def together(problem: Problem, at: State) -> Floats:
    """Return the residuals by device, one after the other."""
    found = residuals(problem, at)
    return np.concatenate([found[n] for b in problem.batches for n, _, _ in b.views])


def together_rows(problem: Problem) -> dict[int, slice]:
    ends = np.cumsum([0, *(len(b.ids) for b in problem.batches)])
    return {b.device: slice(ends[k], ends[k + 1]) for k, b in enumerate(problem.batches)}


def shifted_shape(at: State, axis: int, step: float) -> State:
    return replace(at, shape=at.shape + step * np.eye(3)[axis])


def difference(problem: Problem, at: State, n: int, number: int) -> dict[int, Floats]:
    """Return the slope of the residuals of each device by one of the unknowns."""
    step = 1e-6 * np.eye(n)[number]
    none = np.zeros((0, 3))
    ahead = together(problem, moved(problem, at, step, none))
    back = together(problem, moved(problem, at, -step, none))
    return {d: (ahead - back)[rows] / 2e-6 for d, rows in together_rows(problem).items()}


@pytest.mark.parametrize("loss", ["cauchy", "huber", "squared"])
def test_the_weight_is_the_slope_of_the_loss(loss: Loss) -> None:
    s = np.linspace(0.1, 40, 50)
    ahead, back = (loss_and_weight(s + e, loss)[0] for e in (1e-5, -1e-5))
    np.testing.assert_allclose(loss_and_weight(s, loss)[1], (ahead - back) / 2e-5, rtol=1e-6)
    assert loss_and_weight(np.array([1e-8]), loss)[0][0] == pytest.approx(1e-8)


@pytest.mark.parametrize("shape", [False, True])
def test_the_gradient_is_that_of_the_cost(shape: bool) -> None:
    problem, at = problem_and_state(shape=shape)
    system = normal_equations(problem, at)
    assert system.cost == pytest.approx(cost_of(problem, at), rel=1e-12)
    none = np.zeros((0, 3))
    size = np.sqrt(np.diagonal(system.matrix))
    for number in range(0, len(system.gradient), 5):
        step = 1e-4 / size[number] * np.eye(len(size))[number]
        costs = [cost_of(problem, moved(problem, at, sign * step, none)) for sign in (1, -1)]
        expected = (costs[0] - costs[1]) / (2 * step[number]) / 2  # cost is twice the half squares
        assert system.gradient[number] == pytest.approx(expected, abs=1e-4 * size[number])
    if shape:
        for axis in range(3):
            costs = [cost_of(problem, shifted_shape(at, axis, e)) for e in (1e-5, -1e-5)]
            expected = (costs[0] - costs[1]) / 4e-5
            assert system.point_gradient[:, axis].sum() == pytest.approx(expected, rel=1e-4)


def without_hard_terms(problem: Problem) -> Problem:
    """Return the problem without terms that four poses hardly determine."""
    free = problem.free.copy()
    free[:, 5:12] = False
    return replace(problem, free=free)


def test_elimination_is_the_inverse_of_the_whole() -> None:
    problem, at = problem_and_state(shape=True)
    problem = without_hard_terms(problem)
    system = normal_equations(problem, at)
    n, points = len(system.matrix), len(system.blocks)
    full = np.zeros((n + 3 * points, n + 3 * points))
    full[:n, :n] = system.matrix
    full[n:, :n] = system.coupling.reshape(-1, n)
    full[:n, n:] = full[n:, :n].T
    for k in range(points):
        full[n + 3 * k : n + 3 * k + 3, n + 3 * k : n + 3 * k + 3] = system.blocks[k]
    scale = 1 / np.sqrt(np.diagonal(full))
    expected = np.linalg.inv(full * np.outer(scale, scale))[:n, :n]
    complement, _ = eliminated(system.matrix, system.coupling, system.blocks)
    found = np.linalg.inv(complement * np.outer(scale[:n], scale[:n]))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_the_solution_is_that_of_scipy() -> None:
    problem, at = problem_and_state(loss="squared")
    problem = without_hard_terms(problem)
    found = adjusted(problem, at)
    none = np.zeros((0, 3))

    def weighted(step: Floats) -> Floats:
        state = moved(problem, at, step * scale, none)
        return np.concatenate([
            (image_residual / (batch.sigma * problem.noise[batch.device])[:, None]).ravel()
            for batch in problem.batches
            for image_residual in [np.concatenate([residuals(problem, state)[n]
                                                   for n, _, _ in batch.views])]
        ])  # fmt: skip

    scale = 1 / np.sqrt(np.diagonal(normal_equations(problem, at).matrix))
    oracle = least_squares(weighted, np.zeros(len(scale)), method="lm", xtol=1e-10, ftol=1e-9)
    assert cost_of(problem, found) == pytest.approx(2 * oracle.cost, rel=1e-6)
    state = moved(problem, at, oracle.x * scale, none)
    # A tenth of their sigma: so far a millionth of the cost is.
    np.testing.assert_allclose(found.lens[:, :4], state.lens[:, :4], atol=0.3)


def test_one_camera_is_that_of_opencv() -> None:
    views = board_views((C1,), n_poses=8, noise_px=0.1)
    options = BoardOptions(lens="k1 k2 p1 p2", shape="flat", loss="squared")
    found = calibrate_board(BOARD, views, sizes((C1,)), options)
    points = [BOARD.points_mm[v.ids].astype(np.float32) for v in views]
    pixels = [v.pixels.astype(np.float32).reshape(-1, 1, 2) for v in views]
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12)
    rms, matrix, distortion, *_ = cv2.calibrateCamera(
        points, pixels, (1280, 1024), np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3, criteria=stop
    )
    assert found.rms_px("c1") == pytest.approx(rms, abs=1e-5)
    np.testing.assert_allclose(found.devices[0].camera_matrix, matrix, atol=0.02)
    np.testing.assert_allclose(found.devices[0].distortion[:5], distortion.ravel()[:5], atol=2e-3)


def test_two_cameras_are_those_of_opencv() -> None:
    """OpenCV needs corners that both cameras see; it weighs all alike, as equal noise does here."""
    views = board_views((C1, C2), n_poses=8, noise_px=0.1)
    both = []
    for a, b in zip(views[::2], views[1::2], strict=True):
        shared = np.intersect1d(a.ids, b.ids)
        both += [a.take(np.isin(a.ids, shared)), b.take(np.isin(b.ids, shared))]
    options = BoardOptions(lens="k1 k2 p1 p2", shape="flat", loss="squared")
    found = calibrate_board(BOARD, both, sizes((C1, C2)), options)
    points = [BOARD.points_mm[v.ids].astype(np.float32) for v in both[::2]]
    first, second = ([v.pixels.astype(np.float32).reshape(-1, 1, 2) for v in both[k::2]]
                     for k in (0, 1))  # fmt: skip
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-12)
    guess = [cv2.calibrateCamera(points, p, (1280, 1024), np.eye(3), np.zeros(5),
                                 flags=cv2.CALIB_FIX_K3)[1:3] for p in (first, second)]  # fmt: skip
    _, m1, _, m2, _, rotation, shift, *_ = cv2.stereoCalibrate(
        points, first, second, *guess[0], *guess[1], (1280, 1024),
        flags=cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3, criteria=stop,
    )  # fmt: skip
    c1, c2 = found.devices
    # The noise of the two differs by a few percent, and with it their weights.
    np.testing.assert_allclose(c1.camera_matrix, m1, atol=0.15)
    np.testing.assert_allclose(c2.camera_matrix, m2, atol=0.15)
    np.testing.assert_allclose(c2.device_from_world.translation, shift.ravel(), atol=0.02)
    turn = Rotation.from_matrix(c2.device_from_world.rotation @ rotation.T).magnitude()
    assert turn < 1e-4


def test_without_noise_the_truth_is_found_and_the_covariance_is_small() -> None:
    views = board_views(noise_px=0.0)
    found = calibrate_board(BOARD, views, sizes(), BoardOptions(lens="k1 k2 p1 p2", shape="flat"))
    off = errors(found.devices)
    assert max(abs(off[f"{d.name}.{key}"]) for d in RIG for key in ("fx", "fy", "cx", "cy")) < 1e-4
    assert max(abs(value) for name, value in off.items() if "shift" in name) < 1e-5  # mm
