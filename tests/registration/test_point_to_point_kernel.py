import math

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.registration import _solve_kernels

seeds = st.integers(0, 2**32 - 1)


def contour(rng: np.random.Generator, n: int) -> FloatArray:
    """Points on the outline of an L-shaped room."""
    corners = np.array([[0, 0], [4, 0], [4, 2], [2, 2], [2, 5], [0, 5], [0, 0]]) - [1.0, 1.5]
    along = np.sort(rng.uniform(0.0, 6.0, n))
    i = along.astype(int)
    points: FloatArray = corners[i] + (along - i)[:, None] * (corners[i + 1] - corners[i])
    return points


def icp(
    reference: FloatArray,
    points: FloatArray,
    start: FloatArray,
    max_iterations: int = 100,
    max_distance: float = 0.5,
    tau: float = 1e-9,
) -> tuple[FloatArray, IntArray, FloatArray, int]:
    T, partner, stats = np.empty(3), np.empty(len(points), dtype=np.int64), np.empty(4)
    iterations = _solve_kernels.match_point_to_point(
        reference,
        np.isfinite(reference[:, 0]),
        points,
        np.isfinite(points[:, 0]),
        start,
        max_distance,
        tau,
        max_iterations,
        T,
        partner,
        stats,
    )
    return T, partner, stats, iterations


@pytest.mark.parametrize("T", [[0.1, -0.08, 0.05], [-0.1, 0.05, -0.06], [0.0, 0.0, 0.0]])
def test_point_to_point_recovers_a_known_transform(rng: np.random.Generator, T: list[float]) -> None:
    reference = contour(rng, 300)
    known = np.array(T)
    points = se2.transform(se2.inverse(known), reference)
    found = icp(reference, points, np.zeros(3))[0]
    np.testing.assert_allclose(found, known, atol=1e-6)
    backward = icp(points, reference, np.zeros(3))[0]
    np.testing.assert_allclose(backward, se2.inverse(known), atol=1e-6)
    shift = np.array([3.0, -7.0, 2.0])
    shifted = icp(se2.transform(shift, reference), points, se2.compose(shift, known * 0.5))[0]
    np.testing.assert_allclose(shifted, se2.compose(shift, known), atol=1e-6)


def test_point_to_point_pairs_are_those_of_a_tree(rng: np.random.Generator) -> None:
    reference, points = contour(rng, 80), rng.uniform(-1.0, 3.0, (60, 2))
    reference[5] = points[7] = np.nan
    start = np.array([0.2, 0.1, 0.3])
    _, partner, stats, iterations = icp(reference, points, start, max_iterations=1, max_distance=0.4)
    finite = np.flatnonzero(np.isfinite(reference[:, 0]))
    moved = np.nan_to_num(se2.transform(start, points), nan=1e3)
    found = cKDTree(reference[finite]).query(moved)
    distance, number = np.asarray(found[0]), np.asarray(found[1])
    expected = np.where(distance < 0.4, finite[number], -1)
    np.testing.assert_array_equal(partner, expected)
    paired = expected >= 0
    np.testing.assert_allclose(stats, [59, paired.sum(), *[distance[paired].mean()] * 2])
    assert iterations == 1


def test_point_to_point_step_is_the_least_squares_one(rng: np.random.Generator) -> None:
    reference, points = contour(rng, 80), contour(rng, 60)
    T, partner, _, _ = icp(reference, points, np.zeros(3), max_iterations=1)
    p, q = points[partner >= 0], reference[partner[partner >= 0]]
    # Kabsch by a singular value decomposition
    U, _, Vt = np.linalg.svd((p - p.mean(axis=0)).T @ (q - q.mean(axis=0)))
    R = Vt.T @ np.diag([1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
    np.testing.assert_allclose(se2.rotation(float(T[2])), R, atol=1e-9)
    np.testing.assert_allclose(T[:2], q.mean(axis=0) - R @ p.mean(axis=0), atol=1e-9)


def test_point_to_point_distance_falls_until_tau_stops_it(rng: np.random.Generator) -> None:
    reference = contour(rng, 200)
    points = se2.transform(np.array([0.2, -0.1, 0.1]), contour(rng, 150))
    d = [icp(reference, points, np.zeros(3), k, max_distance=50.0)[2][2] for k in range(1, 15)]
    assert np.all(np.diff(d) < 1e-3)
    assert d[-1] < 0.5 * d[0]
    tau = 0.002
    expected = 1 + next(k for k, fall in enumerate(-np.diff(d), start=1) if fall < tau)
    assert icp(reference, points, np.zeros(3), max_distance=50.0, tau=tau)[3] == expected


def test_point_to_point_without_partners_stays_at_the_start(rng: np.random.Generator) -> None:
    start = np.array([50.0, 0.0, 0.1])
    T, partner, stats, _ = icp(contour(rng, 30), contour(rng, 30), start)
    np.testing.assert_array_equal(T, start)
    assert (partner == -1).all()
    assert stats[1] == 0
    assert math.isnan(stats[2])
