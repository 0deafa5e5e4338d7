from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.scan import Scan
from slammot_graph.detection import reasons
from slammot_graph.detection.base import Detection
from slammot_graph.detection.clustering import ClusterConfig
from slammot_graph.detection.ellipse_test import (
    CommonModeConfig,
    EllipseTestConfig,
    detect_moving,
    end_point_covariances,
)
from slammot_graph.detection.reasons import REASONS
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid
from tests.rooms import LASER, is_person, take_scan

POSE = np.array([2.0, 0.5, 1.9])
SMALL_COV = np.diag([0.01, 0.01, 0.003]) ** 2


def seen_room(window_m: float | None = None) -> OccupancyGrid:
    """The room, from scans turned little by little: no cell between two beams is left out."""
    grid = OccupancyGrid(GridConfig(), window_m=window_m)
    for now in range(30):
        T = se2.compose(POSE, np.array([0.0, 0.0, 0.002 * (now - 15)]))
        scan = take_scan(T)
        origin = se2.transform(T, LASER.origin_base[None])[0]
        grid.update(now, origin, scan.points(T), scan.is_valid(), scan.is_valid())
    return grid


def detect(
    scan: Scan,
    grid: OccupancyGrid,
    config: EllipseTestConfig,
    cov: np.ndarray = SMALL_COV,
    mapped_share: float = 1.0,
    off_wall_m: float = np.inf,
) -> Detection:
    is_valid, clusters = scan.is_valid(), ClusterConfig()
    return detect_moving(
        scan,
        is_valid,
        POSE,
        cov,
        grid,
        config,
        clusters,
        mapped_share=mapped_share,
        off_wall_m=off_wall_m,
    )


@pytest.mark.parametrize("window_m", [None, 40.0])
def test_a_person_in_free_space_moves_and_walls_do_not(window_m: float | None) -> None:
    scan = take_scan(POSE, discs=[[1.0, 2.5, 0.25]])
    found = detect(scan, seen_room(window_m), EllipseTestConfig())
    assert scan.truth is not None
    np.testing.assert_array_equal(found.is_moving, is_person(scan))
    assert found.is_moving.sum() > 5
    np.testing.assert_array_equal(found.cluster, np.where(found.is_moving, 0, -1))
    assert found.n_clusters == 1
    np.testing.assert_array_equal(found.reason == reasons.FREE, found.is_moving)
    assert (found.reason[~found.is_moving] == reasons.OCCUPIED).mean() > 0.8
    assert set(found.reason[~found.is_moving]) <= {reasons.OCCUPIED, reasons.UNKNOWN}


def test_an_uncertain_pose_calls_nothing_moving() -> None:
    scan = take_scan(POSE, discs=[[1.0, 2.5, 0.25]])
    found = detect(scan, seen_room(), EllipseTestConfig(), cov=np.diag([2.0, 2.0, 0.5]) ** 2)
    assert not found.is_moving.any()


def test_on_a_grid_never_seen_nothing_moves() -> None:
    found = detect(take_scan(POSE), OccupancyGrid(GridConfig()), EllipseTestConfig())
    assert not found.is_moving.any()
    assert (found.reason == reasons.UNKNOWN).all()


def test_beams_without_a_return_are_not_judged() -> None:
    scan = take_scan(POSE, discs=[[1.0, 2.5, 0.25]])
    assert scan.truth is not None
    scan.ranges[::3] = [np.nan, np.inf, -np.inf, -1.0, 0.0, 30.0, 1e9] * 8 + [np.nan] * 5
    found = detect(scan, seen_room(), EllipseTestConfig())
    assert (found.reason[::3] == reasons.NOT_VALID).all()
    np.testing.assert_array_equal(found.is_moving, is_person(scan) & scan.is_valid())


def test_a_single_beam_is_discarded() -> None:
    scan = take_scan(POSE, discs=[[1.0, 2.5, 0.25]])
    alone = int(np.flatnonzero(is_person(scan))[0])
    plain = take_scan(POSE)
    plain.ranges[alone] = scan.ranges[alone]
    found = detect(plain, seen_room(), EllipseTestConfig())
    assert not found.is_moving.any()
    assert found.reason[alone] == reasons.DISCARDED


def test_the_test_stands_back_when_too_much_seems_to_move() -> None:
    scan = take_scan(POSE, discs=[[1.0, 2.5, 0.25]])
    found = detect(scan, seen_room(), EllipseTestConfig(abstain_share=0.02))
    assert not found.is_moving.any()
    assert found.n_clusters == 0
    assert (found.cluster == -1).all()
    np.testing.assert_array_equal(found.reason == reasons.ABSTAINED, is_person(scan))


PERSON = [1.0, 2.5, 0.25]
NEVER_SEEN = OccupancyGrid(GridConfig())


def detect_expected(
    scan: Scan, grid: OccupancyGrid, *expected: list[float], track_reach_m: float | None = 0.5
) -> Detection:
    return detect_moving(
        scan,
        scan.is_valid(),
        POSE,
        SMALL_COV,
        grid,
        EllipseTestConfig(track_reach_m=track_reach_m),
        ClusterConfig(),
        np.array(expected).reshape(-1, 2),
    )


def test_on_unknown_cells_a_tracked_person_stays_moving_where_he_is_expected() -> None:
    scan = take_scan(POSE, discs=[PERSON])
    found = detect_expected(scan, NEVER_SEEN, PERSON[:2], [-9.0, 9.0])
    np.testing.assert_array_equal(found.is_moving, is_person(scan))
    assert (found.reason[found.is_moving] == reasons.TRACKED).all()
    assert (found.reason[~found.is_moving] == reasons.UNKNOWN).all()
    assert found.n_clusters == 1


@pytest.mark.parametrize("place", [[1.0, 1.6], [-0.2, 2.5], [5.0, 5.0]])
def test_on_unknown_cells_nothing_moves_where_nobody_is_expected(place: list[float]) -> None:
    scan = take_scan(POSE, discs=[PERSON])
    assert not detect_expected(scan, NEVER_SEEN).is_moving.any()
    assert not detect_expected(scan, NEVER_SEEN, place).is_moving.any()
    assert not detect_expected(scan, NEVER_SEEN, PERSON[:2], track_reach_m=None).is_moving.any()


def test_a_wall_does_not_move_because_somebody_is_expected_before_it() -> None:
    scan, grid = take_scan(POSE), seen_room()
    found = detect_expected(scan, grid, [2.0, 4.4], [2.0, -3.9])
    plain = detect(scan, grid, EllipseTestConfig())
    is_wall = plain.reason == reasons.OCCUPIED
    assert is_wall.mean() > 0.8
    assert not found.is_moving[is_wall].any()
    np.testing.assert_array_equal(found.reason[is_wall], reasons.OCCUPIED)


def test_a_single_beam_moves_where_somebody_is_expected() -> None:
    scan = take_scan(POSE, discs=[PERSON])
    alone = int(np.flatnonzero(is_person(scan))[2])
    plain, grid = take_scan(POSE), seen_room()
    plain.ranges[alone] = scan.ranges[alone]
    assert np.flatnonzero(detect_expected(plain, grid, PERSON[:2]).is_moving).tolist() == [alone]
    assert not detect_expected(plain, grid, [-2.0, 2.5]).is_moving.any()


def test_what_is_too_wide_for_a_person_does_not_move_because_one_is_expected() -> None:
    scan = take_scan(POSE)
    found = detect_expected(scan, NEVER_SEEN, [2.0, 4.5], track_reach_m=1.2)  # 2.4 m of the wall
    assert not found.is_moving.any()
    assert not (found.reason == reasons.TRACKED).any()


def before_it(pose: np.ndarray, distance_m: float, share: float) -> Scan:
    """A scan of the room with something at a distance before so large a share of the beams."""
    scan = take_scan(pose)
    n = len(scan.ranges)
    is_before = np.abs(np.arange(n) - n // 2) < 0.5 * share * n
    return replace(scan, ranges=np.where(is_before, np.minimum(scan.ranges, distance_m), scan.ranges))


def test_something_wide_on_free_cells_neither_moves_nor_enters_the_map() -> None:
    scan = before_it(POSE, 1.2, 0.5)
    found = detect(scan, seen_room(), EllipseTestConfig(), mapped_share=0.2)
    is_before = scan.ranges < take_scan(POSE).ranges - 0.2
    assert np.count_nonzero(is_before) > 0.3 * len(is_before)
    assert not found.is_moving.any()
    assert (found.reason[is_before] == reasons.TOO_WIDE).mean() > 0.95
    np.testing.assert_array_equal(found.is_mapped(scan.is_valid()), found.reason != reasons.TOO_WIDE)
    # where the pose may be wrong, so may all this; it is not known to be a wall either
    np.testing.assert_array_equal(found.abstain().kept_out().is_mapped(scan.is_valid()), ~is_before)
    assert found.abstain().is_mapped(scan.is_valid()).all()


@pytest.mark.parametrize("mapped_share", [0.9, 1.0])
def test_something_wide_is_mapped_where_it_is_little_of_the_scan_or_as_in_the_paper(
    mapped_share: float,
) -> None:
    found = detect(before_it(POSE, 1.2, 0.5), seen_room(), EllipseTestConfig(), mapped_share=mapped_share)
    assert (found.reason == reasons.DISCARDED).any()
    assert not (found.reason == reasons.TOO_WIDE).any()


@pytest.mark.parametrize("mapped_share", [0.2, 0.9])
def test_something_wide_away_from_all_walls_is_not_matched_either(mapped_share: float) -> None:
    """However little of the scan it is; what stands before the wall may be the wall, seen from a wrong pose."""
    scan, plain = before_it(POSE, 1.2, 0.5), take_scan(POSE)
    is_before = scan.ranges < plain.ranges - 0.2
    found = detect(scan, seen_room(), EllipseTestConfig(), mapped_share=mapped_share, off_wall_m=0.3)
    assert (found.reason[is_before] == reasons.COME_UP).mean() > 0.95
    assert not found.is_matched(scan.is_valid())[found.reason == reasons.COME_UP].any()
    assert found.is_matched(scan.is_valid())[~is_before].all()
    assert found.abstain().is_matched(scan.is_valid()).all()
    near = replace(plain, ranges=np.where(is_before, plain.ranges - 0.25, plain.ranges))
    found = detect(near, seen_room(), EllipseTestConfig(), mapped_share=mapped_share, off_wall_m=0.5)
    is_wide = np.isin(found.reason, (reasons.DISCARDED, reasons.TOO_WIDE))
    assert np.count_nonzero(is_wide) > 10
    assert found.is_matched(near.is_valid())[is_wide].all()


def test_standing_back_takes_back_what_was_called_moving_and_no_more() -> None:
    scan = take_scan(POSE, discs=[PERSON])
    scan.ranges[:5] = np.nan
    found = detect(scan, seen_room(), EllipseTestConfig())
    back = found.abstain()
    assert found.is_moving.sum() > 5
    assert not back.is_moving.any()
    np.testing.assert_array_equal(back.reason == reasons.ABSTAINED, found.is_moving)
    np.testing.assert_array_equal(back.reason[~found.is_moving], found.reason[~found.is_moving])
    assert (back.cluster == -1).all()
    assert back.n_clusters == 0
    np.testing.assert_array_equal(back.packed_cov, found.packed_cov)


@pytest.mark.parametrize(("share", "stands_back"), [(0.9, True), (1.1, False)])
def test_the_share_of_valid_beams_decides_about_standing_back(share: float, stands_back: bool) -> None:
    scan, grid = take_scan(POSE, discs=[PERSON]), seen_room()
    scan.ranges[:40] = np.nan  # only beams with a return count
    found = detect(scan, grid, EllipseTestConfig())
    limit = share * found.is_moving.sum() / scan.is_valid().sum()
    again = detect(scan, grid, EllipseTestConfig(abstain_share=limit))
    assert again.is_moving.any() != stands_back


def test_without_a_test_nothing_moves() -> None:
    found = Detection.nothing(np.array([True, False, True]))
    assert found.is_moving.tolist() == [False, False, False]
    assert found.reason[1] == reasons.NOT_VALID


def test_point_covariances_turn_with_the_pose() -> None:
    scan, cov = take_scan(POSE), np.diag([0.1, 0.02, 0.03]) ** 2
    straight = end_point_covariances(scan, np.array([5.0, 5.0, 0.0]), cov, EllipseTestConfig())
    turned = end_point_covariances(scan, np.array([0.0, 1.0, 0.8]), cov, EllipseTestConfig())
    R = se2.rotation(0.8)
    np.testing.assert_allclose(turned, R @ straight @ R.T, atol=1e-12)
    assert (np.linalg.eigvalsh(turned) > 0.0).all()


def test_every_reason_has_a_text() -> None:
    numbers = {name: number for name, number in vars(reasons).items() if isinstance(number, int)}
    assert sorted(numbers.values()) == list(range(len(REASONS)))
    assert len(set(REASONS)) == len(REASONS)
    assert REASONS[reasons.NOT_VALID] == "no valid return"
    assert REASONS[reasons.FREE].startswith("moving: ")
    for number in (
        reasons.OCCUPIED,
        reasons.UNKNOWN,
        reasons.TOO_UNCERTAIN,
        reasons.DISCARDED,
        reasons.ABSTAINED,
    ):
        assert REASONS[number].startswith("static: ")
    for number in reasons.NOT_MAPPED:
        assert REASONS[number].startswith("neither: ")


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"range_std_m": 0.0}, "EllipseTestConfig.range_std_m must be positive, not 0.0"),
        ({"angle_std_rad": -1.0}, "EllipseTestConfig.angle_std_rad must be positive, not -1.0"),
        ({"n_sigma": 0.0}, "EllipseTestConfig.n_sigma must be positive, not 0.0"),
        ({"n_sigma": float("inf")}, "EllipseTestConfig.n_sigma must be finite, not inf"),
        ({"max_cells": 0}, "EllipseTestConfig.max_cells must be at least 1, not 0"),
        ({"margin_cells": 0}, "EllipseTestConfig.margin_cells must be at least 1, not 0"),
        ({"track_reach_m": 0.0}, "EllipseTestConfig.track_reach_m must be positive, not 0.0"),
        ({"abstain_share": 0.0}, r"EllipseTestConfig.abstain_share must be in \(0, 1\], not 0.0"),
        ({"abstain_share": 1.1}, r"EllipseTestConfig.abstain_share must be in \(0, 1\], not 1.1"),
    ],
)
def test_impossible_tests_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        EllipseTestConfig(**changes)  # type: ignore[arg-type]


def test_an_error_common_to_the_scan_is_found_by_consensus() -> None:
    scan = take_scan(POSE, discs=[[1.0, 2.5, 0.25]])
    assert scan.truth is not None
    config = EllipseTestConfig(common_mode=CommonModeConfig())
    found = detect(scan, seen_room(), config)
    np.testing.assert_array_equal(found.is_moving, is_person(scan))
    # a yaw error of two standard deviations would flag walls; the sigma points on them outweigh the others
    turned = se2.compose(POSE, np.array([0.0, 0.0, 0.04]))
    cov = np.diag([0.01, 0.01, 0.02]) ** 2
    wrong = detect_moving(scan, scan.is_valid(), turned, cov, seen_room(), config, ClusterConfig())
    assert (wrong.is_moving & ~is_person(scan)).sum() <= 2
    assert (wrong.is_moving & is_person(scan)).sum() > 0.7 * is_person(scan).sum()
