"""The kernels of the segment tracker against plain NumPy."""

import math
from typing import Any

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking import _kernels, _segment_kernels, _sight_kernels, _table_kernels

N_POINTS, X, Y, WIDTH, N_PROVEN = 0, 1, 2, 3, 7
SEEDS = range(20)


def table_of(rng: np.random.Generator, k: int) -> FloatArray:
    """Segments within 4 m."""
    table = np.zeros((k, 8))
    table[:, N_POINTS] = rng.integers(1, 6, k)
    table[:, X : Y + 1] = rng.uniform(-2.0, 2.0, (k, 2))
    table[:, WIDTH] = rng.uniform(0.05, 0.5, k)
    table[:, 4:7] = rng.uniform(1e-4, 1e-3, (k, 3)) * (1.0, 0.1, 1.0)
    table[:, N_PROVEN] = np.minimum(rng.integers(0, 3, k), table[:, N_POINTS])
    return table


def test_segments_are_runs_of_near_neighbours() -> None:
    rng = np.random.default_rng(1)
    n = 80
    cluster = np.where(rng.random(n) < 0.7, 0, -1)
    points = np.column_stack([np.linspace(2.0, 3.0, n), np.cumsum(rng.choice([0.01, 0.3], n, p=[0.8, 0.2]))])
    covs, proven = rng.random((n, 3)), rng.random(n) < 0.5
    segment, table = np.empty(n, dtype=np.int64), np.empty((n, 8))
    n_segments = _segment_kernels.find_segments(
        points, covs, cluster, proven, 0.0, 0.0, 1e-6, 0.1, 0.0, 0.25, segment, table
    )
    expected, number = np.full(n, -1), -1
    for k in np.flatnonzero(cluster >= 0):
        is_next = k > 0 and cluster[k - 1] >= 0 and math.dist(points[k], points[k - 1]) <= 0.1
        number += not is_next
        expected[k] = number
    assert segment.tolist() == expected.tolist()
    assert n_segments == number + 1
    for s in range(n_segments):
        own = expected == s
        assert table[s, 0] == own.sum()
        np.testing.assert_allclose(table[s, 1:3], points[own].mean(axis=0))
        np.testing.assert_allclose(table[s, 4:7], covs[own].mean(axis=0))
        assert table[s, 7] == proven[own].sum()


def test_mature_tracks_choose_first_and_a_wide_covariance_is_not_near() -> None:
    table = np.array(
        [[3, 0.1, 0.0, 0.1, 1e-4, 0, 1e-4, 3], [3, 2.0, 0.0, 0.1, 1e-4, 0, 1e-4, 3]], dtype=float
    )
    states = np.array([[0.0, 0.0, 0, 0], [0.1, 0.0, 0, 0]])
    covs = np.array([0.01 * np.eye(4), np.eye(4)])
    for level, takes in ((np.array([0, 0]), 0), (np.array([1, 0]), 1)):
        primary, owner = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
        _segment_kernels.assign(states, covs, level, table, 0.0225, 9.21, 1.5, 0.5, primary, owner)
        assert owner.tolist() == [takes, -1]
        assert primary[takes] == 0


@pytest.mark.parametrize("seed", SEEDS)
def test_a_centre_is_the_mean_of_the_segments(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table, owner = table_of(rng, 9), rng.integers(-1, 4, 9)
    places, noise = np.empty((4, 2)), np.empty((4, 2, 2))
    n_joined, sizes, kinds = np.empty(4, dtype=np.int64), np.empty(4), np.empty(4, dtype=np.int64)
    _segment_kernels.measure(table, owner, 0.25, 0.02, 0.004, places, noise, n_joined, sizes, kinds)
    for t in range(4):
        own = table[owner == t]
        assert n_joined[t] == len(own)
        if not len(own):
            assert sizes[t] == 0.0
            continue
        np.testing.assert_allclose(places[t], own[:, X : Y + 1].mean(axis=0))
        is_body = len(own) > 1 or own[:, WIDTH].max() > 0.25
        assert kinds[t] == (_segment_kernels.BODY_SEEN if is_body else _segment_kernels.LEG_SEEN)
        variance = 0.004 if is_body else 0.02
        xx, xy, yy = own[:, 4:7].mean(axis=0)
        np.testing.assert_allclose(noise[t], [[xx + variance, xy], [xy, yy + variance]])
        apart = np.hypot(*(own[:, None, X : Y + 1] - own[:, X : Y + 1]).transpose(2, 0, 1))
        widths = 0.5 * (own[:, None, WIDTH] + own[:, WIDTH])
        assert sizes[t] == pytest.approx((apart + widths).max())


@pytest.mark.parametrize("seed", SEEDS)
def test_few_points_that_no_free_cell_proves_are_no_sighting(seed: int) -> None:
    rng = np.random.default_rng(seed)
    table, owner = table_of(rng, 8), rng.integers(-1, 3, 8)
    primary = np.array([np.flatnonzero(owner == t)[0] if (owner == t).any() else -1 for t in range(3)])
    n_joined = np.array([(owner == t).sum() for t in range(3)])
    is_weak = [
        table[owner == t, N_PROVEN].sum() == 0 and table[owner == t, N_POINTS].sum() < 4 for t in range(3)
    ]
    expected = [-1 if is_weak[t] else primary[t] for t in range(3)]
    of = [-1 if t >= 0 and expected[t] < 0 else t for t in owner.tolist()]
    _segment_kernels.drop_weak(table, owner, 4, primary, n_joined)
    assert primary.tolist() == expected
    assert owner.tolist() == of
    assert [n == 0 for n in n_joined.tolist()] == [p < 0 for p in expected]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_books_of_the_tracks(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, k, dt = 5, 7, 0.1
    table = table_of(rng, k)
    primary = np.where(rng.random(n) < 0.6, rng.permutation(k)[:n], -1)
    owner = np.full(k, -1)
    owner[primary[primary >= 0]] = np.flatnonzero(primary >= 0)
    states, starts = rng.uniform(-1, 1, (n, 4)), rng.uniform(-1, 1, (n, 2))
    n_hits, missed, unproven = rng.integers(0, 5, n), rng.random(n), rng.random(n)
    displaced = rng.random(n) < 0.2
    is_hit = primary >= 0
    is_proven = np.array([(table[owner == t, N_PROVEN] > 0).any() for t in range(n)])
    far = np.hypot(*(states[:, :2] - starts).T) >= 0.8
    narrow = table[:, WIDTH] <= 0.25
    is_strong = np.array([table[(owner == t) & narrow, N_PROVEN].sum() >= 3 for t in range(n)])
    after = n_hits + is_hit + (is_hit & is_strong)
    expected = (
        is_hit,
        after,
        np.where(is_hit, 0.0, missed + dt),
        np.where(is_proven, 0.0, np.where(is_hit, unproven + dt, unproven)),
        displaced | (is_hit & far & (after >= 3)),
    )
    hit = np.empty(n, dtype=np.bool_)
    _segment_kernels.note_sightings(
        primary, owner, table, dt, states, starts, 3, 0.8, 3.0, 0.25, hit, n_hits, missed, unproven, displaced
    )
    for found, right in zip((hit, n_hits, missed, unproven, displaced), expected, strict=True):
        np.testing.assert_allclose(np.asarray(found, dtype=np.float64), np.asarray(right, dtype=np.float64))


@pytest.mark.parametrize("seed", SEEDS)
def test_beams_by_track(seed: int) -> None:
    rng = np.random.default_rng(seed)
    segment, owner = rng.integers(-1, 6, 40), rng.integers(-1, 4, 6)
    starts, beams = np.empty(5, dtype=np.int64), np.empty(40, dtype=np.int64)
    _segment_kernels.beams_by_track(segment, owner, starts, beams)
    whose = np.where(segment >= 0, owner[segment], -1)
    for t in range(4):
        assert beams[starts[t] : starts[t + 1]].tolist() == np.flatnonzero(whose == t).tolist()


@pytest.mark.parametrize("seed", SEEDS)
def test_twins_are_the_younger_ones_on_the_place_of_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, dt = 6, 0.1
    states = np.column_stack([rng.uniform(-1, 1, (n, 2)), np.zeros((n, 2))])
    is_hit, n_alone, twin_s = rng.random(n) < 0.7, rng.integers(0, 10, n), rng.uniform(0, 2, n)
    apart = np.hypot(*(states[:, None, :2] - states[:, :2]).transpose(2, 0, 1))
    expected = np.zeros(n, dtype=bool)
    shares = np.zeros(n, dtype=bool)
    for j in range(n):
        older = [i for i in range(j) if apart[i, j] < 0.5 and not expected[i]]
        shares[j] = any(apart[i, j] < 0.4 for i in older)
        expected[j] = bool(older) and (twin_s[j] > 1.0 or n_alone[j] < 5)
    nearest = np.where(np.eye(n, dtype=bool), np.inf, apart).min(axis=0)
    alone = n_alone + (is_hit & (nearest > 0.7))
    time_s = np.maximum(twin_s + np.where(shares, dt, -dt), 0.0)
    is_twin = np.empty(n, dtype=np.bool_)
    _segment_kernels.find_twins(states, is_hit, dt, 0.7, 0.5, 0.4, 1.0, n_alone, twin_s, is_twin)
    assert is_twin.tolist() == expected.tolist()
    assert n_alone.tolist() == alone.tolist()
    np.testing.assert_allclose(twin_s, time_s)


def standing_twin(
    points: FloatArray, is_valid: BoolArray, cluster: IntArray, places: FloatArray, reach: float, gap: float
) -> IntArray:
    """`find_standing` in plain words."""
    out = cluster.copy()
    n, first = len(points), max(int(cluster.max()) + 1, 0)  # number of the first new cluster
    step = np.hypot(*np.diff(points, axis=0).T)
    for place in places:
        away = np.hypot(*(points - place).T)
        if ((cluster >= 0) & (away <= reach)).any():
            continue
        near = is_valid & (cluster < 0) & (away <= reach)
        k = 0
        while k < n:
            if not near[k]:
                k += 1
                continue
            end = k
            while end + 1 < n and near[end + 1] and step[end] <= gap:
                end += 1
            is_attached = (k > 0 and is_valid[k - 1] and step[k - 1] <= gap) or (
                end + 1 < n and is_valid[end + 1] and step[end] <= gap
            )
            if not is_attached:
                out[k : end + 1] = first
            k = end + 1
        first += 1
    return out


@pytest.mark.parametrize("seed", SEEDS)
def test_who_stands_is_a_small_thing_by_itself(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 60
    points = np.cumsum(rng.choice([0.03, 0.3], (n, 2), p=[0.8, 0.2]), axis=0)
    is_valid, cluster = rng.random(n) < 0.95, np.where(rng.random(n) < 0.05, rng.integers(0, 3, n), -1)
    places = points[rng.integers(0, n, 6)] + rng.normal(0.0, 0.05, (6, 2))
    out = np.empty(n, dtype=np.int64)
    is_any = _sight_kernels.find_standing(points, is_valid, cluster, places, 0.25, 0.15, out)
    expected = standing_twin(points, is_valid, cluster, places, 0.25, 0.15)
    assert out.tolist() == expected.tolist()
    assert is_any == (expected != cluster).any()


@pytest.mark.parametrize("seed", SEEDS)
def test_a_track_in_another_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state, T = rng.normal(size=4), rng.normal(size=3)
    root = rng.normal(size=(4, 4))
    motion, cov = np.empty(4), np.empty((2, 2))
    _kernels.carry_track(state, root @ root.T, T, motion, cov)
    R = se2.rotation(T[2])
    np.testing.assert_allclose(motion, [*se2.transform(T, state[None, :2])[0], *(R @ state[2:])])
    np.testing.assert_allclose(cov, R @ (root @ root.T)[:2, :2] @ R.T)


def test_expected_are_those_that_displaced_and_were_seen_of_late() -> None:
    states = np.array([[1.0, 2.0, 0.5, 0.0], [0.0, 0.0, 1.0, 0.0], [3.0, 3.0, 0.0, -1.0]])
    times, flags = np.zeros((4, 3)), np.zeros((2, 3), dtype=np.bool_)
    flags[_table_kernels.HAS_DISPLACED] = [True, False, True]
    out = np.empty((3, 2))
    assert _table_kernels.expected_places(3, 0.2, states, times, flags, out) == 2
    np.testing.assert_allclose(out[:2], [[1.1, 2.0], [3.0, 2.8]])
    times[_table_kernels.MISSED_S] = [1.5, 0.0, 0.0]
    assert _table_kernels.expected_places(3, 0.2, states, times, flags, out) == 1
    np.testing.assert_allclose(out[0], [3.0, 2.8])


def test_the_thickness_is_how_far_points_lie_off_their_line() -> None:
    rng = np.random.default_rng(3)
    points = rng.normal(size=(20, 2)) * (0.3, 0.02)
    whole, seen = np.zeros((5, 3), dtype=np.int64), np.zeros((4, 8))
    whole[_table_kernels.ID] = [7, 9, 12]
    seen[:, 0] = [9, 7, 12, 8]
    starts, beams = np.array([0, 9, 16, 20]), rng.permutation(20)
    _table_kernels.measure_thickness(points, 3, whole, starts, beams, seen)
    for m, t in ((0, 1), (1, 0)):
        own = points[beams[starts[t] : starts[t + 1]]]
        least = np.linalg.eigvalsh(np.cov(own.T, bias=True))[0]
        assert seen[m, 7] == pytest.approx(math.sqrt(least))
    assert np.isnan(seen[2:, 7]).all()  # too few points, and a track that has ended


@pytest.mark.parametrize("seed", SEEDS)
def test_tracks_that_have_ended_leave_no_gap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, born, room = 6, 2, 10
    is_ended, owner = rng.random(n) < 0.4, rng.integers(-1, n + born, 12)
    states, covs, starts = (
        rng.normal(size=(room, 4)),
        rng.normal(size=(room, 4, 4)),
        rng.normal(size=(room, 2)),
    )
    whole, times, flags = rng.integers(0, 99, (5, room)), rng.random((4, room)), rng.random((2, room)) < 0.5
    stays = np.flatnonzero(np.append(~is_ended, [True] * born))
    expected: list[Any] = [column[stays].copy() for column in (states, covs, starts)]
    expected += [
        rows[:, stays].copy() for rows in (whole, times, flags)
    ]  # copies, since the kernel moves them
    of = [int(np.flatnonzero(stays == t)[0]) if t in stays else -1 for t in owner.tolist()]
    kept = _table_kernels.compact(n, born, is_ended, states, covs, starts, whole, times, flags, owner)
    assert kept == len(stays)
    assert owner.tolist() == of
    found: list[Any] = [column[:kept] for column in (states, covs, starts)]
    found += [rows[:, :kept] for rows in (whole, times, flags)]
    for one, right in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, right)
