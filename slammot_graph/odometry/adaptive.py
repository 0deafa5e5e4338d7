"""Odometry that is learnt, not believed: calibrated from the matches, and left aside where it cannot be right.

Two predictions of each motion stand side by side: the odometry, corrected by what `SelfCalibration` found, and the
previous motion. The one whose predictions were nearer to the matches of late is used; an increment of the odometry that
no robot can make since the scan before is never used.
"""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import AtLeastOne, Checked, Positive, PositiveShare, Share
from slammot_graph.core.odometry_report import MotionSource, OdometryReport
from slammot_graph.core.scan import Scan
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry._motion_kernels import judge_predictions, relative
from slammot_graph.odometry.calibration import SelfCalibration
from slammot_graph.odometry.calibration_config import CalibrationConfig
from slammot_graph.odometry.deskew import (
    MIN_SWEEP_S,
    beam_times_of,
    knot_times,
    relative_poses,
    sweep_along,
    sweep_at_velocity,
)
from slammot_graph.odometry.doubt import DoubtConfig
from slammot_graph.odometry.history import OdometryHistory
from slammot_graph.odometry.innovation_noise import InnovationNoise, InnovationNoiseConfig
from slammot_graph.odometry.motion import MatchedPose, Motion
from slammot_graph.odometry.noise import NOTHING_COMMON, ConstantNoise, OdometryNoise
from slammot_graph.odometry.prediction_record import Located, PredictionRecord
from slammot_graph.odometry.previous_motion import PreviousMotion, PreviousMotionConfig

MAX_MATCH_VARIANCE = 0.01
"""A match that is known worse in some direction [m^2, rad^2] tells nothing of the noise."""


@dataclass(frozen=True, kw_only=True)
class AdaptiveOdometryConfig(Checked):
    """How odometry is learnt and judged.

    Attributes
    ----------
    calibration : CalibrationConfig
    previous_motion : PreviousMotionConfig
    innovation_noise : InnovationNoiseConfig
    doubt : DoubtConfig
    max_acceleration_m_s2, max_acceleration_rad_s2 : float
        No robot changes its velocity faster: an increment of the odometry is wrong that asks for more after the motion
        before, and after the latest increment that was not wrong.
    error_gain : float
        Weight of the latest scan in the running means by which both predictions are judged, that of an equal share in
        the mean at first.
    error_lever_m : float
        A turn counts as its arc at this distance.
    error_cap_m : float
        A single error counts for no more than this.
    hysteresis : float
        The other prediction is used once its mean squared error is smaller by this factor.
    min_excess, max_excess : float
        The odometry is left only while its squared errors exceed what its noise explains by this factor in the mean,
        where a single one counts for no more than the second: one slip alone is none of it.
    explained_excess : float
        It is used again once they exceed that by no more than this, also where the previous motion does as well: down a
        corridor that goes on predicting itself, as the matches follow it.
    min_agreement_to_leave, min_agreement_to_stay : float
        The odometry is left while more of the returns agree with the matches than this in the mean, and comes back when
        fewer do: where much of what the laser sees moves, the matches are no judge.
    imu_std_rad : float
        Of a turn between two scans that an IMU tells.
    min_noise_scale, max_noise_scale : float
        Bounds of the learnt scale of the noise's standard deviation; `innovation_noise` alone goes below.
    """

    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    previous_motion: PreviousMotionConfig = field(default_factory=PreviousMotionConfig)
    innovation_noise: InnovationNoiseConfig = field(default_factory=InnovationNoiseConfig)
    doubt: DoubtConfig = field(default_factory=DoubtConfig)
    max_acceleration_m_s2: Positive = 10.0
    max_acceleration_rad_s2: Positive = 30.0
    error_gain: PositiveShare = 0.1
    error_lever_m: Positive = 2.0
    error_cap_m: Positive = 0.5
    hysteresis: AtLeastOne = 2.0
    min_excess: Positive = 3.0
    explained_excess: Positive = 1.5
    max_excess: Positive = 20.0
    min_agreement_to_leave: Share = 0.8
    min_agreement_to_stay: Share = 0.65
    imu_std_rad: Positive = 0.005
    min_noise_scale: Positive = 1.0
    max_noise_scale: Positive = 3.0


class AdaptiveOdometry:
    """A `MotionModel` of odometry that calibrates itself, with the previous motion beside it.

    Attributes
    ----------
    config : AdaptiveOdometryConfig
    calibration : SelfCalibration
    previous : PreviousMotion
    innovations : InnovationNoise
    source : "odometry" or "previous motion"
        What is used where both are possible.
    T_odom_base : (3,) array
    """

    def __init__(self, noise: OdometryNoise | ConstantNoise, config: AdaptiveOdometryConfig) -> None:
        self.config = config
        self.noise = noise
        self.calibration = SelfCalibration(config.calibration, noise)
        self.previous = PreviousMotion(config.previous_motion)
        self.innovations = InnovationNoise(config.innovation_noise)
        self.source: MotionSource = "odometry"
        self.T_odom_base: FloatArray = se2.IDENTITY
        self._scan_before: Scan | None = None
        self._scan_s = 0.0
        self._history = OdometryHistory()
        self._record = PredictionRecord(config.doubt)
        self._located: dict[int, Located] = {}

    def advance(self, scan: Scan) -> Motion | None:
        """See `MotionModel`."""
        history, record, laser = self._history, self._record, scan.laser.number
        history.advance(scan.stamp, scan.T_odom_base, scan.odometry, laser)
        before, self._scan_before = self._scan_before, scan
        start_s, self._scan_s = self._scan_s, history.clock.now_s
        if before is None:
            return None
        told = None
        if scan.T_odom_base is not None and before.T_odom_base is not None:
            told = self._by_odometry(start_s, self._scan_s)
        told_own, elapsed_s = told, None
        if before.laser.number != laser:  # the motion since the same laser's scan before is what is judged
            told_own, own = None, self._located.get(laser)
            if own is not None and own.has_odometry and scan.T_odom_base is not None:
                told_own = self._by_odometry(own.time_s, self._scan_s)
            elapsed_s = max(self._scan_s - start_s, 0.0)
        record.start_scan(told_own, self.previous.increment(history.clock))
        is_possible = (
            told_own is None
            or not history.clock.is_steady
            or self._can_follow(told_own.increment, record.told_possible)
        )
        is_comparable = is_possible and history.clock.is_steady and told_own is told
        record.doubt.start_scan(told, record.previous, history.clock.step_s, is_comparable=is_comparable)
        is_used = is_possible and self.source == "odometry" and not record.doubt.is_dead
        used = record.doubt.widened(told) if told is not None and is_used else None
        motion = used or self.previous.motion(history.clock, elapsed_s)
        if not is_possible:
            self.calibration.exclude(self._scan_s + self.calibration.now.clock_offset_s.value)
        record.count(use_odometry=used is not None, is_possible=is_possible)
        if before.imu_yaw is not None and scan.imu_yaw is not None:
            motion = motion.turned(scan.imu_yaw - before.imu_yaw, self.config.imu_std_rad)
        self.T_odom_base = se2.compose(self.T_odom_base, motion.increment)
        return motion

    def during_sweep(self, scan: Scan) -> SweepMotion:
        """See `MotionModel`: by the odometry where it is used, and where a robot can have moved so."""
        times_s = knot_times(beam_times_of(scan))
        record, previous = self._record, self.previous
        if scan.T_odom_base is not None and (record.told is None or record.is_odometry_used):
            by_odometry = self._sweep_by_odometry(times_s)
            duration_s = max(by_odometry.last_s - by_odometry.first_s, MIN_SWEEP_S)
            change = duration_s * (by_odometry.velocity - previous.body_velocity(self._history.clock))
            step_s = self._history.clock.step_s + duration_s
            if record.told is None or self._is_possible_change(change, duration_s * step_s):
                return by_odometry
        return sweep_at_velocity(times_s, previous.body_velocity(self._history.clock), previous.cov_velocity)

    def correct(self, T_local_base: FloatArray, match: MatchedPose | None) -> None:
        """See `MotionModel`."""
        now_s = self._scan_s
        record = self._record
        record.agreement.add(0.0 if match is None else match.agreement, self.config.error_gain)
        if (
            self.source == "previous motion"
            and record.agreement.values[0] < self.config.min_agreement_to_stay
        ):
            self.source = "odometry"
        if match is None:
            self.previous.miss()
            record.doubt.end()
        scan = self._scan_before
        laser = 0 if scan is None else scan.laser.number
        before = self._located.get(laser)
        if match is not None and before is not None:
            self._learn(before.T_local_base, match)
            if before.match is not None:
                found = np.empty(3)
                relative(before.match.T_local_base, match.T_local_base, found)
                self._compare_noise(found, match)
                if match.is_reliable and before.match.is_reliable:
                    self._calibrate((before.time_s, before.match), (now_s, match), found)
        has_odometry = scan is not None and scan.T_odom_base is not None
        self._located[laser] = Located(now_s, T_local_base, has_odometry, match)

    @property
    def match_noise_scale(self) -> float:
        """See `MotionModel`."""
        return self.innovations.match_scale

    @property
    def common_stds(self) -> FloatArray:
        """See `MotionModel`: of the calibration, or of the noise model where nothing is calibrated."""
        if not self._record.is_odometry_used:
            return NOTHING_COMMON
        now = self.calibration.now
        stds = np.array(
            [
                now.distance_scale.std,
                now.direction_rad.std,
                now.heading_bias_rad_per_m.std,
                now.heading_scale.std,
            ]
        )
        return np.where(np.isfinite(stds), stds, self.noise.common_stds)

    @property
    def is_contradicted(self) -> bool:
        """See `MotionModel`."""
        return self._record.told is not None and not self._record.is_odometry_used

    @property
    def most_change_m(self) -> float:
        """See `MotionModel`: where the odometry is used."""
        if (
            self._record.told is None
            or not self._record.is_odometry_used
            or not self._history.clock.is_steady
        ):
            return math.inf
        return self._most_change_m(self._history.clock.step_s**2)

    def report(self) -> OdometryReport:
        """What was found out so far."""
        now, record = self.calibration.now, self._record
        return OdometryReport(
            source=self.source if record.has_odometry else "previous motion",
            has_odometry=record.has_odometry,
            clock_offset_s=now.clock_offset_s,
            distance_scale=now.distance_scale,
            heading_scale=now.heading_scale,
            heading_bias_rad_per_m=now.heading_bias_rad_per_m,
            direction_rad=now.direction_rad,
            laser_shift_x_m=now.laser_shift_m[0],
            laser_shift_y_m=now.laser_shift_m[1],
            noise_scale_m=now.noise_scale_m,
            noise_scale_rad=now.noise_scale_rad,
            n_by_odometry=record.n_by_odometry,
            n_by_previous_motion=record.n_by_previous,
            n_contradictions=record.n_impossible,
        )

    def _by_odometry(self, start_s: float, end_s: float) -> Motion:
        """The odometry's motion between two times, both shifted by the clock offset; corrected, with its covariance."""
        now = self.calibration.now
        offset_s = now.clock_offset_s.value
        increment = np.empty(3)
        relative(
            self._history.pose_at(start_s + offset_s), self._history.pose_at(end_s + offset_s), increment
        )
        increment = now.corrected(increment)
        return Motion(increment=increment, cov=self._noise_of(increment))

    def _noise_of(self, increment: FloatArray) -> FloatArray:
        """(3, 3) covariance of an increment (3,) of the odometry, as far as its noise is learnt."""
        now, config = self.calibration.now, self.config
        cov = self.noise.covariance(increment)
        scale_m = min(max(now.noise_scale_m.value, config.min_noise_scale), config.max_noise_scale)
        scale_rad = min(max(now.noise_scale_rad.value, config.min_noise_scale), config.max_noise_scale)
        below_m, below_rad = self.innovations.scales
        scale_m, scale_rad = (
            (scale_m if below_m == 1.0 else below_m),
            (scale_rad if below_rad == 1.0 else below_rad),
        )
        if scale_m != 1.0 or scale_rad != 1.0:
            cov *= _scaling(scale_m, scale_rad)
        return cov

    def _sweep_by_odometry(self, times_s: FloatArray) -> SweepMotion:
        """Give the motion (m,) knots after the scan; beyond the odometry known, the velocity may have changed."""
        now, history = self.calibration.now, self._history
        stamp_s = self._scan_s + now.clock_offset_s.value
        poses = history.going_on(np.append(stamp_s, stamp_s + times_s))
        T = now.corrected(relative_poses(poses[0], poses[1:]))
        sweep = sweep_along(times_s, T, self._noise_of(relative_poses(T[0], T[-1:])[0]))
        ahead_s = stamp_s + sweep.last_s - history.end_s
        if ahead_s <= 0.0:
            return sweep
        share = min(ahead_s / max(sweep.last_s - sweep.first_s, MIN_SWEEP_S), 1.0)
        return replace(sweep, cov_velocity=sweep.cov_velocity + share**2 * self.previous.cov_velocity)

    def _can_follow(self, increment: FloatArray, other: FloatArray | None) -> bool:
        """Tell whether a robot can have made an increment (3,), given that before by the matches, or another one (3,).

        Of two that differ at once the one that has gone on as before is not wrong.
        """
        time_s2, previous = self._history.clock.step_s**2, self._record.previous
        return self._is_possible_change(increment - previous, time_s2) or (
            other is not None and self._is_possible_change(increment - other, time_s2)
        )

    def _is_possible_change(self, change: FloatArray, time_s2: float) -> bool:
        """Tell whether a motion can differ so (3,) from the one at the velocity before."""
        dx, dy, turn = change.tolist()
        if math.hypot(dx, dy) > self._most_change_m(time_s2):
            return False
        return bool(abs(turn) < self.config.max_acceleration_rad_s2 * time_s2 + 0.05)

    def _most_change_m(self, time_s2: float) -> float:
        """By how much a motion can differ from that of the velocity before; a little more for noise."""
        return self.config.max_acceleration_m_s2 * time_s2 + 0.05

    def _learn(self, T_before: FloatArray, match: MatchedPose) -> None:
        """Let the previous motion learn from a match, and judge both predictions by one that is reliable.

        What leaps as no robot does, away from both, tells of no motion: the pose before was wrong, or this one is.
        """
        found, record = np.empty(3), self._record
        relative(T_before, match.T_local_base, found)
        is_leap = record.told is not None and not self._can_follow(found, record.told.increment)
        if match.is_elsewhere and record.is_odometry_used and not is_leap:
            self.source = "previous motion"  # nothing explains the scan where the odometry leads
        if record.told is not None:
            record.doubt.learn(record.told.increment, found, match)
            if match.is_reliable and record.is_possible:
                self._compare(record.told, found, match)
        if not is_leap:
            self.previous.learn(found, match.cov, self._history.clock)

    def _compare(self, told: Motion, found: FloatArray, match: MatchedPose) -> None:
        """Judge both predictions by the increment (3,) that a match found."""
        record, config = self._record, self.config
        judge_predictions(
            told.increment,
            told.cov,
            record.previous,
            found,
            match.cov,
            config.error_lever_m,
            config.error_cap_m,
            record.errors.gain(config.error_gain),
            config.max_excess,
            record.errors.values,
        )
        own, other, excess = record.errors.values.tolist()
        if self.source == "odometry":
            is_agreed = record.agreement.values[0] > config.min_agreement_to_leave
            if is_agreed and own > config.hysteresis * other and excess > config.min_excess:
                self.source = "previous motion"
        elif other > config.hysteresis * own or excess < config.explained_excess:
            self.source = "odometry"

    def _compare_noise(self, found: FloatArray, match: MatchedPose) -> None:
        """Give the difference of two matches in a row (3,) and the odometry to the estimate of their noise."""
        told = self._record.told
        if told is None or not self._record.is_odometry_used:
            return
        xx, _, _, _, yy, _, _, _, variance_rad2 = match.cov.ravel().tolist()
        if not max(xx, yy, variance_rad2) < MAX_MATCH_VARIANCE:
            return
        model = self.noise.variances(told.increment)
        self.innovations.add(found - told.increment, told.increment, model, (0.5 * (xx + yy), variance_rad2))

    def _calibrate(
        self, before: tuple[float, MatchedPose], after: tuple[float, MatchedPose], increment: FloatArray
    ) -> None:
        """Give two matches in a row, and the increment (3,) between them, to the calibration."""
        if not self._history.clock.is_regular or self._record.told is None:
            return
        cov = before[1].cov_independent + after[1].cov_independent
        xx, _, _, _, yy, _, _, _, variance_rad2 = cov.ravel().tolist()
        variances = 0.5 * (xx + yy), variance_rad2
        laser = 0 if self._scan_before is None else self._scan_before.laser.number
        self.calibration.add(
            (before[0], after[0]), increment, variances, after[1].T_local_base, self._history, laser
        )


@lru_cache(maxsize=16)
def _scaling(scale_m: float, scale_rad: float) -> FloatArray:
    """(3, 3) factors of a covariance whose standard deviations are scaled."""
    mm, mr, rr = scale_m * scale_m, scale_m * scale_rad, scale_rad * scale_rad
    factors = np.array([[mm, mm, mr], [mm, mm, mr], [mr, mr, rr]])
    factors.setflags(write=False)
    return factors
