import numpy as np
import pytest
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


def goes_on_from_wall(points: FloatArray, beams: IntArray, reason: IntArray, joined: IntArray) -> bool:
    """Whether most of a group lies on the line through the wall that begins at the next occupied beam."""
    walls = np.flatnonzero((reason == OCCUPIED) & (joined == joined[beams[0]]))
    for wall in (walls[walls < beams[0]][::-1], walls[walls > beams[-1]]):
        if not len(wall):
            continue
        offsets = points[wall] - points[wall[0]]
        squared = (offsets**2).sum(axis=1)
        is_farther = squared > _wide_kernels.WALL_M**2
        n = int(is_farther.argmax()) if is_farther.any() else len(wall)
        if squared[:n].max() < _wide_kernels.LEAST_WALL_M**2:
            continue
        (xx, xy), (_, yy) = np.cov(offsets[:n].T, bias=True)
        angle = np.arctan2(2.0 * xy, xx - yy) / 2.0
        apart = points[beams] - points[wall[0]] - offsets[:n].mean(axis=0)
        is_on = np.abs(apart @ [-np.sin(angle), np.cos(angle)]) <= _wide_kernels.OFF_LINE_M
        if 2 * np.count_nonzero(is_on) > len(beams):
            return True
    return False


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
    gap = config.max_gap_m, config.max_skipped_beams
    labels = connected(points, is_member, *gap)
    joined = connected(points, is_member | np.isin(reason, (OCCUPIED, UNKNOWN)), *gap)
    for c in range(labels.max(initial=-1) + 1):
        beams = np.flatnonzero(labels == c)
        if (np.ptp(points[beams], axis=0) > [config.max_x_range_m, config.max_y_range_m]).any():
            discarded = beams[reason[beams] == DISCARDED]
            comes_up = is_placed and np.isfinite(off_wall_m)
            comes_up = comes_up and 2 * np.count_nonzero(stands_off[beams]) > len(beams)
            if comes_up and not goes_on_from_wall(points, beams, reason, joined):
                out[discarded] = COME_UP
            elif is_much:
                out[discarded] = TOO_WIDE
    if not (is_member.any() and is_placed):
        return out
    goes_on = np.isin(out, (UNKNOWN, COME_UP, TOO_WIDE, FREE, VACATED, TRACKED, ALONG))
    before = out.copy()
    labels = connected(points, goes_on, *gap)
    joined = connected(points, goes_on | (before == OCCUPIED), *gap)
    for c in range(labels.max(initial=-1) + 1):
        beams = np.flatnonzero(labels == c)
        is_unknown = before[beams] == UNKNOWN
        if 2 * np.count_nonzero(is_unknown) >= len(beams):
            continue
        if not goes_on_from_wall(points, beams, before, joined):
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
    mark_wide(grid, points, is_valid, share, off_wall_m, reason, config)
    np.testing.assert_array_equal(reason, expected)


def mark_wide(
    grid: FloatArray,
    points: FloatArray,
    is_valid: BoolArray,
    mapped_share: float,
    off_wall_m: float,
    reason: IntArray,
    config: ClusterConfig,
) -> None:
    _wide_kernels.mark_wide(
        grid,
        np.zeros(grid.shape, dtype=np.int64),
        0,
        0,
        RESOLUTION_M,
        0,
        True,
        L_OCCUPIED,
        points,
        is_valid,
        mapped_share,
        off_wall_m,
        config.max_gap_m,
        config.max_skipped_beams,
        config.max_x_range_m,
        config.max_y_range_m,
        reason,
    )


@pytest.mark.parametrize("code", [FREE, DISCARDED])
@pytest.mark.parametrize(("turn_rad", "is_wall"), [(0.0, True), (0.04, True), (0.5 * np.pi, False)])
def test_a_wall_that_goes_on_straight_has_not_come_up(turn_rad: float, is_wall: bool, code: int) -> None:
    """Its far end may be on cells that beams at a grazing angle have passed; the floor before a robot lies across."""
    along = np.arange(60) * 0.1
    beyond = np.maximum(along - along[30], 0.0)
    points = np.column_stack(
        [np.minimum(along, along[30]) + beyond * np.cos(turn_rad), beyond * np.sin(turn_rad)]
    )
    points += [0.05, 3.05]
    reason = np.repeat([OCCUPIED, UNKNOWN, code], [30, 5, 25])
    grid = np.full((128, 128), -1.0)
    grid[30, :30] = 1.0
    mark_wide(grid, points, np.full(60, True), 0.9, 0.3, reason, ClusterConfig())
    np.testing.assert_array_equal(reason[:30], OCCUPIED)
    np.testing.assert_array_equal(reason[30:35], UNKNOWN if is_wall else COME_UP)
    np.testing.assert_array_equal(reason[35:], COME_UP if code == DISCARDED and not is_wall else code)
