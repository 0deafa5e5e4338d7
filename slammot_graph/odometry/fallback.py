"""Motion without odometry: as between the scans before."""

import math

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise
from slammot_graph.odometry.propagation import Motion, WheelOdometry

FIRST_STD_M, FIRST_STD_RAD = 0.1, 0.1
"""Of the first increment, about which nothing is known."""

STILL_STD_M, STILL_STD_RAD = 0.01, 0.01
ACCELERATION_STD, TURN_ACCELERATION_STD = 2.0, 4.0
"""Standard deviations of an increment of no duration, and of the unknown acceleration [m/s^2, rad/s^2]."""

IMU_STD_RAD = 0.005
"""Of a turn that an IMU tells."""

MIN_STEP_S = 0.03
"""The velocity is taken over at least this time, as from scans closer together it would be mostly noise."""

USUAL_GAIN = 0.05
USUAL_RATIO = 2.5
"""Steps of the stamps further from the usual one by this factor tell nothing of time: then it is the usual one."""

MAX_STEP_S = 1.0
"""The motion is not carried on over a longer time."""


class PreviousMotion:
    """The base goes on as it went between the scans before; an IMU's yaw, where there is one, tells its turn.

    Attributes
    ----------
    T_odom_base : (3,) array
    """

    def __init__(self) -> None:
        self.T_odom_base: FloatArray = se2.IDENTITY
        self._velocity: FloatArray = np.zeros(3)
        self._scan: Scan | None = None
        self._step_s = 0.0
        self._usual_s = 0.0
        self._since_s = 0.0
        self._T_found: FloatArray | None = None
        self._n_found = 0

    def advance(self, scan: Scan) -> Motion | None:
        """See `MotionModel`."""
        before, self._scan = self._scan, scan
        if before is None:
            return None
        step_s = scan.stamp - before.stamp
        self._step_s = self._told_step(step_s)
        increment = self._velocity * self._step_s
        std_m = STILL_STD_M + 0.5 * ACCELERATION_STD * self._step_s**2
        std_rad = STILL_STD_RAD + 0.5 * TURN_ACCELERATION_STD * self._step_s**2
        if self._n_found < 2:
            std_m, std_rad = max(std_m, FIRST_STD_M), max(std_rad, FIRST_STD_RAD)
        if step_s > MAX_STEP_S:
            std_m, std_rad = std_m * step_s / MAX_STEP_S, min(std_rad * step_s / MAX_STEP_S, math.pi)
        if before.imu_yaw is not None and scan.imu_yaw is not None:
            increment[2], std_rad = scan.imu_yaw - before.imu_yaw, IMU_STD_RAD
        self.T_odom_base = se2.compose(self.T_odom_base, increment)
        return Motion(increment=increment, cov=np.diag(np.square((std_m, std_m, std_rad))))

    def correct(self, T_local_base: FloatArray) -> None:
        """See `MotionModel`."""
        self._since_s += self._step_s
        if self._T_found is not None and self._since_s < MIN_STEP_S:
            return
        if self._T_found is not None:
            self._velocity = se2.between(self._T_found, T_local_base) / self._since_s
        self._T_found, self._since_s, self._n_found = T_local_base, 0.0, self._n_found + 1

    def _told_step(self, step_s: float) -> float:
        """Time between two scans [s]: that of the stamps where it can be believed."""
        if 0.0 < step_s <= MAX_STEP_S:
            self._usual_s += (1.0 if self._usual_s == 0.0 else USUAL_GAIN) * (step_s - self._usual_s)
        is_usual = self._usual_s / USUAL_RATIO <= step_s <= self._usual_s * USUAL_RATIO
        return step_s if is_usual else self._usual_s


class OdometryOrPreviousMotion:
    """The wheels where a scan has odometry, and else the motion before.

    Attributes
    ----------
    wheels : WheelOdometry
    previous : PreviousMotion
    T_odom_base : (3,) array
    """

    def __init__(self, noise: OdometryNoise | ConstantNoise) -> None:
        self.wheels = WheelOdometry(noise)
        self.previous = PreviousMotion()
        self.T_odom_base: FloatArray = se2.IDENTITY
        self._noise = noise
        self._has_odometry = True
        self._is_pieced = False

    def advance(self, scan: Scan) -> Motion | None:
        """See `MotionModel`."""
        motion = self.previous.advance(scan)
        had_odometry, self._has_odometry = self._has_odometry, scan.T_odom_base is not None
        if self._has_odometry and not had_odometry:
            self.wheels = WheelOdometry(self._noise)
        by_wheels = self.wheels.advance(scan) if self._has_odometry else None
        motion = by_wheels or motion
        self._is_pieced |= not self._has_odometry
        if not self._is_pieced:
            self.T_odom_base = self.wheels.T_odom_base
        elif motion is not None:
            self.T_odom_base = se2.compose(self.T_odom_base, motion.increment)
        return motion

    def correct(self, T_local_base: FloatArray) -> None:
        """See `MotionModel`."""
        self.previous.correct(T_local_base)
