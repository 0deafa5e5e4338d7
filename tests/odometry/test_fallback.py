from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry import MotionModel, OdometryNoise, WheelOdometry
from slammot_graph.odometry.fallback import OdometryOrPreviousMotion, PreviousMotion
from tests.rooms import take_scan

SCAN = replace(take_scan(np.array([2.0, 0.0, 1.5])), T_odom_base=None)
INCREMENT = np.array([0.1, 0.02, 0.05])


def scan_at(stamp: float, **changes: object) -> Scan:
    return replace(SCAN, stamp=stamp, **changes)  # type: ignore[arg-type]


def drive(model: MotionModel, stamps: FloatArray, increment: FloatArray = INCREMENT) -> FloatArray:
    """Advance along a path of equal increments, matched each time; gives the path's end."""
    T = se2.IDENTITY
    for k, stamp in enumerate(stamps):
        model.advance(scan_at(float(stamp)))
        T = se2.compose(T, increment) if k else T
        model.correct(T)
    return T


def test_the_first_motion_is_unknown_and_then_goes_on() -> None:
    model: MotionModel = PreviousMotion()
    assert model.advance(scan_at(0.0)) is None
    model.correct(se2.IDENTITY)
    first = model.advance(scan_at(0.1))
    assert first is not None
    np.testing.assert_array_equal(first.increment, 0.0)
    assert np.sqrt(np.diag(first.cov)).min() >= 0.1
    model.correct(INCREMENT)
    second = model.advance(scan_at(0.2))
    assert second is not None
    np.testing.assert_allclose(second.increment, INCREMENT)
    assert (np.diag(second.cov) < np.diag(first.cov)).all()
    np.testing.assert_allclose(model.T_odom_base, INCREMENT)


def test_the_increment_is_scaled_by_the_time_and_its_covariance_grows() -> None:
    steps = np.cumsum([0.0, *[0.1] * 20])
    motions = []
    for step_s in (0.05, 0.1, 0.2):
        model = PreviousMotion()
        drive(model, steps)
        motions.append(model.advance(scan_at(steps[-1] + step_s)))
    half, whole, double = motions
    assert half is not None and whole is not None and double is not None
    np.testing.assert_allclose(half.increment, 0.5 * INCREMENT, atol=1e-9)
    np.testing.assert_allclose(double.increment, 2.0 * INCREMENT, atol=1e-9)
    assert (np.diag(half.cov) < np.diag(whole.cov)).all()
    assert (np.diag(whole.cov) < np.diag(double.cov)).all()


@pytest.mark.parametrize("step_s", [-0.5, 0.0, 0.001, 30.0])
def test_stamps_that_jump_do_not_change_the_speed(step_s: float) -> None:
    model = PreviousMotion()
    steps = np.cumsum([0.0, *[0.1] * 20])
    drive(model, steps)
    motion = model.advance(scan_at(steps[-1] + step_s))
    assert motion is not None
    np.testing.assert_allclose(motion.increment, INCREMENT, rtol=0.06)


def test_an_imu_tells_the_turn() -> None:
    model = PreviousMotion()
    model.advance(scan_at(0.0, imu_yaw=1.0))
    model.correct(se2.IDENTITY)
    motion = model.advance(scan_at(0.1, imu_yaw=1.3))
    assert motion is not None
    np.testing.assert_allclose(motion.increment, [0.0, 0.0, 0.3])
    assert np.sqrt(motion.cov[2, 2]) < 0.01


def test_wheels_are_used_where_there_are_any() -> None:
    noise = OdometryNoise()
    model, wheels = OdometryOrPreviousMotion(noise), WheelOdometry(noise)
    for k in range(5):
        scan = scan_at(0.1 * k, T_odom_base=k * INCREMENT + 7.0)
        by_wheels, motion = wheels.advance(scan), model.advance(scan)
        assert (motion is None) == (by_wheels is None) == (k == 0)
        if motion is not None and by_wheels is not None:
            np.testing.assert_array_equal(motion.increment, by_wheels.increment)
            np.testing.assert_array_equal(motion.cov, by_wheels.cov)
        np.testing.assert_array_equal(model.T_odom_base, wheels.T_odom_base)
        model.correct(model.T_odom_base)


def test_odometry_that_comes_and_goes() -> None:
    model = OdometryOrPreviousMotion(OdometryNoise())
    told = [0.0, 0.1, 0.2, None, None, 90.0, 90.1]
    T_before = None
    for k, x in enumerate(told):
        T_odom_base = None if x is None else np.array([x, 0.0, 0.0])
        motion = model.advance(scan_at(0.1 * k, T_odom_base=T_odom_base))
        model.correct(np.array([0.1 * k, 0.0, 0.0]))
        if T_before is not None:
            assert motion is not None
            np.testing.assert_allclose(motion.increment, [0.1, 0.0, 0.0], atol=1e-9)
            np.testing.assert_allclose(se2.between(T_before, model.T_odom_base), motion.increment, atol=1e-9)
        T_before = model.T_odom_base


def test_wheels_alone_need_odometry() -> None:
    with pytest.raises(InputError, match="scan 0 has no odometry"):
        WheelOdometry(OdometryNoise()).advance(scan_at(0.0))
