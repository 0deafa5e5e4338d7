"""Odometry whose velocity changes at once, or that is dead: what is unsure since, and what decides."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.doubt import DoubtConfig, OdometryDoubt
from slammot_graph.odometry.motion import MatchedPose, Motion

STEP_S, SPEED_M_S, STD_M = 0.1, 0.5, 0.002
COV: FloatArray = np.diag(np.square((STD_M, STD_M, 0.001)))
GOES_ON: FloatArray = np.array([SPEED_M_S * STEP_S, 0.0, 0.0])

ORIGIN: FloatArray = np.zeros(3)


def told(increment: FloatArray) -> Motion:
    return Motion(increment=increment, cov=COV)


def found_by(
    std_m: float, std_y_m: float = 0.001, at: FloatArray = ORIGIN, *, is_told: bool = True
) -> MatchedPose:
    cov = np.diag(np.square((std_m, std_y_m, 0.001)))
    return MatchedPose(at, cov, cov, 0.9, is_reliable=True, is_told=is_told)


def driven(n: int = 60, seed: int = 0) -> OdometryDoubt:
    """A check that has seen steady noisy odometry, with which the matches agreed."""
    check, rng = OdometryDoubt(DoubtConfig()), np.random.default_rng(seed)
    for _ in range(n):
        increment = GOES_ON + rng.normal(0.0, STD_M, 3)
        check.start_scan(told(increment), GOES_ON, STEP_S)
        assert check.widened(told(increment)).cov is COV
    return check


@pytest.mark.parametrize("seed", range(5))
def test_a_robot_that_takes_its_time_is_never_in_doubt(seed: int) -> None:
    check, rng, speed = driven(), np.random.default_rng(seed), SPEED_M_S
    for k in range(300):
        speed += (1.0 if k // 50 % 2 else -1.0) * 0.8 * STEP_S * (0.0 <= speed <= 1.0)
        increment = np.array([speed * STEP_S, 0.0, 0.0]) + rng.normal(0.0, STD_M, 3)
        check.start_scan(told(increment), increment, STEP_S)
        assert not check.is_in_doubt


@pytest.mark.parametrize("share", [0.0, -1.0, 3.0], ids=["sticks", "counts backward", "counts thrice"])
def test_the_way_is_as_unsure_as_both_are_apart(share: float) -> None:
    check, wrong = driven(), told(share * GOES_ON)
    extra = np.zeros((3, 3))
    for k in range(1, 21):
        check.start_scan(wrong, GOES_ON, STEP_S)
        assert check.is_in_doubt
        motion = check.widened(wrong)
        np.testing.assert_array_equal(motion.increment, wrong.increment)
        extra += motion.cov - COV
        assert check.apart_m == pytest.approx(k * abs(share - 1.0) * GOES_ON[0], rel=0.1)
        np.testing.assert_allclose(np.trace(extra), check.apart_m**2, rtol=1e-9)
    check.start_scan(told(GOES_ON), GOES_ON, STEP_S)
    assert not check.is_in_doubt
    assert check.widened(told(GOES_ON)).cov is COV


def test_a_match_that_tells_the_way_decides() -> None:
    for factor, is_in_doubt in ((0.0, False), (1.0, True)):
        check, stuck = driven(), told(np.zeros(3))
        check.start_scan(stuck, GOES_ON, STEP_S)
        check.widened(stuck)
        check.learn(stuck.increment, factor * GOES_ON, found_by(0.005))
        assert check.is_in_doubt is is_in_doubt
        assert check.apart_m < 0.005  # the match tells how far


@pytest.mark.parametrize(
    "match", [found_by(0.05), found_by(0.005, is_told=False)], ids=["bare corridor", "one person ahead"]
)
def test_what_does_not_tell_the_way_decides_nothing(match: MatchedPose) -> None:
    check, stuck = driven(), told(np.zeros(3))
    for _ in range(10):
        check.start_scan(stuck, GOES_ON, STEP_S)
        check.widened(stuck)
        check.learn(stuck.increment, np.zeros(3), match)
        assert check.is_in_doubt


def test_odometry_that_goes_on_is_not_in_doubt_where_the_matches_leave_it() -> None:
    """As where people who walk along with the robot hold its match."""
    check = driven()
    for _ in range(50):
        check.start_scan(told(GOES_ON), np.zeros(3), STEP_S)
        assert not check.is_in_doubt


def test_odometry_that_comes_to_agree_with_the_matches_is_not_in_doubt() -> None:
    check = driven()
    check.start_scan(told(np.zeros(3)), np.zeros(3), STEP_S)
    assert not check.is_in_doubt


def test_odometry_that_repeats_its_pose_while_the_matches_move_is_dead_until_it_moves() -> None:
    check, still = driven(), told(np.zeros(3))
    for k in range(20):
        check.start_scan(still, GOES_ON, STEP_S)
        check.widened(still)
        assert check.is_dead is (k > 11)
        check.learn(still.increment, GOES_ON, found_by(0.005, at=k * GOES_ON))
    check.start_scan(told(GOES_ON), GOES_ON, STEP_S)
    assert not check.is_dead


def test_a_robot_that_stands_has_no_dead_odometry() -> None:
    check, still, rng = driven(), told(np.zeros(3)), np.random.default_rng(2)
    for _ in range(500):
        check.start_scan(still, np.zeros(3), STEP_S)
        beside = np.array([0.01, 0.0, 0.0]) + rng.normal(0.0, 0.005, 3)  # as the wheels hold the pose
        check.learn(still.increment, beside, found_by(0.005, at=beside))
        assert not check.is_dead


@pytest.mark.parametrize("is_comparable", [True, False], ids=["one laser", "two lasers"])
def test_odometry_that_has_not_moved_where_a_match_did_may_never_do_so(is_comparable: bool) -> None:
    check, still, rng = OdometryDoubt(DoubtConfig()), told(np.zeros(3)), np.random.default_rng(3)
    for _ in range(200):  # the robot stands
        check.start_scan(still, np.zeros(3), STEP_S, is_comparable=is_comparable)
        assert check.widened(still).cov is COV
        check.learn(still.increment, rng.normal(0.0, 0.005, 3), found_by(0.006, std_y_m=0.006))
    check.learn(still.increment, GOES_ON, found_by(0.005))
    for _ in range(5):
        check.start_scan(still, np.zeros(3), STEP_S, is_comparable=is_comparable)
        np.testing.assert_allclose(check.widened(still).cov, COV + (0.2 * STEP_S) ** 2 * np.eye(3))
    sets_off = told(0.1 * GOES_ON)
    check.start_scan(sets_off, np.zeros(3), STEP_S, is_comparable=is_comparable)
    assert check.widened(sets_off).cov is COV


@pytest.mark.parametrize("end", [lambda c: c.start_scan(None, GOES_ON, STEP_S), OdometryDoubt.end])
def test_a_scan_without_odometry_or_match_ends_a_doubt(end: Callable[[OdometryDoubt], None]) -> None:
    check = driven()
    check.start_scan(told(np.zeros(3)), GOES_ON, STEP_S)
    assert check.is_in_doubt
    end(check)
    assert not check.is_in_doubt
    check.start_scan(told(np.zeros(3)), GOES_ON, STEP_S)  # nothing to compare with
    assert not check.is_in_doubt


@given(
    st.lists(st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2)), min_size=1, max_size=30),
    st.floats(0.001, 0.1),
)
def test_covariances_are_never_less_than_the_odometrys(
    steps: list[tuple[float, float]], std_m: float
) -> None:
    check = driven(10)
    for x, y in steps:
        motion = told(np.array([x, y, 0.0]))
        check.start_scan(motion, GOES_ON, STEP_S)
        extra = check.widened(motion).cov - COV
        assert np.linalg.eigvalsh(extra)[0] >= -1e-12
        check.learn(motion.increment, GOES_ON, found_by(std_m))
        assert check.apart_m >= 0.0


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="begin_sigmas"):
        DoubtConfig(begin_sigmas=0.0)
