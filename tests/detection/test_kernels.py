import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.detection import _kernels
from slammot_graph.detection.reasons import FREE, NOT_VALID, OCCUPIED, TOO_UNCERTAIN, UNKNOWN

seeds = st.integers(0, 2**32 - 1)
RESOLUTION = 0.1
L_FREE, L_OCCUPIED = math.log(0.25), math.log(4.0)


def random_cov(rng: np.random.Generator, stds: list[float]) -> FloatArray:
    root = rng.normal(size=(len(stds), len(stds))) * np.array(stds)[:, None]
    cov: FloatArray = root @ root.T + 1e-12 * np.eye(len(stds))
    return cov


def end_point(T: FloatArray, origin: FloatArray, r: FloatArray, angle: FloatArray) -> FloatArray:
    """(..., 2) end points; the arguments broadcast."""
    p = origin + r[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return se2.transform(T, p[..., None, :])[..., 0, :]


NO_TIMES, NO_COV = np.empty(0), np.zeros((3, 3))


def kernel_covariances(
    ranges: FloatArray,
    angles: FloatArray,
    origin: FloatArray,
    theta: float,
    cov: FloatArray,
    times: FloatArray = NO_TIMES,
    cov_velocity: FloatArray = NO_COV,
) -> FloatArray:
    out = np.empty((len(ranges), 3))
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    _kernels.end_point_covariances(
        ranges, directions, origin.reshape(-1, 2), times, cov_velocity, theta, cov, 0.02, 0.007, out
    )
    return out[:, [0, 1, 1, 2]].reshape(-1, 2, 2)


def test_a_late_beam_has_the_covariance_of_a_pose_that_is_known_less_well(rng: np.random.Generator) -> None:
    n = 8
    ranges, angles, origins = (
        rng.uniform(0.1, 30.0, n),
        rng.uniform(-4.0, 4.0, n),
        rng.normal(0.0, 0.2, (n, 2)),
    )
    cov, cov_velocity = random_cov(rng, [0.1, 0.2, 0.05]), random_cov(rng, [0.2, 0.1, 0.3])
    times = rng.uniform(-0.1, 0.2, n)
    found = kernel_covariances(ranges, angles, origins, 0.7, cov, times, cov_velocity)
    for k in range(n):
        widened = cov + times[k] ** 2 * cov_velocity
        alone = kernel_covariances(ranges[k : k + 1], angles[k : k + 1], origins[k], 0.7, widened)
        np.testing.assert_allclose(found[k], alone[0], rtol=1e-12)


def test_end_point_covariances_equal_those_of_numeric_jacobians(rng: np.random.Generator) -> None:
    ranges, angles, origin = rng.uniform(0.1, 30.0, 12), rng.uniform(-4.0, 4.0, 12), np.array([0.3, -0.2])
    for theta in (0.0, 0.7, -2.9):
        T, cov = np.array([3.0, -1.0, theta]), random_cov(rng, [0.1, 0.2, 0.05])
        inputs = np.zeros((6, 6))
        inputs[:3, :3], inputs[3:, 3:] = cov, np.diag([0.02**2, 0.007**2, 0.0])
        got = kernel_covariances(ranges, angles, origin, theta, cov)
        for k in range(len(ranges)):
            h = 1e-6
            J = np.zeros((2, 6))
            for i, d in enumerate(np.eye(6) * h):
                up = end_point(se2.compose(T, se2.exp(d[:3])), origin, ranges[k] + d[3], angles[k] + d[4])
                down = end_point(se2.compose(T, se2.exp(-d[:3])), origin, ranges[k] - d[3], angles[k] - d[4])
                J[:, i] = (up - down) / (2.0 * h)
            np.testing.assert_allclose(got[k], J @ inputs @ J.T, rtol=1e-5, atol=1e-9)


def test_end_point_covariance_holds_by_monte_carlo(rng: np.random.Generator) -> None:
    n, T, origin = 40_000, np.array([1.0, 2.0, 1.2]), np.array([0.2, 0.1])
    cov = random_cov(rng, [0.02, 0.02, 0.01])
    poses = se2.compose(T[None], se2.exp(rng.multivariate_normal(np.zeros(3), cov, n)))
    points = end_point(poses, origin, rng.normal(4.0, 0.02, n), rng.normal(-0.8, 0.007, n))
    got = kernel_covariances(np.array([4.0]), np.array([-0.8]), origin, T[2], cov)[0]
    np.testing.assert_allclose(np.cov(points.T), got, atol=0.03 * np.trace(got))


def run_ellipse_test(
    log_odds: FloatArray,
    point: FloatArray,
    cov: FloatArray,
    *,
    stamp: npt.NDArray[np.int32] | None = None,
    oldest: int = 0,
    is_fixed: bool = True,
    max_cells: int = 10_000,
    margin_cells: int = 0,
    is_valid: bool = True,
    cell0: tuple[int, int] = (-16, -16),
) -> int:
    out = np.empty(1, dtype=np.int64)
    _kernels.ellipse_test(
        log_odds.astype(np.float32),
        np.zeros(log_odds.shape, dtype=np.int32) if stamp is None else stamp,
        *cell0,
        RESOLUTION,
        oldest,
        is_fixed,
        L_FREE,
        L_OCCUPIED,
        point[None],
        np.array([[cov[0, 0], cov[0, 1], cov[1, 1]]]),
        np.array([is_valid]),
        2.448,
        max_cells,
        margin_cells,
        out,
    )
    return int(out[0])


def free_grid(side: int = 32) -> FloatArray:
    return np.full((side, side), -3.0)


def cells_under(point: FloatArray, cov: FloatArray, n_sigma: float) -> set[tuple[int, int]]:
    """Cells under the ellipse, sampled densely; row and column of a grid whose cell [16, 16] is at 0."""
    angle, radius = np.meshgrid(np.linspace(-np.pi, np.pi, 721), np.linspace(0.0, n_sigma, 40))
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).reshape(-1, 2)
    cells = np.floor((point + disc @ np.linalg.cholesky(cov).T) / RESOLUTION).astype(int) + 16
    return {(i, j) for j, i in np.unique(cells, axis=0).tolist()}


def test_ellipse_covers_the_cells_that_dense_samples_of_it_fall_into(rng: np.random.Generator) -> None:
    n_cells = 0
    for _ in range(12):
        point, cov = rng.uniform(-0.5, 0.5, 2), random_cov(rng, [0.12, 0.12]) + 1e-5 * np.eye(2)
        cov *= min(1.0, 0.16 / cov.max())
        touched = set()
        for i, j in np.ndindex(32, 32):
            grid = free_grid()
            grid[i, j] = 3.0
            if run_ellipse_test(grid, point, cov) == OCCUPIED:
                touched.add((i, j))
        # samples miss a corner that is only just touched
        assert cells_under(point, cov, 2.448) <= touched <= cells_under(point, cov, 2.448 * 1.03)
        n_cells += len(touched)
    assert n_cells > 100


@pytest.mark.parametrize(
    ("value", "verdict"), [(3.0, OCCUPIED), (0.0, UNKNOWN), (-0.5, UNKNOWN), (-1.5, FREE)]
)
def test_the_cell_that_is_not_free_names_the_reason(value: float, verdict: int) -> None:
    grid = free_grid()
    grid[16, 17] = value
    assert run_ellipse_test(grid, np.array([0.05, 0.05]), 0.03**2 * np.eye(2)) == verdict


def test_cells_within_the_margin_count_whatever_the_ellipse() -> None:
    point, cov = np.array([0.05, 0.05]), 0.001**2 * np.eye(2)
    for margin in range(3):
        reached = set()
        for i, j in np.ndindex(32, 32):
            grid = free_grid()
            grid[i, j] = 3.0
            if run_ellipse_test(grid, point, cov, margin_cells=margin) == OCCUPIED:
                reached.add((i - 16, j - 16))
        around = range(-margin, margin + 1)
        assert reached == {(i, j) for i in around for j in around}


def test_invalid_beams_are_not_judged() -> None:
    nan = np.full(2, np.nan)
    assert run_ellipse_test(free_grid(), nan, np.full((2, 2), np.nan), is_valid=False) == NOT_VALID


def test_an_ellipse_over_too_many_cells_decides_nothing() -> None:
    point, cov = np.array([0.05, 0.05]), 0.1**2 * np.eye(2)
    assert run_ellipse_test(free_grid(), point, cov) == FREE
    assert run_ellipse_test(free_grid(), point, cov, max_cells=10) == TOO_UNCERTAIN
    assert run_ellipse_test(free_grid(), point, 1e6 * np.eye(2)) == TOO_UNCERTAIN


def test_outside_a_fixed_grid_is_unknown_and_a_rolling_one_wraps() -> None:
    cov = 0.001**2 * np.eye(2)
    for outside in ([1.65, 0.05], [-1.65, 0.05], [0.05, 1.65], [0.05, -1.65]):
        assert run_ellipse_test(free_grid(), np.array(outside), cov) == UNKNOWN
    point = np.array([1.65, 0.05])
    assert run_ellipse_test(free_grid(), point, cov, is_fixed=False, cell0=(0, 0)) == FREE
    grid = free_grid()
    grid[0, 16] = 3.0  # global column 16 of a rolling grid of 32, and column -16
    assert run_ellipse_test(grid, point, cov, is_fixed=False, cell0=(0, 0)) == OCCUPIED
    assert run_ellipse_test(grid, point - [3.2, 0.0], cov, is_fixed=False, cell0=(0, 0)) == OCCUPIED


def test_expired_cells_are_unknown() -> None:
    stamp = np.full((32, 32), 4, dtype=np.int32)
    point, cov = np.array([0.05, 0.05]), 0.001**2 * np.eye(2)
    assert run_ellipse_test(free_grid(), point, cov, stamp=stamp, oldest=4) == FREE
    assert run_ellipse_test(free_grid(), point, cov, stamp=stamp, oldest=5) == UNKNOWN


@settings(max_examples=40)
@given(seeds)
def test_a_larger_covariance_never_makes_a_point_moving(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = np.where(rng.random((32, 32)) < 0.97, -3.0, rng.choice([0.0, 3.0], (32, 32)))
    point, cov = rng.uniform(-0.8, 0.8, 2), random_cov(rng, [0.06, 0.06])
    verdicts = [run_ellipse_test(grid, point, cov)]
    for _ in range(3):
        cov = cov + random_cov(rng, [0.05, 0.05])
        verdicts.append(run_ellipse_test(grid, point, cov))
    is_free = [verdict == FREE for verdict in verdicts]
    assert is_free == sorted(is_free, reverse=True)


@settings(max_examples=20)
@given(seeds)
def test_nothing_moves_on_an_unknown_grid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cov = random_cov(rng, [0.1, 0.1])
    assert run_ellipse_test(np.zeros((32, 32)), rng.uniform(-3.0, 3.0, 2), cov) == UNKNOWN


@settings(max_examples=60)
@given(seeds, st.booleans())
def test_a_scan_is_put_at_its_pose_and_tested_there(seed: int, is_fixed: bool) -> None:
    rng = np.random.default_rng(seed)
    log_odds = rng.choice([-3.0, -1.5, -0.5, 3.0], (32, 32), p=[0.8, 0.16, 0.02, 0.02])
    stamp, oldest = np.where(rng.random((32, 32)) < 0.02, 4, 5).astype(np.int32), 5
    row0, col0, margin_cells = rng.integers([-30, -30, 0], [0, 0, 2]).tolist()
    n, origin, angles = 20, rng.normal(0.0, 0.2, 2), rng.uniform(-4.0, 4.0, 20)
    directions, ranges = np.column_stack([np.cos(angles), np.sin(angles)]), rng.uniform(0.1, 2.0, n)
    is_valid = rng.random(n) < 0.9
    ranges[~is_valid & (rng.random(n) < 0.5)] = np.nan
    points_base = origin + ranges[:, None] * directions
    T, cov_pose = rng.normal(0.0, [0.5, 0.5, 2.0]), random_cov(rng, [0.03, 0.03, 0.02])
    points, packed, reason = np.empty((n, 2)), np.empty((n, 3)), np.empty(n, dtype=np.int64)
    _kernels.test_beams(
        log_odds.astype(np.float32),
        stamp,
        row0,
        col0,
        RESOLUTION,
        oldest,
        is_fixed,
        L_FREE,
        L_OCCUPIED,
        points_base,
        ranges,
        directions,
        origin[None],
        NO_TIMES,
        NO_COV,
        is_valid,
        T,
        cov_pose,
        0.02,
        0.007,
        2.448,
        40,
        margin_cells,
        points,
        packed,
        reason,
    )
    np.testing.assert_allclose(points, T[:2] + points_base @ se2.rotation(T[2]).T, atol=1e-12)
    covs = kernel_covariances(ranges, angles, origin, T[2], cov_pose)
    np.testing.assert_allclose(packed[:, [0, 1, 1, 2]].reshape(-1, 2, 2), covs, atol=1e-15)
    for k in range(n):
        assert reason[k] == run_ellipse_test(
            log_odds,
            points[k],
            covs[k],
            stamp=stamp,
            oldest=oldest,
            is_fixed=is_fixed,
            max_cells=40,
            margin_cells=margin_cells,
            is_valid=is_valid[k],
            cell0=(row0, col0),
        )
