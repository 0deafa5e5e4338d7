"""Propagation: the motion since the scan before, and a pose with its covariances propagated along it.

The only part of localization that reads a scan's odometry: the others get increments and poses from here.
"""

import math
from typing import NamedTuple, Protocol

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.scan import Scan
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.deskew import beam_times_of, knot_times, sweep_at_velocity, sweep_by_track
from slammot_graph.odometry.history import ScanClock
from slammot_graph.odometry.motion import NO_DOUBT, MatchedPose, Motion
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise


class MotionModel(Protocol):
    """What tells of the motion between scans: wheels, an IMU's yaw rate, or the motion before."""

    @property
    def T_odom_base(self) -> FloatArray:
        """(3,) dead-reckoned pose at the scan of the last `advance`; where its frame lies does not matter."""

    @property
    def is_contradicted(self) -> bool:
        """Whether there is odometry at the latest scan that cannot be believed."""

    @property
    def most_change_m(self) -> float:
        """How far off the latest motion a robot can have come [m]; infinite where that is not the odometry's."""

    @property
    def match_noise_scale(self) -> float:
        """How much larger the matches' standard deviations are than they claim, at least 1."""

    @property
    def common_stds(self) -> FloatArray:
        """(4,) standard deviations of what the errors of all increments have in common.

        Scale of the distance, direction [rad], heading bias [rad/m] and scale of the turn.
        """

    def advance(self, scan: Scan) -> Motion | None:
        """Move on to the next scan: the motion since the one before, None at the first."""

    def during_sweep(self, scan: Scan) -> SweepMotion:
        """Give the motion during the sweep of the scan of the last `advance`, which has beam times."""

    def correct(self, T_local_base: FloatArray, match: MatchedPose | None) -> None:
        """Take in where the base was found at the scan of the last `advance`, local frame (3,), and by which match.

        A model that predicts from earlier motion or calibrates itself learns from this.
        """

    def report(self) -> OdometryReport:
        """Give what was found out about the odometry."""


class WheelOdometry:
    """The motion that the wheels tell, with the covariance of a noise model.

    Attributes
    ----------
    noise : OdometryNoise or ConstantNoise
    T_odom_base : (3,) array
    """

    is_contradicted = False
    most_change_m = math.inf
    match_noise_scale = 1.0

    def __init__(self, noise: OdometryNoise | ConstantNoise) -> None:
        self.noise = noise
        self.T_odom_base: FloatArray = se2.IDENTITY
        self._is_first = True
        self._clock = ScanClock()
        self._latest: Motion | None = None

    @property
    def common_stds(self) -> FloatArray:
        """See `MotionModel`: as the noise model has it."""
        return self.noise.common_stds

    def advance(self, scan: Scan) -> Motion | None:
        """See `MotionModel`.

        Raises
        ------
        InputError
            The scan has no odometry.
        """
        if scan.T_odom_base is None:
            raise InputError(
                f"scan {scan.index} has no odometry, by which this method tells the motion; choose one that matches"
                " scans, as `graph`"
            )
        before, self.T_odom_base = self.T_odom_base, scan.T_odom_base
        self._clock.advance(scan.stamp)
        if self._is_first:
            self._is_first = False
            return None
        increment = se2.between(before, self.T_odom_base)
        self._latest = Motion(increment=increment, cov=self.noise.covariance(increment))
        return self._latest

    def during_sweep(self, scan: Scan) -> SweepMotion:
        """See `MotionModel`: by the odometry around the scan, or at the velocity before where that is not known."""
        times_s = knot_times(beam_times_of(scan))
        if scan.odometry is not None:
            return sweep_by_track(times_s, scan.stamp, scan.odometry, self.noise)
        if self._latest is None:
            return sweep_at_velocity(times_s, np.zeros(3), np.zeros((3, 3)))
        step_s = self._clock.step_s
        return sweep_at_velocity(
            times_s, se2.log(self._latest.increment) / step_s, self._latest.cov / step_s**2
        )

    def correct(self, T_local_base: FloatArray, match: MatchedPose | None) -> None:
        """See `MotionModel`; nothing is learnt."""

    def report(self) -> OdometryReport:
        """See `MotionModel`."""
        return OdometryReport()


class MotionState(NamedTuple):
    """A pose in the local frame, and how well it is known; all covariances are right perturbations (body frame).

    Attributes
    ----------
    T_local_base : (3,) array
    cov_prior : (3, 3) array
        Of the pose relative to the local map's anchor as the graph counts it, what the next match is weighed against.
    cov_independent : (3, 3) array
        Of the pose relative to the anchor: the errors that the scans do not share.
    cov_correlated : (3, 3) array
        The errors that the matches of neighbouring scans share; the motion leaves it as it is.
    cov_odometry : (3, 3) array
        Of the odometry's motion since the last keyframe.
    cov_motion : (3, 3) array
        Of the motion since the scan before, which is part of all of them but `cov_correlated`.
    doubt : (2,) array
        Direction in which that motion is in doubt, body frame; zero: in none.
    """

    T_local_base: FloatArray
    cov_prior: FloatArray
    cov_independent: FloatArray
    cov_correlated: FloatArray
    cov_odometry: FloatArray
    cov_motion: FloatArray
    doubt: FloatArray = NO_DOUBT

    @property
    def cov_relative(self) -> FloatArray:
        """(3, 3) covariance of the pose relative to the local map's anchor."""
        return self.cov_independent + self.cov_correlated

    def moved(self, motion: Motion) -> "MotionState":
        """Carry the pose and its covariances along a motion."""
        covs = np.empty((3, 3, 3))
        se2.compound_three(
            self.cov_prior, self.cov_independent, self.cov_odometry, motion.increment, motion.cov, covs
        )
        return MotionState(
            se2.compose(self.T_local_base, motion.increment),
            covs[0],
            covs[1],
            self.cov_correlated,
            covs[2],
            motion.cov,
            motion.doubt,
        )

    def loosened(self, extra: FloatArray) -> "MotionState":
        """Trust the motion since the scan before less, by an extra covariance (3, 3) (body frame)."""
        return self._replace(
            cov_prior=self.cov_prior + extra,
            cov_independent=self.cov_independent + extra,
            cov_odometry=self.cov_odometry + extra,
            cov_motion=self.cov_motion + extra,
        )


class Propagation:
    """The pose in the local frame from scan to scan: predicted here, corrected by whoever matches.

    Parameters
    ----------
    model : MotionModel
    cov : (3, 3) array
        Covariance of the first pose, which is the local frame's origin.

    Attributes
    ----------
    state : MotionState
        As best known now.
    predicted : MotionState
        As predicted for the latest scan.
    T_local_before : (3,) array
        The pose at the scan before.
    path_m : float
        Length of the path so far [m].
    """

    def __init__(self, model: MotionModel, cov: FloatArray) -> None:
        self.model = model
        self.state = MotionState(
            T_local_base=se2.IDENTITY,
            cov_prior=cov,
            cov_independent=cov,
            cov_correlated=np.zeros((3, 3)),
            cov_odometry=np.zeros((3, 3)),
            cov_motion=np.zeros((3, 3)),
        )
        self.predicted = self.state
        self.T_local_before: FloatArray = se2.IDENTITY
        self.path_m = 0.0

    @property
    def T_odom_base(self) -> FloatArray:
        """(3,) dead-reckoned pose at the latest scan."""
        return self.model.T_odom_base

    def predict(self, scan: Scan) -> None:
        """Move on to the next scan."""
        self.T_local_before = self.state.T_local_base
        motion = self.model.advance(scan)
        if motion is not None:
            self.state = self.state.moved(motion)
            self.path_m += math.hypot(motion.increment[0], motion.increment[1])
        self.predicted = self.state

    def restart(self) -> MotionState:
        """Go back to the prediction, as before another match of the same scan.

        What the matches share is that of the latest one that succeeded, so it stays.
        """
        self.state = self.predicted._replace(cov_correlated=self.state.cov_correlated)
        return self.state

    def start_keyframe(self) -> None:
        """Begin to gather the odometry's errors anew."""
        self.state = self.state._replace(cov_odometry=np.zeros((3, 3)))

    def lose_track(self, cov: FloatArray, distance_m: float) -> None:
        """Take the motion since the last keyframe for unknown, up to a covariance (3, 3) and a distance."""
        cov_odometry = self.state.cov_odometry + cov
        self.state = self.state._replace(
            cov_prior=cov_odometry,
            cov_independent=cov_odometry,
            cov_correlated=np.zeros((3, 3)),
            cov_odometry=cov_odometry,
        )
        self.path_m += distance_m

    def commit(self, match: MatchedPose | None) -> None:
        """Tell the motion model where the base was found at this scan, and by which match."""
        self.model.correct(self.state.T_local_base, match)
