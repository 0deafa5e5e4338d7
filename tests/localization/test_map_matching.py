from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.match_result import UNLIKELY_NIS
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.localization.map_matching import MapMatching
from slammot_graph.mapping.local_map import LocalMap, LocalMapConfig, make_keyframe
from slammot_graph.odometry import MotionState, OdometryNoise
from slammot_graph.registration.base import Match
from tests.localization.matches import FAILED
from tests.rooms import CORRIDOR, HALL, LASER, errors, is_person, take_scan

A = np.array([2.0, 0.0, 1.5])
STEP = np.array([0.1, 0.02, 0.03])
COV = np.diag([0.02, 0.02, 0.01]) ** 2
SCAN = take_scan(se2.compose(A, STEP))
POINTS, IS_VALID = SCAN.points_base(), SCAN.is_valid()
NOTHING = np.zeros_like(IS_VALID)


def matching_at(T_local_before: FloatArray, config: ScanToMapConfig | None = None) -> MapMatching:
    """On a local map of one keyframe, whose base is the local frame."""
    local_map, first = LocalMap(LocalMapConfig()), take_scan(A)
    keyframe = make_keyframe(0, np.zeros(3), first.points_base(), first.is_valid(), LASER, local_map.config)
    local_map.add(keyframe)
    matching = MapMatching(config or ScanToMapConfig(), local_map)
    matching.start_scan(LASER.origin_base, T_local_before)
    return matching


def state_at(T_local_base: FloatArray) -> MotionState:
    return MotionState(
        T_local_base=T_local_base,
        cov_prior=COV,
        cov_independent=COV,
        cov_correlated=np.zeros((3, 3)),
        cov_odometry=COV,
        cov_motion=COV,
    )


def test_a_match_from_the_prediction_tells_where_the_base_is() -> None:
    start = state_at(STEP + np.array([0.02, -0.01, 0.01]))
    match, state = matching_at(np.zeros(3)).match(POINTS, IS_VALID, start)
    assert match.status == "converged"
    assert max(errors(STEP, state.T_local_base)) < 5e-3
    assert np.trace(state.cov_prior) < np.trace(COV)
    np.testing.assert_array_equal(state.cov_correlated, match.cov_correlated)
    np.testing.assert_array_equal(state.cov_odometry, COV)


def test_a_match_that_fails_leaves_the_prediction() -> None:
    start = state_at(STEP)
    match, state = matching_at(np.zeros(3)).match(POINTS, NOTHING, start)
    assert match.status == "failed"
    np.testing.assert_array_equal(state.T_local_base, start.T_local_base)
    np.testing.assert_allclose(state.cov_independent, COV, rtol=1e-9)
    for name in ("cov_prior", "cov_odometry", "cov_correlated"):
        np.testing.assert_array_equal(getattr(state, name), getattr(start, name))


@pytest.mark.parametrize("leap", [[2.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
def test_where_the_prediction_jumps_the_place_before_is_tried(leap: list[float]) -> None:
    config = ScanToMapConfig()
    match, state = matching_at(np.zeros(3), config).match(POINTS, IS_VALID, state_at(np.array(leap)))
    assert match.status == "converged"
    assert match.contradicts_odometry
    assert max(errors(STEP, state.T_local_base)) < 5e-3
    np.testing.assert_allclose(state.cov_odometry, COV + config.lost_cov)


def test_another_place_is_matched_neither_from_here_nor_from_there() -> None:
    scan = take_scan(A, walls=HALL)
    match, state = matching_at(np.zeros(3)).match(scan.points_base(), scan.is_valid(), state_at(STEP))
    assert match.status == "failed"
    assert not match.contradicts_odometry
    np.testing.assert_array_equal(state.T_local_base, STEP)


def used_to_agreement(matching: MapMatching) -> MapMatching:
    """After so many scans with which all returns agreed that it knows this to be usual."""
    for _ in range(60):
        match, _ = matching.match(POINTS, IS_VALID, state_at(STEP))
        assert not match.contradicts_odometry
        matching.start_scan(LASER.origin_base, np.zeros(3))
    assert matching.is_agreed(match)
    return matching


CERTAIN = np.diag([0.005, 0.005, 0.002]) ** 2


def certain_at(T_local_base: FloatArray) -> MotionState:
    """A prediction that claims far more than it knows if it is wrong by decimetres."""
    return state_at(T_local_base)._replace(cov_prior=CERTAIN, cov_independent=CERTAIN, cov_motion=CERTAIN)


@pytest.mark.parametrize("error", [[0.3, 0.0, 0.0], [-0.2, 0.25, 0.0], [0.1, 0.0, 0.15], [0.0, -0.12, 0.0]])
def test_a_wrong_prediction_is_contradicted_where_most_returns_agree_elsewhere(error: list[float]) -> None:
    matching = used_to_agreement(matching_at(np.zeros(3)))
    start = certain_at(se2.compose(STEP, np.array(error)))
    match, state = matching.match(POINTS, IS_VALID, start)
    assert match.status == "converged"
    assert max(errors(STEP, state.T_local_base)) < 5e-3
    assert matching.is_agreed(match)
    # the motion since the last keyframe is known no better than the contradiction leaves it
    assert np.linalg.norm(error[:2]) < 3.0 * np.sqrt(state.cov_odometry[0, 0])


def test_a_scan_is_matched_twice_from_the_pose_that_was_found_against_the_prediction() -> None:
    matching = used_to_agreement(matching_at(np.zeros(3)))
    start = certain_at(np.array([2.0, -1.0, 0.0]))
    found = [matching.match(POINTS, IS_VALID, start, factor)[1].T_local_base for factor in (1.0, 1.0, 0.5)]
    for T in found:
        assert max(errors(STEP, T)) < 5e-3
    again, _ = matching.match(POINTS, IS_VALID, start)
    assert again.contradicts_odometry
    # the next scan begins at its own prediction
    matching.start_scan(LASER.origin_base, STEP)
    match, _ = matching.match(POINTS, IS_VALID, state_at(STEP))
    assert not match.contradicts_odometry


COMPANY = np.array([[x, y, 0.3] for x, y in ((1.2, 0.9), (1.5, -0.9), (2.2, 0.3), (0.4, 1.4), (0.5, -1.4))])
"""People around the robot, base frame (x, y, radius) [m]: about half of what it sees."""


def with_company(T_world_base: FloatArray) -> Scan:
    people = COMPANY.copy()
    people[:, :2] = se2.transform(T_world_base, people[:, :2])
    return take_scan(T_world_base, discs=people.tolist())


def with_new(points: FloatArray, share: float) -> FloatArray:
    """Points (n, 2) of which a share lies on what was never seen."""
    points = points.copy()
    is_new = np.arange(len(points)) % 20 < 20 * share
    points[is_new] *= np.random.default_rng(0).uniform(0.3, 0.8, (np.count_nonzero(is_new), 1))
    return points


def spinning(share_new: float) -> tuple[MapMatching, FloatArray, FloatArray]:
    """A turn of 0.5 rad that nothing predicts, after a match with which three of four returns agreed."""
    matching = matching_at(np.zeros(3), ScanToMapConfig(usual_gain=1.0))
    matching.match(with_new(POINTS, 0.25), IS_VALID, state_at(STEP))
    matching.start_scan(LASER.origin_base, STEP)
    T_local_base = STEP + np.array([0.0, 0.0, 0.5])
    points = take_scan(se2.compose(A, T_local_base)).points_base()
    return matching, with_new(points, share_new), T_local_base


def test_at_the_start_of_a_spin_the_pose_that_leads_by_far_is_believed() -> None:
    matching, points, T_local_base = spinning(0.2)
    match, state = matching.match(points, IS_VALID, state_at(STEP))
    assert match.status == "converged"
    assert match.inlier_ratio < ScanToMapConfig().min_agreement
    assert match.contradicts_odometry
    assert max(errors(T_local_base, state.T_local_base)) < 0.02


def test_where_most_is_new_no_pose_leads() -> None:
    matching, points, _ = spinning(0.6)
    match, _ = matching.match(points, IS_VALID, state_at(STEP))
    assert not matching.is_elsewhere
    assert match.status == "failed"


def behind_panel(T_world_base: FloatArray) -> Scan:
    """A scan with a panel 1.2 m ahead of half of the beams."""
    scan = take_scan(T_world_base)
    is_ahead = np.abs(np.arange(LASER.n_beams) - LASER.n_beams // 2) < LASER.n_beams // 4
    panel = 1.2 / np.maximum(np.cos(LASER.angles_base), 0.05)
    return replace(scan, ranges=np.where(is_ahead, np.minimum(scan.ranges, panel), scan.ranges))


def test_in_company_the_prediction_holds() -> None:
    """Who walks along looks as if the robot stood still; neither pose has most of the returns on its side."""
    local_map, first = LocalMap(LocalMapConfig()), with_company(A)
    keyframe = make_keyframe(0, np.zeros(3), first.points_base(), first.is_valid(), LASER, local_map.config)
    local_map.add(keyframe)
    matching = MapMatching(ScanToMapConfig(), local_map)
    step = np.array([0.3, 0.0, 0.0])
    matching.start_scan(LASER.origin_base, np.zeros(3))
    scan = with_company(se2.compose(A, step))
    assert 0.3 < is_person(scan)[scan.is_valid()].mean() < 0.7
    match, state = matching.match(scan.points_base(), scan.is_valid(), certain_at(step))
    assert not match.contradicts_odometry
    assert not matching.is_agreed(match)
    assert max(errors(step, state.T_local_base)) < 0.01


@pytest.mark.parametrize(("has_odometry", "least_m", "most_m"), [(True, 0.0, 0.005), (False, 0.03, 0.1)])
def test_the_odometry_holds_against_an_unlikely_match_of_few_returns(
    has_odometry: bool, least_m: float, most_m: float
) -> None:
    """What rides along before half of the beams is in the local map, and much else agrees with nothing."""
    local_map, first = LocalMap(LocalMapConfig()), behind_panel(A)
    keyframe = make_keyframe(0, np.zeros(3), first.points_base(), first.is_valid(), LASER, local_map.config)
    local_map.add(keyframe)
    matching = used_to_agreement(matching_at(np.zeros(3)))
    matching.local_map = local_map
    matching.start_scan(LASER.origin_base, np.zeros(3), has_odometry=has_odometry)
    rng, step = np.random.default_rng(0), np.array([0.1, 0.0, 0.0])
    scan = behind_panel(se2.compose(A, step))
    is_clutter = rng.random(LASER.n_beams) < 0.4
    scan.ranges[is_clutter] = rng.uniform(0.3, 0.9, LASER.n_beams)[is_clutter]
    match, state = matching.match(scan.points_base(), scan.is_valid(), certain_at(step))
    assert match.status == "converged"
    assert not matching.is_agreed(match)
    assert least_m <= errors(step, state.T_local_base)[0] < most_m
    assert (match.nis < UNLIKELY_NIS) == has_odometry


def test_where_no_robot_can_have_come_to_is_believed_at_the_third_scan_that_says_so() -> None:
    """The scan before was matched wrongly then; what rides along leads on from scan to scan."""
    wrong, never_astray = se2.compose(STEP, np.array([0.3, 0.0, 0.0])), ScanToMapConfig(astray_share=0.01)
    for shifts, is_believed in (((0.0, 0.0, 0.0), True), ((-0.3, 0.0, 0.0), False), ((0.0, 0.3, 0.0), False)):
        matching = used_to_agreement(matching_at(np.zeros(3), never_astray))
        off = []
        for shift in shifts:
            matching.start_scan(LASER.origin_base, np.zeros(3), has_odometry=True, most_change_m=0.15)
            start = certain_at(se2.compose(wrong, np.array([0.0, shift, 0.0])))
            _, state = matching.match(POINTS, IS_VALID, start)
            off.append(errors(STEP, state.T_local_base)[0])
        assert min(off[:2]) > 0.2
        assert (off[2] < 5e-3) == is_believed


def test_where_hardly_any_returns_agree_the_odometry_is_not_believed() -> None:
    """As of wheels that do not tell forward from backward."""
    matching = used_to_agreement(matching_at(np.zeros(3)))
    for _ in range(3):
        matching.start_scan(LASER.origin_base, np.zeros(3), has_odometry=True, most_change_m=0.15)
        wrong = se2.compose(STEP, np.array([0.3, 0.2, 0.0]))
        _, state = matching.match(POINTS, IS_VALID, certain_at(wrong))
        assert max(errors(STEP, state.T_local_base)) < 5e-3


def test_a_scan_without_a_leap_between_begins_anew() -> None:
    matching = used_to_agreement(matching_at(np.zeros(3), ScanToMapConfig(astray_share=0.01)))
    wrong, off = se2.compose(STEP, np.array([0.3, 0.0, 0.0])), []
    for T in (wrong, wrong, STEP, wrong):
        matching.start_scan(LASER.origin_base, np.zeros(3), has_odometry=True, most_change_m=0.15)
        off.append(errors(STEP, matching.match(POINTS, IS_VALID, certain_at(T))[1].T_local_base)[0])
    assert off[3] > 0.2


def test_one_person_who_leads_the_robot_down_a_corridor_contradicts_nothing() -> None:
    """Nearly all returns agree with any pose along it; who walks ahead alone would hold the robot where it was."""
    local_map, T = LocalMap(LocalMapConfig()), np.array([0.0, 0.1, 0.0])

    def led(x_m: float) -> Scan:
        return take_scan(T + np.array([x_m, 0.0, 0.0]), walls=CORRIDOR, discs=[[x_m + 1.5, 0.1, 0.25]])

    first, step = led(0.0), np.array([0.1, 0.0, 0.0])
    keyframe = make_keyframe(
        0, np.zeros(3), first.points_base(), first.is_valid(4.5), LASER, local_map.config
    )
    local_map.add(keyframe)
    cov = OdometryNoise().covariance(step)
    start = state_at(step)._replace(cov_prior=cov, cov_independent=cov, cov_motion=cov)
    matching = MapMatching(ScanToMapConfig(), local_map)
    matching.start_scan(LASER.origin_base, np.zeros(3))
    scan = led(0.1)
    match, state = matching.match(scan.points_base(), scan.is_valid(4.5), start)
    assert matching.is_agreed(match)
    assert not matching.is_supported(match)
    assert matching.is_unsure(match, np.array([1.0, 0.0]))
    assert not matching.is_unsure(match, np.array([0.0, 1.0]))
    assert not matching.is_unsure(match, np.zeros(2))  # not in doubt
    assert max(errors(step, state.T_local_base)) < 0.04
    # with any support at all it would be carried along
    config = ScanToMapConfig(min_tail_share=0.0)
    without = MapMatching(config, local_map)
    without.start_scan(LASER.origin_base, np.zeros(3))
    _, carried = without.match(scan.points_base(), scan.is_valid(4.5), start)
    assert errors(np.zeros(3), carried.T_local_base)[0] < 0.03


def test_returns_that_were_called_moving_by_a_wrong_prediction_are_matched_too() -> None:
    matching = used_to_agreement(matching_at(np.zeros(3)))
    few = IS_VALID & (np.arange(len(IS_VALID)) % 4 == 0)
    start = certain_at(np.array([0.5, 0.4, 0.0]))
    match, state = matching.match(POINTS, few, start, is_valid=IS_VALID)
    assert match.contradicts_odometry
    assert match.n_correspondences > 2 * np.count_nonzero(few)
    assert matching.agreement(match) == match.inlier_ratio
    assert max(errors(STEP, state.T_local_base)) < 5e-3


@pytest.mark.parametrize("turn_rad", [0.2, -0.3])
def test_a_turn_that_the_odometry_made_up_is_taken_back_down_a_corridor(turn_rad: float) -> None:
    """Walls that lie on free cells as predicted are called moving, and no match is determined along it."""
    local_map, T = LocalMap(LocalMapConfig()), np.array([0.0, 0.2, 0.0])

    def scan_at(x_m: float) -> tuple[FloatArray, BoolArray]:
        scan = take_scan(T + np.array([x_m, 0.0, 0.0]), walls=CORRIDOR)
        return scan.points_base(), scan.is_valid(4.5)

    keyframe = make_keyframe(0, np.zeros(3), *scan_at(0.0), LASER, local_map.config)
    local_map.add(keyframe)
    matching, step = used_to_agreement(matching_at(np.zeros(3))), np.array([0.1, 0.0, 0.0])
    matching.local_map = local_map
    matching.start_scan(LASER.origin_base, np.zeros(3), has_odometry=True, most_change_m=0.15)
    points, is_valid = scan_at(0.1)
    is_static = is_valid & (np.arange(len(is_valid)) % 20 < 13)
    start = certain_at(step + np.array([0.0, 0.0, turn_rad]))
    match, state = matching.match(points, is_static, start, is_valid=is_valid)
    assert match.status == "degenerate"
    assert match.contradicts_odometry
    assert max(errors(step, state.T_local_base)) < 0.01
    assert matching.is_agreed(match)
    slipped_m = matching.config.slip_lever_m * abs(turn_rad)
    assert 0.04 < np.sqrt(state.cov_prior[0, 0]) < 0.4
    assert np.sqrt(state.cov_prior[0, 0]) == pytest.approx(slipped_m, rel=0.1)


def test_what_moves_does_not_agree() -> None:
    matching = matching_at(np.zeros(3))
    half = IS_VALID & (np.arange(len(IS_VALID)) % 2 == 0)
    match, _ = matching.match(POINTS, half, state_at(STEP), is_valid=IS_VALID)
    share = np.count_nonzero(half) / np.count_nonzero(IS_VALID)
    assert matching.agreement(match) == pytest.approx(share * match.inlier_ratio)
    assert not matching.is_agreed(match)


def test_a_narrower_kernel_that_fails_is_replaced_by_the_usual_one() -> None:
    factors, matching = list[float](), matching_at(np.zeros(3))
    usual_match = matching.matcher.match

    def narrow_fails(*arguments: Any, kernel_factor: float) -> Match:
        factors.append(kernel_factor)
        found = usual_match(*arguments, kernel_factor=kernel_factor)
        return found._replace(result=FAILED) if kernel_factor < 1.0 else found

    with patch.object(matching.matcher, "match", narrow_fails):
        match, state = matching.match(POINTS, IS_VALID, state_at(STEP), 0.5)
    assert match.status == "converged"
    assert max(errors(STEP, state.T_local_base)) < 5e-3
    assert factors == [0.5, 1.0]  # from the prediction, and once more


def adrift(T_local_base: FloatArray) -> MotionState:
    """A state after a gap: within a metre or two, in any heading."""
    wide = np.diag([1.0, 1.0, 0.5]) ** 2
    return state_at(T_local_base)._replace(cov_prior=wide, cov_independent=wide, cov_motion=wide)


def usual(matching: MapMatching) -> None:
    """Let most returns agree from scan to scan."""
    for _ in range(100):
        matching.match(POINTS, IS_VALID, state_at(STEP))
        matching.start_scan(LASER.origin_base, STEP)


def test_after_a_gap_the_place_is_found_within_reach() -> None:
    matching = matching_at(np.zeros(3))
    usual(matching)
    match, state = matching.match(POINTS, IS_VALID, adrift(STEP + np.array([1.2, -0.8, 1.3])))
    assert matching.is_adrift and match.status == "converged"
    assert max(errors(STEP, state.T_local_base)) < 5e-3


def test_after_a_gap_what_few_returns_agree_with_is_no_match() -> None:
    matching = matching_at(np.zeros(3))
    usual(matching)
    elsewhere = take_scan(np.array([0.5, -0.3, 0.2]), walls=CORRIDOR)
    points, is_valid = elsewhere.points_base(), elsewhere.is_valid()
    match, _ = matching.match(points, is_valid, adrift(STEP))
    assert match.status == "failed" and "agree" in match.reason
