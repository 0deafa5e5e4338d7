"""The memory of hits, its kernels against their NumPy twins, and what it calls furniture."""

import numpy as np
import pytest

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _hit_kernels
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.hit_memory import HitMemory, HitMemoryConfig
from slammot_graph.detection.reasons import FREE, FURNITURE, OCCUPIED, UNKNOWN

NOWHERE: FloatArray = np.empty((0, 2))
CLUSTERS = ClusterConfig()
MOST_MOVING = 0.5


def memory(**changes: float) -> HitMemory:
    return HitMemory(HitMemoryConfig(**changes), resolution_m=0.1, window_m=6.4)  # type: ignore[arg-type]


def plain_counts(
    scans: list[tuple[FloatArray, BoolArray, BoolArray]], oldest: int
) -> dict[tuple[int, int], tuple[int, int]]:
    """Count and latest scan of each cell that was hit."""
    counts: dict[tuple[int, int], tuple[int, int]] = {}
    for now, (points, is_valid, is_static) in enumerate(scans):
        if is_static.sum() < (1.0 - MOST_MOVING) * is_valid.sum():
            continue
        for point, valid, static in zip(points, is_valid, is_static, strict=True):
            i, j = np.floor(point[::-1] * 10.0).astype(int).tolist()
            count, latest = counts.get((i, j), (0, -1))
            if not valid or latest == now:
                continue
            count = count if latest >= oldest else 0
            counts[i, j] = (count + 1 if static else max(count - 1, 0)), now
    return counts


def random_scans(rng: np.random.Generator) -> list[tuple[FloatArray, BoolArray, BoolArray]]:
    scans = []
    for _ in range(16):
        points = rng.uniform(-0.5, 0.5, (60, 2))
        is_valid = rng.random(60) < 0.7
        scans.append((points, is_valid, is_valid & (rng.random(60) < rng.choice([0.3, 0.8, 0.9]))))
    return scans


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("oldest", [0, 4])
def test_hits_are_counted_as_the_twin_does(seed: int, oldest: int) -> None:
    scans = random_scans(np.random.default_rng(seed))
    counts, stamp = np.zeros((64, 64), dtype=np.int32), np.full((64, 64), -1, dtype=np.int32)
    for now, scan in enumerate(scans):
        _hit_kernels.count_hits(counts, stamp, 10.0, now, oldest, *scan, MOST_MOVING)
    expected = plain_counts(scans, oldest)
    assert len(expected) == np.count_nonzero(stamp >= 0)
    for (i, j), told in expected.items():
        assert (counts[i & 63, j & 63], stamp[i & 63, j & 63]) == told


@pytest.mark.parametrize("seed", range(5))
def test_cells_hit_before_are_marked_as_the_twin_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scans = random_scans(rng)
    counts, stamp = np.zeros((64, 64), dtype=np.int32), np.full((64, 64), -1, dtype=np.int32)
    for now, scan in enumerate(scans):
        _hit_kernels.count_hits(counts, stamp, 10.0, now, 0, *scan, MOST_MOVING)
    told, points = plain_counts(scans, 0), rng.uniform(-0.5, 0.5, (60, 2))
    reason = rng.choice([FREE, UNKNOWN, OCCUPIED], 60)
    cells = [tuple(cell) for cell in np.floor(points[:, ::-1] * 10.0).astype(int).tolist()]
    expected = [
        why == FREE and told.get((i, j), (0, -1))[0] >= 2 and told[i, j][1] >= 3
        for why, (i, j) in zip(reason, cells, strict=True)
    ]
    out = np.empty(60, dtype=np.bool_)
    assert _hit_kernels.was_hit(counts, stamp, 10.0, 3, points, reason, 2, 1.0, out) == any(expected)
    np.testing.assert_array_equal(out, expected)
    assert 0 < out.sum() < 60
    share = np.mean(reason == FREE)
    assert _hit_kernels.was_hit(counts, stamp, 10.0, 3, points, reason, 2, share, out)
    assert not _hit_kernels.was_hit(counts, stamp, 10.0, 3, points, reason, 2, 0.9 * share, out)


@pytest.mark.parametrize("seed", range(5))
def test_clusters_become_furniture_as_the_twin_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, cluster = rng.uniform(-2.0, 2.0, (80, 2)), rng.integers(-1, 6, 80)
    hit, places = rng.random(80) < 0.4, rng.uniform(-2.0, 2.0, (2, 2))
    reason: IntArray = np.where(cluster >= 0, FREE, UNKNOWN)
    expected = reason.copy()
    for c in range(6):
        own = cluster == c
        near = np.hypot(*(points[own][:, None] - places[None]).transpose(2, 0, 1)) < 0.2
        if own.any() and not near.any() and hit[own].mean() >= 0.4:
            expected[own] = FURNITURE
    _hit_kernels.call_furniture(points, cluster, 6, hit, 0.4, places, 0.2, reason)
    np.testing.assert_array_equal(reason, expected)


@pytest.mark.parametrize("seed", range(5))
def test_points_near_places_are_left_as_the_twin_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, is_static = rng.uniform(-2.0, 2.0, (80, 2)), rng.random(80) < 0.7
    places, out = rng.uniform(-2.0, 2.0, (3, 2)), np.empty(80, dtype=np.bool_)
    _hit_kernels.leave_near(points, is_static, places, 0.6, out)
    nearest = np.hypot(*(points[:, None] - places[None]).transpose(2, 0, 1)).min(axis=1)
    np.testing.assert_array_equal(out, is_static & (nearest >= 0.6))
    assert 0 < out.sum() < is_static.sum()


LEG = np.array([[1.02, 1.03], [1.06, 1.04]])
YES, NO = np.full(2, True), np.full(2, False)


def told(hits: HitMemory, points: FloatArray = LEG, expected: FloatArray = NOWHERE) -> list[int]:
    around: FloatArray = np.column_stack([np.full(60, -2.0), np.linspace(-3.0, 3.0, 60)])
    points = np.vstack([points, around])
    reason: IntArray = np.append(np.full(len(points) - 60, FREE), np.full(60, OCCUPIED))
    hits.call_furniture(points, reason, CLUSTERS, expected, 0.4)
    return [int(why) for why in reason[:-60]]


def test_a_leg_that_was_hit_thrice_is_furniture() -> None:
    hits = memory()
    for k in range(3):
        assert told(hits) == [FREE, FREE]
        hits.add(k, 0.5 * k, LEG, YES, YES)
    assert told(hits) == [FURNITURE, FURNITURE]
    assert told(hits, LEG + 0.3) == [FREE, FREE]  # beside it


def test_half_of_a_cluster_decides() -> None:
    hits = memory()
    for k in range(3):
        hits.add(k, 0.5 * k, LEG, YES, YES)
    person = np.column_stack([np.linspace(0.9, 1.3, 5), np.full(5, 1.03)])
    assert told(hits, person) == [FREE] * 5


def test_a_tracked_object_before_furniture_is_none() -> None:
    hits = memory()
    for k in range(3):
        hits.add(k, 0.5 * k, LEG, YES, YES)
    assert told(hits, expected=np.array([[1.3, 1.0]])) == [FREE, FREE]
    assert told(hits, expected=np.array([[1.6, 1.0]])) == [FURNITURE, FURNITURE]


def test_where_people_walk_is_no_furniture() -> None:
    hits = memory(crowd_share=1.0)
    for k in range(10):
        hits.add(k, 0.5 * k, LEG, YES, YES if k % 2 else NO)
    assert told(hits) == [FREE, FREE]


def test_scans_that_follow_at_once_count_once() -> None:
    hits = memory()
    for k in range(10):
        hits.add(k, 0.01 * k, LEG, YES, YES)
    assert told(hits) == [FREE, FREE]
    for k in range(10):  # each laser has a clock of its own
        hits.add(10 + k, 10.0 + 0.01 * k, LEG, YES, YES, laser=k)
    assert told(hits) == [FURNITURE, FURNITURE]


def test_what_is_too_long_ago_is_forgotten() -> None:
    hits = memory()
    for k in range(3):
        hits.add(k, 0.5 * k, LEG, YES, YES)
    hits.oldest = 3
    assert told(hits) == [FREE, FREE]
    hits.add(3, 5.0, LEG, YES, YES)
    assert told(hits) == [FREE, FREE]


def test_static_points_beside_an_expected_object_are_no_hits() -> None:
    hits = memory()
    np.testing.assert_array_equal(hits.hits(LEG, YES, NOWHERE), YES)
    np.testing.assert_array_equal(hits.hits(LEG, YES, np.array([[1.2, 1.0]])), NO)
    np.testing.assert_array_equal(hits.hits(LEG, YES, np.array([[1.5, 1.0]])), YES)


def test_in_a_crowd_nothing_is_counted_and_nothing_is_furniture() -> None:
    hits = memory()
    for k in range(6):
        hits.add(k, 0.5 * k, LEG, YES, np.array([True, False]))
    assert told(hits) == [FREE, FREE]
    for k in range(6, 9):
        hits.add(k, 0.5 * k, LEG, YES, YES)
    assert told(hits) == [FURNITURE, FURNITURE]
    assert told(hits, np.repeat(LEG, 15, axis=0)) == [FREE] * 30  # of 90 beams
