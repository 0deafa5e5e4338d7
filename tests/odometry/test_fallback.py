from dataclasses import replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry import MotionModel, OdometryNoise
from slammot_graph.odometry.fallback import OdometryOrPreviousMotion
from tests.rooms import take_scan

SCAN = take_scan(np.array([2.0, 0.0, 1.5]))
STEP = np.array([0.05, 0.01, 0.02])


def scan(k: int, T_odom_base: FloatArray | None) -> Scan:
    return replace(SCAN, index=k, stamp=100.0 + 0.1 * k, T_odom_base=T_odom_base)


def pose(k: int) -> FloatArray:
    T = np.array([1.0, -2.0, 0.4])
    for _ in range(k):
        T = se2.compose(T, STEP)
    return T


def test_the_odometry_is_believed_where_it_is() -> None:
    model: MotionModel = OdometryOrPreviousMotion(OdometryNoise())
    assert model.advance(scan(0, pose(0))) is None
    model.correct(np.zeros(3), None)
    told = np.array([0.4, -0.1, 0.3])
    motion = model.advance(scan(1, se2.compose(pose(0), told)))
    assert motion is not None
    np.testing.assert_allclose(motion.increment, told, atol=1e-12)
    np.testing.assert_allclose(motion.cov, OdometryNoise().covariance(told))
    np.testing.assert_allclose(model.T_odom_base, told, atol=1e-12)
    assert not model.is_contradicted


def test_the_previous_motion_takes_the_place_of_odometry_that_is_not_there() -> None:
    model = OdometryOrPreviousMotion(OdometryNoise())
    has_odometry = [k not in (5, 6, 7) for k in range(12)]
    for k, has in enumerate(has_odometry):
        motion = model.advance(scan(k, pose(k) if has else None))
        if k:
            assert motion is not None
            np.testing.assert_allclose(motion.increment, STEP, rtol=0.01, atol=1e-4)
            by_odometry = has and has_odometry[k - 1]
            is_noise = np.allclose(motion.cov, OdometryNoise().covariance(motion.increment))
            assert is_noise == by_odometry
        model.correct(pose(k), None)
    np.testing.assert_allclose(model.T_odom_base, se2.between(pose(0), pose(11)), rtol=0.01, atol=1e-3)


def test_without_any_odometry_it_learns_from_what_was_found() -> None:
    model = OdometryOrPreviousMotion(OdometryNoise())
    motion = None
    for k in range(4):
        motion = model.advance(scan(k, None))
        model.correct(pose(k), None)
    assert motion is not None
    np.testing.assert_allclose(motion.increment, STEP, rtol=0.01, atol=1e-4)
    assert not model.is_contradicted
