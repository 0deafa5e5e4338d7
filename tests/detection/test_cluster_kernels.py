from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _cluster_kernels
from slammot_graph.detection.base import Detection
from slammot_graph.detection.clustering import ClusterConfig, SplitConfig, find_clusters
from slammot_graph.detection.reasons import (
    ABSTAINED,
    ALONG,
    DISCARDED,
    FREE,
    NOT_VALID,
    OCCUPIED,
    TOO_UNCERTAIN,
    TRACKED,
    UNKNOWN,
    VACATED,
)

seeds = st.integers(0, 2**32 - 1)
STEP_M = 1.0 / 16.0  # a power of two: distances along an axis are exact, so that limits are met


def connected(points: FloatArray, is_member: np.ndarray, max_gap: float, max_skipped: int) -> IntArray:
    """Clusters by SciPy's connected components, numbered by their first beams."""
    number = np.flatnonzero(is_member)
    near = np.linalg.norm(points[number][:, None] - points[number][None], axis=-1) <= max_gap
    _, labels = connected_components(near & (np.abs(number[:, None] - number[None]) <= max_skipped + 1))
    firsts = list(dict.fromkeys(labels.tolist()))
    out = np.full(len(points), -1)
    out[number] = [firsts.index(label) for label in labels.tolist()]
    return out


@settings(max_examples=50)
@given(seeds, st.integers(0, 12))
def test_clusters_are_connected_components(seed: int, max_skipped: int) -> None:
    rng = np.random.default_rng(seed)
    points, is_member = rng.uniform(0.0, 2.0, (40, 2)), rng.random(40) < 0.6
    out = np.empty(40, dtype=np.int64)
    n = _cluster_kernels.cluster_beams(points, is_member, 0.3, max_skipped, out)
    np.testing.assert_array_equal(out, connected(points, is_member, 0.3, max_skipped))
    assert n == out.max(initial=-1) + 1


@settings(max_examples=30)
@given(seeds)
def test_discarded_clusters_are_too_small_or_too_wide(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, labels = rng.uniform(0.0, 1.0, (30, 2)), rng.integers(-1, 7, 30)
    kept = np.zeros(7, dtype=bool)
    _cluster_kernels.discard_clusters(points, labels, 7, 3, 0.8, 0.6, kept)
    for c in range(7):
        mine = points[labels == c]
        fits = len(mine) >= 3 and bool((np.ptp(mine, axis=0) <= [0.8, 0.6]).all())
        assert kept[c] == fits


def random_points(rng: np.random.Generator, n: int, is_exact: bool) -> FloatArray:
    """Surfaces of any width along the beams of a scan, with gaps between them."""
    is_gap = rng.random(n) < rng.choice([0.05, 0.2])
    steps = np.where(is_gap, rng.choice([0.2, 0.6, 2.0], n), rng.choice([0.05, 0.12]))
    heading = np.repeat(rng.choice([0.0, 0.5, 1.0, 1.5], n // 10 + 1) * np.pi, 10)[:n]
    points = np.cumsum(steps[:, None] * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    points += rng.normal(0.0, 0.02, (n, 2))
    return STEP_M * np.round(points / STEP_M) if is_exact else points


def random_limits(rng: np.random.Generator) -> ClusterConfig:
    gap_m, min_points = rng.choice([0.0625, 0.125]), int(rng.integers(1, 5))
    return ClusterConfig(
        max_gap_m=rng.choice([0.125, 0.25, 0.5]),
        max_skipped_beams=int(rng.integers(0, 5)),
        min_points=int(rng.integers(1, 5)),
        max_x_range_m=rng.choice([0.5, 1.0, 1.5]),
        max_y_range_m=rng.choice([0.5, 1.0, 1.5]),
        split=SplitConfig(gap_m=gap_m, min_points=min_points) if rng.random() < 2 / 3 else None,
    )


def plain_groups(
    points: FloatArray, is_member: BoolArray, max_gap_m: float, min_points: int, config: ClusterConfig
) -> tuple[list[IntArray], list[IntArray]]:
    """The beams of each group, by its first: those that may be people, and the others."""
    labels = connected(points, is_member, max_gap_m, config.max_skipped_beams)
    kept: list[IntArray] = []
    others: list[IntArray] = []
    for c in range(labels.max(initial=-1) + 1):
        beams = np.flatnonzero(labels == c)
        width = np.ptp(points[beams], axis=0)
        fits = len(beams) >= min_points and (width <= [config.max_x_range_m, config.max_y_range_m]).all()
        (kept if fits else others).append(beams)
    return kept, others


def plain_clusters(points: FloatArray, is_member: BoolArray, config: ClusterConfig) -> tuple[IntArray, int]:
    """Groups, and what is left of them split at smaller gaps."""
    groups, others = plain_groups(points, is_member, config.max_gap_m, config.min_points, config)
    if config.split is not None and others:
        is_left = np.isin(np.arange(len(points)), np.concatenate(others))
        groups += plain_groups(points, is_left, config.split.gap_m, config.split.min_points, config)[0]
    labels = np.full(len(points), -1)
    for c, beams in enumerate(groups):
        labels[beams] = c
    return labels, len(groups)


@settings(max_examples=150)
@given(seeds, st.booleans())
def test_clusters_are_grouped_dropped_split_and_numbered_as_their_twin_does(
    seed: int, is_exact: bool
) -> None:
    rng = np.random.default_rng(seed)
    points, is_member = random_points(rng, 50, is_exact), rng.random(50) < rng.choice([0.7, 1.0])
    points[~is_member & (rng.random(50) < 0.5)] = np.nan  # as of beams without a return
    config = random_limits(rng)
    labels, n = find_clusters(points, is_member, config)
    expected, n_expected = plain_clusters(points, is_member, config)
    np.testing.assert_array_equal(labels, expected)
    assert n == n_expected


@dataclass(frozen=True, kw_only=True)
class Hints:
    """Where something stood that is gone, and where tracked objects should be; and how near a beam must end."""

    vacated: FloatArray
    vacated_reach_m: float
    expected: FloatArray
    expected_reach_m: float


def group_moving(
    points: FloatArray,
    is_valid: BoolArray,
    hints: Hints,
    abstain_share: float,
    config: ClusterConfig,
    tested: IntArray,
) -> tuple[IntArray, IntArray, BoolArray, int]:
    reason, cluster, is_moving = tested.copy(), np.empty_like(tested), np.empty(len(points), dtype=np.bool_)
    n_clusters = _cluster_kernels.group_moving(
        points,
        is_valid,
        hints.vacated,
        hints.vacated_reach_m,
        hints.expected,
        hints.expected_reach_m,
        abstain_share,
        *config.kernel_arguments(),
        reason,
        cluster,
        is_moving,
    )
    return reason, cluster, is_moving, n_clusters


def plain_parts(points: FloatArray, reason: IntArray, is_near: BoolArray) -> BoolArray:
    """The runs of near beams beside which, within 0.15 m, something does not move."""
    is_part = np.zeros_like(is_near)
    runs = np.split(np.arange(len(points)), np.flatnonzero(np.diff(is_near)) + 1)
    for run in runs:
        for end, other in ((run[0], run[0] - 1), (run[-1], run[-1] + 1)):
            if 0 <= other < len(points) and reason[other] in (UNKNOWN, OCCUPIED):
                offset = points[end] - points[other]
                is_part[run] |= offset @ offset < _cluster_kernels.ATTACHED_M**2
    return is_part


def plain_grouping(
    points: FloatArray,
    is_valid: BoolArray,
    hints: Hints,
    abstain_share: float,
    config: ClusterConfig,
    tested: IntArray,
) -> tuple[IntArray, IntArray, BoolArray, int]:
    """The beams on free cells; with those near vacated places; with those near expected ones, be there but one."""
    reason = tested.copy()
    is_first = np.isin(tested, [FREE, ALONG])
    cluster, n_clusters = plain_clusters(points, is_first, config)
    is_moving = cluster >= 0
    reason[is_first & ~is_moving] = DISCARDED
    for places, reach_m, why, min_points in (
        (hints.vacated, hints.vacated_reach_m, VACATED, config.min_points),
        (hints.expected, hints.expected_reach_m, TRACKED, 1),
    ):
        squares = np.sum((points[:, None] - places[None]) ** 2, axis=-1)
        is_near = (squares < reach_m**2).any(axis=1) & np.isin(reason, [UNKNOWN, DISCARDED])
        if why == TRACKED:
            is_near &= ~plain_parts(points, reason, is_near)
        if is_near.any():
            cluster, n_clusters = plain_clusters(
                points, is_moving | is_near, replace(config, min_points=min_points)
            )
            is_moving = cluster >= 0
            reason[is_near] = np.where(is_moving[is_near], why, DISCARDED)
    reason[~is_moving & np.isin(reason, [FREE, VACATED, TRACKED, ALONG])] = DISCARDED
    if np.count_nonzero(is_moving) > abstain_share * np.count_nonzero(is_valid):
        nothing = np.zeros_like(is_moving)
        return np.where(is_moving, ABSTAINED, reason), np.full_like(cluster, -1), nothing, 0
    return reason, cluster, is_moving, n_clusters


def random_test(rng: np.random.Generator, n: int) -> IntArray:
    """What the test said of n beams: surfaces of one kind, with single beams of others."""
    kinds = [NOT_VALID, OCCUPIED, UNKNOWN, FREE, ALONG, TOO_UNCERTAIN]
    weights = [0.1, 0.15, 0.3, 0.3, 0.1, 0.05]
    of_surfaces = np.repeat(rng.choice(kinds, n // 5 + 1, p=weights), 5)[:n]
    return np.where(rng.random(n) < 0.15, rng.choice(kinds, n, p=weights), of_surfaces)


def random_places(rng: np.random.Generator, points: FloatArray, is_exact: bool) -> FloatArray:
    """None to three, each near a point."""
    k = rng.integers(0, 4)
    places = points[rng.integers(0, len(points), k)] + rng.normal(0.0, 0.2, (k, 2))
    return STEP_M * np.round(places / STEP_M) if is_exact else places


@settings(max_examples=300)
@given(seeds, st.booleans())
def test_moving_beams_are_grouped_as_their_twin_does(seed: int, is_exact: bool) -> None:
    rng = np.random.default_rng(seed)
    points, tested, config = random_points(rng, 50, is_exact), random_test(rng, 50), random_limits(rng)
    hints = Hints(
        vacated=random_places(rng, points, is_exact),
        vacated_reach_m=rng.choice([0.0, 0.25, 0.5, 0.75]),
        expected=random_places(rng, points, is_exact),
        expected_reach_m=rng.choice([0.0, 0.25, 0.5, 0.75]),
    )
    is_valid = tested != NOT_VALID
    points[~is_valid] = np.nan
    # most often it does not abstain; at times as many beams move as may
    _, _, is_moving, _ = plain_grouping(points, is_valid, hints, 1.0, config, tested)
    share = rng.choice([0.1, 0.5, 1.0, np.count_nonzero(is_moving) / np.count_nonzero(is_valid)])
    got = group_moving(points, is_valid, hints, share, config, tested)
    expected = plain_grouping(points, is_valid, hints, share, config, tested)
    for mine, his in zip(got, expected, strict=True):
        np.testing.assert_array_equal(mine, his)


NOWHERE: FloatArray = np.empty((0, 2))


@pytest.mark.parametrize("why", [FREE, VACATED])
def test_a_group_that_a_wider_one_takes_in_is_discarded_with_it(why: int) -> None:
    points = np.column_stack([np.arange(12) / 8.0, np.zeros(12)])
    tested = np.array([FREE if why == FREE else UNKNOWN] * 3 + [UNKNOWN] * 9)
    config = ClusterConfig(max_gap_m=0.25, max_x_range_m=1.0, split=None)
    hints = Hints(
        vacated=NOWHERE if why == FREE else points[1:2],
        vacated_reach_m=0.25,
        expected=NOWHERE,
        expected_reach_m=1.0,
    )
    everywhere = np.ones(12, dtype=np.bool_)
    reason, _, _, n_clusters = group_moving(points, everywhere, hints, 1.0, config, tested)
    assert reason.tolist() == [why] * 3 + [UNKNOWN] * 9
    assert n_clusters == 1
    hints = replace(hints, expected=points[7:8])  # 1.375 m with the group beside it
    reason, cluster, _, n_clusters = group_moving(points, everywhere, hints, 1.0, config, tested)
    assert reason.tolist() == [DISCARDED] * 12
    assert cluster.tolist() == [-1] * 12
    assert n_clusters == 0


@settings(max_examples=50)
@given(seeds, st.integers(0, 5))
def test_moments_and_beams_of_clusters_are_those_of_each_alone(seed: int, n_clusters: int) -> None:
    rng = np.random.default_rng(seed)
    n = 30
    cluster = np.concatenate([np.arange(n_clusters), rng.integers(-1, n_clusters, n - n_clusters)])
    rng.shuffle(cluster)
    reason = np.where(cluster >= 0, rng.choice([FREE, VACATED, TRACKED], n, p=[0.2, 0.4, 0.4]), UNKNOWN)
    reason[(cluster < 0) & (rng.random(n) < 0.5)] = FREE  # proves nothing of any cluster
    points, packed = rng.normal(0.0, 5.0, (n, 2)), rng.normal(size=(n, 3))
    points[cluster < 0] = packed[cluster < 0] = np.nan
    found = Detection(
        is_moving=cluster >= 0, reason=reason, cluster=cluster, n_clusters=n_clusters, packed_cov=packed
    )
    centres, covs, beams, is_proven = found.clusters(points)
    assert centres.shape == (n_clusters, 2)
    assert covs.shape == (n_clusters, 2, 2)
    assert len(beams) == len(is_proven) == n_clusters
    for c in range(n_clusters):
        mine = np.flatnonzero(cluster == c)
        np.testing.assert_array_equal(beams[c], mine)
        np.testing.assert_allclose(centres[c], points[mine].mean(axis=0), rtol=1e-12, atol=1e-12)
        xx, xy, yy = packed[mine].mean(axis=0)
        np.testing.assert_allclose(covs[c], [[xx, xy], [xy, yy]], rtol=1e-12, atol=1e-12)
        assert is_proven[c] == (reason[mine] == FREE).any()


@given(seeds)
def test_logistic_of_clusters(seed: int) -> None:
    rng = np.random.default_rng(seed)
    evidence, weights = rng.normal(size=(4, 8)), rng.normal(size=8)
    cluster, before = rng.integers(-1, 4, 30), rng.random(30)
    out = before.copy()
    _cluster_kernels.logistic_of_clusters(evidence, weights, cluster, out)
    p = 1.0 / (1.0 + np.exp(-evidence @ weights))
    np.testing.assert_allclose(out, np.where(cluster >= 0, p[cluster], before))
