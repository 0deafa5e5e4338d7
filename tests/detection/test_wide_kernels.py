import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _wide_kernels
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.reasons import (
    ALONG,
    COME_UP,
    DISCARDED,
    FREE,
    NOT_VALID,
    OCCUPIED,
    TOO_WIDE,
    TRACKED,
    UNKNOWN,
    VACATED,
)
from tests.detection.test_cluster_kernels import connected, random_limits, random_points, seeds

RESOLUTION_M = 0.1
L_OCCUPIED = 0.4


def plain_wide(
    grid: FloatArray,
    points: FloatArray,
    is_valid: BoolArray,
    mapped_share: float,
    off_wall_m: float,
    reason: IntArray,
    config: ClusterConfig,
) -> IntArray:
    """Reasons where discarded beams of groups that are too wide are told apart."""
    is_member = np.isin(reason, (DISCARDED, FREE, VACATED, TRACKED, ALONG))
    out = reason.copy()
    is_placed = np.count_nonzero(reason == OCCUPIED) >= _wide_kernels.LEAST_OCCUPIED * np.count_nonzero(
        is_valid
    )
    is_much = np.count_nonzero(is_member) > mapped_share * np.count_nonzero(is_valid)
    walls = np.argwhere(grid > L_OCCUPIED)[:, ::-1]
    cells = np.floor(points / RESOLUTION_M)
    apart = cells[:, None] - walls
    n = round(off_wall_m / RESOLUTION_M) if np.isfinite(off_wall_m) else np.inf
    stands_off = ~((apart**2).sum(axis=2) <= n * n).any(axis=1)
    labels = connected(points, is_member, config.max_gap_m, config.max_skipped_beams)
    for c in range(labels.max(initial=-1) + 1):
        beams = np.flatnonzero(labels == c)
        if (np.ptp(points[beams], axis=0) > [config.max_x_range_m, config.max_y_range_m]).any():
            discarded = beams[reason[beams] == DISCARDED]
            if is_placed and np.isfinite(off_wall_m) and 2 * np.count_nonzero(stands_off[beams]) > len(beams):
                out[discarded] = COME_UP
            elif is_much:
                out[discarded] = TOO_WIDE
    if not (is_member.any() and is_placed):
        return out
    goes_on = np.isin(out, (UNKNOWN, COME_UP, TOO_WIDE, FREE, VACATED, TRACKED, ALONG))
    before = out.copy()
    labels = connected(points, goes_on, config.max_gap_m, config.max_skipped_beams)
    for c in range(labels.max(initial=-1) + 1):
        beams = np.flatnonzero(labels == c)
        is_unknown = before[beams] == UNKNOWN
        if 2 * np.count_nonzero(is_unknown) < len(beams):
            out[beams[is_unknown]] = COME_UP
    return out


@settings(max_examples=150)
@given(seeds, st.booleans(), st.sampled_from([0.1, 0.3, np.inf]))
def test_what_is_too_wide_is_told_apart_as_its_twin_does(
    seed: int, is_exact: bool, off_wall_m: float
) -> None:
    rng = np.random.default_rng(seed)
    points, is_valid = random_points(rng, 50, is_exact), rng.random(50) < 0.9
    points -= points.min(axis=0)  # onto the grid
    side = 1 << int(np.ceil(np.log2(points.max() / RESOLUTION_M + 2.0)))
    grid = np.where(rng.random((side, side)) < rng.choice([0.0, 0.02, 0.2]), 1.0, -1.0)
    codes = (OCCUPIED, UNKNOWN, FREE, VACATED, DISCARDED)
    reason = np.where(
        is_valid,
        rng.choice(codes, 50, p=rng.choice([[0.2, 0.1, 0.2, 0.1, 0.4], [0.05, 0.25, 0.2, 0.1, 0.4]])),
        NOT_VALID,
    )
    config, share = random_limits(rng), float(rng.choice([0.2, 0.75]))
    expected = plain_wide(grid, points, is_valid, share, off_wall_m, reason, config)
    _wide_kernels.mark_wide(
        grid,
        np.zeros((side, side), dtype=np.int64),
        0,
        0,
        RESOLUTION_M,
        0,
        True,
        L_OCCUPIED,
        points,
        is_valid,
        share,
        off_wall_m,
        config.max_gap_m,
        config.max_skipped_beams,
        config.max_x_range_m,
        config.max_y_range_m,
        reason,
    )
    np.testing.assert_array_equal(reason, expected)
