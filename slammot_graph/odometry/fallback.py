"""Odometry as it is, and the previous motion where a scan has none: for methods that do not learn."""

import math

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.scan import Scan
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.deskew import beam_times_of, knot_times, sweep_at_velocity, sweep_by_track
from slammot_graph.odometry.history import ScanClock
from slammot_graph.odometry.motion import MatchedPose, Motion
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise
from slammot_graph.odometry.previous_motion import PreviousMotion, PreviousMotionConfig


class OdometryOrPreviousMotion:
    """A `MotionModel`: the odometry where two scans in a row have it, else the previous motion.

    Attributes
    ----------
    noise : OdometryNoise or ConstantNoise
    previous : PreviousMotion
    T_odom_base : (3,) array
    """

    is_contradicted = False
    most_change_m = math.inf
    match_noise_scale = 1.0

    def __init__(self, noise: OdometryNoise | ConstantNoise) -> None:
        self.noise = noise
        self.previous = PreviousMotion(PreviousMotionConfig())
        self.T_odom_base: FloatArray = se2.IDENTITY
        self._clock = ScanClock()
        self._T_odom_before: FloatArray | None = None
        self._T_local_before: FloatArray | None = None
        self._is_first = True

    @property
    def common_stds(self) -> FloatArray:
        """See `MotionModel`: as the noise model has it."""
        return self.noise.common_stds

    def advance(self, scan: Scan) -> Motion | None:
        """See `MotionModel`."""
        self._clock.advance(scan.stamp)
        before, self._T_odom_before = self._T_odom_before, scan.T_odom_base
        if self._is_first:
            self._is_first = False
            return None
        if before is None or scan.T_odom_base is None:
            motion = self.previous.motion(self._clock)
        else:
            increment = se2.between(before, scan.T_odom_base)
            motion = Motion(increment=increment, cov=self.noise.covariance(increment))
        self.T_odom_base = se2.compose(self.T_odom_base, motion.increment)
        return motion

    def during_sweep(self, scan: Scan) -> SweepMotion:
        """See `MotionModel`: by the odometry around the scan, or at the velocity before where there is none."""
        times_s = knot_times(beam_times_of(scan))
        if scan.T_odom_base is not None and scan.odometry is not None:
            return sweep_by_track(times_s, scan.stamp, scan.odometry, self.noise)
        return sweep_at_velocity(
            times_s, self.previous.body_velocity(self._clock), self.previous.cov_velocity
        )

    def correct(self, T_local_base: FloatArray, match: MatchedPose | None) -> None:
        """See `MotionModel`; the previous motion learns from what was found, by whichever match."""
        if self._T_local_before is not None:
            found = se2.between(self._T_local_before, T_local_base)
            self.previous.learn(found, FOUND_COV, self._clock)
        self._T_local_before = T_local_base

    def report(self) -> OdometryReport:
        """See `MotionModel`; nothing is estimated."""
        return OdometryReport()


FOUND_COV: FloatArray = np.diag(np.square((0.01, 0.01, 0.005)))
"""Covariance of a matched increment."""
