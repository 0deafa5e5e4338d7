from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.localization import ScanToMapConfig
from slammot_graph.localization.map_matching import MapMatching
from slammot_graph.mapping.local_map import LocalMap, LocalMapConfig, make_keyframe
from slammot_graph.odometry import MotionState
from slammot_graph.registration.base import Match
from tests.localization.matches import FAILED
from tests.rooms import HALL, LASER, errors, take_scan

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
def test_where_the_odometry_jumps_the_place_before_is_tried(leap: list[float]) -> None:
    config = ScanToMapConfig()
    match, state = matching_at(np.zeros(3), config).match(POINTS, IS_VALID, state_at(np.array(leap)))
    assert match.status == "converged"
    assert max(errors(STEP, state.T_local_base)) < 5e-3
    np.testing.assert_allclose(state.cov_odometry, COV + config.lost_cov)


def test_another_place_is_matched_neither_from_here_nor_from_there() -> None:
    scan = take_scan(A, walls=HALL)
    match, state = matching_at(np.zeros(3)).match(scan.points_base(), scan.is_valid(), state_at(STEP))
    assert match.status == "failed"
    assert not match.is_refused
    np.testing.assert_array_equal(state.T_local_base, STEP)


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
    assert factors == [0.5, 0.5, 1.0]  # from the prediction, from the pose before, once more


def test_a_series_of_improbable_matches_is_refused_and_leaves_the_prediction() -> None:
    config = ScanToMapConfig(point_to_line=replace(ScanToMapConfig().point_to_line, max_nis=1.0))
    matching = matching_at(np.zeros(3), config)
    start = replace(state_at(STEP + np.array([0.1, 0.0, 0.0])), cov_prior=1e-6 * np.eye(3))
    for _ in range(10):
        matching.start_scan(LASER.origin_base, np.zeros(3))
        match, state = matching.match(POINTS, IS_VALID, start)
    assert match.is_refused
    assert match.status == "failed"
    assert match.reason.startswith("improbable, innovation squared ")
    assert not match.information.any()
    np.testing.assert_array_equal(state.T_local_base, start.T_local_base)
    np.testing.assert_array_equal(state.cov_independent, start.cov_independent)
