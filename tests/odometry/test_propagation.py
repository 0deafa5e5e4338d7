from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry import MotionModel, OdometryNoise, Propagation, WheelOdometry
from tests.rooms import take_scan

FIRST_COV = 1e-8 * np.eye(3)
SCAN = take_scan(np.array([2.0, 0.0, 1.5]))
seeds = st.integers(0, 2**32 - 1)


def path(seed: int, n: int = 8) -> FloatArray:
    return np.random.default_rng(seed).normal(0.0, [3.0, 3.0, 2.0], (n, 3))


def propagation_along(T_odom_base: FloatArray) -> Propagation:
    propagation = Propagation(WheelOdometry(OdometryNoise()), FIRST_COV)
    for T in T_odom_base:
        propagation.predict(replace(SCAN, T_odom_base=T))
    return propagation


@given(seeds)
def test_wheels_tell_the_motion_between_their_poses(seed: int) -> None:
    model: MotionModel = WheelOdometry(OdometryNoise())
    poses = path(seed)
    assert model.advance(replace(SCAN, T_odom_base=poses[0])) is None
    for before, T in pairwise(poses):
        motion = model.advance(replace(SCAN, T_odom_base=T))
        assert motion is not None
        np.testing.assert_array_equal(motion.increment, se2.between(before, T))
        np.testing.assert_array_equal(motion.cov, OdometryNoise().covariance(motion.increment))
        np.testing.assert_array_equal(model.T_odom_base, T)
        model.correct(np.full(3, 9.0), None)  # which wheels do not learn from


@given(seeds)
def test_the_pose_and_the_path_are_those_of_the_odometry_until_a_match_corrects_them(seed: int) -> None:
    poses = path(seed)
    propagation = propagation_along(poses)
    expected = se2.between(poses[0], poses)
    assert abs(se2.between(expected[-1], propagation.state.T_local_base)).max() < 1e-9
    assert abs(se2.between(expected[-2], propagation.T_local_before)).max() < 1e-9
    assert propagation.path_m == pytest.approx(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    np.testing.assert_array_equal(propagation.T_odom_base, poses[-1])


@given(seeds)
def test_each_covariance_is_compounded_and_the_correlated_one_stays(seed: int) -> None:
    poses = path(seed)
    propagation = propagation_along(poses[:-1])
    correlated = np.diag([1e-4, 2e-4, 3e-5])
    before = propagation.state._replace(
        cov_independent=np.eye(3), cov_prior=2.0 * np.eye(3), cov_correlated=correlated
    )
    propagation.state = before
    propagation.predict(replace(SCAN, T_odom_base=poses[-1]))
    after, increment = propagation.state, se2.between(poses[-2], poses[-1])
    noise = OdometryNoise().covariance(increment)
    for name in ("cov_prior", "cov_independent", "cov_odometry"):
        expected = se2.compound_covariance(getattr(before, name), increment, noise)
        np.testing.assert_allclose(getattr(after, name), expected, rtol=1e-9, atol=1e-15)
        assert getattr(after, name)[2, 2] > getattr(before, name)[2, 2]
    np.testing.assert_array_equal(after.cov_relative, after.cov_independent + correlated)


def test_another_match_of_a_scan_starts_at_the_prediction() -> None:
    propagation = propagation_along(path(1))
    predicted = propagation.predicted
    assert propagation.state is predicted
    propagation.state = predicted._replace(
        T_local_base=np.ones(3), cov_prior=np.eye(3), cov_correlated=5.0 * np.eye(3)
    )
    again = propagation.restart()
    assert again is propagation.state
    np.testing.assert_array_equal(again.T_local_base, predicted.T_local_base)
    np.testing.assert_array_equal(again.cov_prior, predicted.cov_prior)
    np.testing.assert_array_equal(again.cov_correlated, 5.0 * np.eye(3))  # of the latest match that succeeded


def test_a_keyframe_starts_the_odometrys_errors_anew() -> None:
    propagation = propagation_along(path(2))
    before = propagation.state
    propagation.start_keyframe()
    assert not propagation.state.cov_odometry.any()
    np.testing.assert_array_equal(propagation.state.cov_prior, before.cov_prior)


def test_a_lost_robot_may_be_anywhere() -> None:
    propagation = propagation_along(path(3))
    before, path_m, wide = propagation.state, propagation.path_m, np.diag([9.0, 9.0, 0.64])
    propagation.lose_track(wide, 20.0)
    state = propagation.state
    for cov in (state.cov_prior, state.cov_independent, state.cov_odometry):
        np.testing.assert_array_equal(cov, before.cov_odometry + wide)
    assert not state.cov_correlated.any()
    np.testing.assert_array_equal(state.T_local_base, before.T_local_base)
    assert propagation.path_m == path_m + 20.0
