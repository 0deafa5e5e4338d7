import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.registration import _point_to_point_kernels

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
    max_gap: float = 0.0,
    kept_share: float = 1.0,
) -> tuple[FloatArray, IntArray, FloatArray, int]:
    T, partner, stats = np.empty(3), np.empty(len(points), dtype=np.int64), np.empty(4)
    iterations = _point_to_point_kernels.match_point_to_point(
        reference,
        np.isfinite(reference[:, 0]),
        points,
        np.isfinite(points[:, 0]),
        start,
        max_distance,
        max_gap,
        kept_share,
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


def nearest_on_lines(reference: FloatArray, point: FloatArray, max_gap: float) -> tuple[FloatArray, float]:
    """Nearest place to a point on the reference's points and the lines between neighbours."""
    places = [place for place in reference if np.isfinite(place[0])]
    for a, b in pairwise(reference):
        if np.isfinite(a[0]) and np.isfinite(b[0]) and 0.0 < np.linalg.norm(b - a) <= max_gap:
            share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            places.append(a + share * (b - a))
    distances = np.linalg.norm(np.array(places) - point, axis=1)
    return places[int(np.argmin(distances))], float(distances.min())


@pytest.mark.parametrize("max_gap", [0.15, 0.4, 1.0])
def test_partners_between_points_are_those_of_a_plain_search(
    rng: np.random.Generator, max_gap: float
) -> None:
    reference, points = contour(rng, 50), rng.uniform(-1.0, 3.0, (80, 2))
    reference[7] = reference[30] = points[3] = np.nan
    T, n = np.array([0.2, 0.1, 0.3]), 80
    partner, targets, distances = np.empty(n, dtype=np.int64), np.full((n, 2), np.nan), np.empty(n)
    used, is_reference = np.isfinite(points[:, 0]), np.isfinite(reference[:, 0])
    n_used = _point_to_point_kernels.pair_points(
        reference, is_reference, points, used, T, 0.6, max_gap, partner, targets, distances
    )
    assert n_used == 79
    n_paired = n_between = 0
    for k in np.flatnonzero(used):
        place, distance = nearest_on_lines(reference, se2.transform(T, points[k : k + 1])[0], max_gap)
        assert (partner[k] >= 0) == (distance < 0.6)
        if partner[k] < 0:
            continue
        n_paired += 1
        n_between += bool((place != reference[partner[k]]).any())
        np.testing.assert_allclose(targets[k], place, atol=1e-12)
        assert distances[k] == pytest.approx(distance, abs=1e-12)
    assert n_paired > 20
    assert n_between > 3


def test_the_widest_pairs_are_left_out(rng: np.random.Generator) -> None:
    reference, points = contour(rng, 80), contour(rng, 60)
    _, every, _, _ = icp(reference, points, np.zeros(3), max_iterations=1)
    T, partner, stats, _ = icp(reference, points, np.zeros(3), max_iterations=1, kept_share=0.7)
    distances = np.linalg.norm(points - reference[every], axis=1)
    n_kept = math.ceil(0.7 * np.count_nonzero(every >= 0))
    kept = np.isin(np.arange(60), np.argsort(np.where(every >= 0, distances, np.inf))[:n_kept])
    np.testing.assert_array_equal(partner, np.where(kept, every, -1))
    np.testing.assert_allclose(stats, [60, n_kept, *[distances[kept].mean()] * 2])
    moved = se2.transform(T, points[kept])
    np.testing.assert_allclose(moved.mean(axis=0), reference[partner[kept]].mean(axis=0), atol=1e-12)


def test_a_share_of_no_pairs_is_none(rng: np.random.Generator) -> None:
    start = np.array([50.0, 0.0, 0.1])
    T, partner, stats, _ = icp(contour(rng, 30), contour(rng, 30), start, kept_share=0.5, max_gap=0.3)
    np.testing.assert_array_equal(T, start)
    assert (partner == -1).all()
    assert stats[1] == 0
