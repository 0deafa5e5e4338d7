"""The odometry on a clock that never runs backward, to be asked for poses between the scans."""

import math
from bisect import bisect_left

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.types import FloatArray, IntArray

MAX_STEP_RATIO = 20.0
"""A step of the stamps that is no step forward, or longer than this many usual ones, tells nothing of time."""

USUAL_RATIO = 2.5
"""A step of the stamps within this ratio of the mean is a usual one."""

USUAL_GAIN = 0.05
"""Weight of the latest step in the mean of the usual ones."""

FIRST_STEP_S = 0.1
"""Time between two scans as long as none is known [s]."""


MOST_ACCELERATION: FloatArray = np.array([10.0, 10.0, 30.0])
"""Velocities of the odometry that change by more [m/s^2, m/s^2, rad/s^2] are none of a robot."""


class ScanClock:
    """Time from scan to scan, which rises whatever the stamps do.

    Attributes
    ----------
    now_s : float
        Time of the latest scan since the first one [s]: the stamps' own where they rise, usual steps elsewhere.
    first_stamp : float
    step_s : float
        Since the scan before, as velocities count it [s].
    leap_s : float
        What the stamps have leapt forward beyond that [s], be it the clock that was set or a time without scans.
    is_regular : bool
        The latest step is that of the stamps.
    is_steady : bool
        The latest two steps are usual ones.
    """

    def __init__(self) -> None:
        self.now_s = 0.0
        self.first_stamp = 0.0
        self.step_s = FIRST_STEP_S
        self.leap_s = 0.0
        self.is_regular = False
        self.is_steady = False
        self._was_usual = False
        self._usual_s = math.nan
        self._stamp = math.nan
        self._has_start = False

    @property
    def is_started(self) -> bool:
        """Whether there was a scan."""
        return not math.isnan(self._stamp)

    def start(self, first_stamp: float, stamp: float) -> None:
        """Count from another clock's first stamp, until a first scan at `stamp`."""
        self.first_stamp, self.now_s = first_stamp, max(stamp - first_stamp, 0.0)
        self._has_start = True

    @property
    def usual_s(self) -> float:
        """Usual step [s]."""
        return FIRST_STEP_S if math.isnan(self._usual_s) else self._usual_s

    def advance(self, stamp: float, *, has_track: bool = False) -> None:
        """Move on to the next scan; where the log gives the odometry's own samples, long gaps count too."""
        step_s = stamp - self._stamp
        usual_s = FIRST_STEP_S if math.isnan(self._usual_s) else self._usual_s
        was_regular = self.is_regular
        self.is_regular = step_s > 0.0 and (
            has_track or math.isnan(self._usual_s) or step_s < MAX_STEP_RATIO * usual_s
        )
        if self.is_regular:
            gain = 1.0 if math.isnan(self._usual_s) else USUAL_GAIN
            self._usual_s = usual_s + gain * (min(step_s, MAX_STEP_RATIO * usual_s) - usual_s)
        if math.isnan(self._stamp):
            self.first_stamp = self.first_stamp if self._has_start else stamp
        else:
            self.now_s += step_s if self.is_regular else usual_s
        self._stamp = stamp
        is_usual = self.is_regular and usual_s / USUAL_RATIO < step_s < USUAL_RATIO * usual_s
        self.is_steady, self._was_usual = is_usual and self._was_usual, is_usual
        # a long step after one that cannot be right makes up for it; another one is a gap
        is_gap = self.is_regular and step_s >= USUAL_RATIO * usual_s and was_regular
        self.step_s = step_s if is_usual or is_gap else usual_s
        self.leap_s = 0.0 if self.is_regular or not step_s > 0.0 else step_s - usual_s


def _tangent(
    own: FloatArray, before: FloatArray, before_s: FloatArray, after: FloatArray, after_s: FloatArray
) -> FloatArray:
    """(n, 3) velocities between two intervals (n, 1) [s] with their mean velocities; `own` where none is possible."""
    between = (after_s * before + before_s * after) / (before_s + after_s)
    change, most = np.abs(after - before), 0.5 * (before_s + after_s) * MOST_ACCELERATION
    return np.where((change <= most).all(axis=1, keepdims=True), between, own)


class OdometryHistory:
    """Odometry poses of the whole log where it gives them, else those at the scans so far, in the order of the log.

    Attributes
    ----------
    clock : ScanClock
        Of the laser that took the latest scan: scans of several lasers may come at any time after each other.
    """

    N_KEPT = 4096

    def __init__(self) -> None:
        self.clock = ScanClock()
        self._clocks = {0: self.clock}
        self._track: OdometryTrack | None = None
        self._timed_track: OdometryTrack | None = None
        self._track_times: FloatArray = np.zeros(0)
        self._times = np.zeros(2 * self.N_KEPT)
        self._poses = np.zeros((2 * self.N_KEPT, 3))
        self._n = 0

    def advance(
        self, stamp: float, T_odom_base: FloatArray | None, track: OdometryTrack | None, laser: int = 0
    ) -> None:
        """Move on to the next scan.

        Parameters
        ----------
        stamp : float
        T_odom_base : (3,) array or None
            Its odometry; None leaves a gap.
        track : OdometryTrack or None
            The odometry of the whole log, on the clock of the stamps.
        laser : int
            Which laser took the scan.
        """
        self.clock = self._clock_of(stamp, laser)
        self.clock.advance(stamp, has_track=track is not None)
        self._track = track
        if T_odom_base is None:
            return
        if self._n == len(self._times):
            self._times[: self.N_KEPT] = self._times[self.N_KEPT :]
            self._poses[: self.N_KEPT] = self._poses[self.N_KEPT :]
            self._n = self.N_KEPT
        x, y, theta = T_odom_base.tolist()
        if self._n:
            before = float(self._poses[self._n - 1, 2])
            theta = before + math.remainder(theta - before, 2.0 * math.pi)
        now_s = self.clock.now_s
        if self._n and len(self._clocks) > 1:
            now_s = max(now_s, float(self._times[self._n - 1]))
        self._times[self._n] = now_s
        self._poses[self._n] = x, y, theta
        self._n += 1

    def _clock_of(self, stamp: float, laser: int) -> ScanClock:
        """The clock of a laser; that of one not seen before starts where those of the others are."""
        clock = self._clocks.get(laser)
        if clock is None:
            clock = ScanClock()
            if self.clock.is_started:
                clock.start(self.clock.first_stamp, stamp)
            self._clocks[laser] = clock
        return clock

    def at(self, times_s: FloatArray) -> FloatArray:
        """(n, 3) poses at times (n,) of the clock; beyond the latest one known the latest motion goes on.

        Theta is unwrapped.
        """
        times, poses = self._samples()
        out = np.stack([np.interp(times_s, times, poses[:, k]) for k in range(3)], axis=-1)
        if len(times) >= 2:
            ahead_s = np.maximum(times_s - times[-1], 0.0)
            if ahead_s.any():
                speed = (poses[-1] - poses[-2]) / max(times[-1] - times[-2], 1e-6)
                out += ahead_s[:, None] * speed
        return out

    def going_on(self, times_s: FloatArray) -> FloatArray:
        """(n, 3) poses at times (n,), between those known by a smooth motion (cubic Hermite).

        Beyond the latest one known the latest velocity in the body frame goes on. Theta is unwrapped.
        """
        poses, ahead_s = self._between(np.minimum(times_s, self.end_s)), np.maximum(times_s - self.end_s, 0.0)
        times, known = self._samples()
        if len(times) < 2 or not ahead_s.any():
            return poses
        velocity = se2.log(se2.between(known[-2], known[-1])) / max(times[-1] - times[-2], 1e-6)
        moved = se2.compose(poses, se2.exp(ahead_s[:, None] * velocity))
        moved[:, 2] = poses[:, 2] + ahead_s * velocity[2]
        return moved

    def _between(self, times_s: FloatArray) -> FloatArray:
        """(n, 3) poses at times (n,), at velocities that change steadily where a robot's can; else at constant ones."""
        times, poses = self._samples()
        if len(times) < 3:
            return self.at(times_s)
        last = len(times) - 2
        i = np.clip(np.searchsorted(times, times_s, side="right") - 1, 0, last)

        def secant(k: IntArray) -> tuple[FloatArray, FloatArray]:
            step_s = np.maximum(times[k + 1] - times[k], 1e-6)[:, None]
            return (poses[k + 1] - poses[k]) / step_s, step_s

        (before, before_s), (own, own_s), (after, after_s) = map(
            secant, (np.maximum(i - 1, 0), i, np.minimum(i + 1, last))
        )
        start = _tangent(own, before, before_s, own, own_s)
        end = _tangent(own, own, own_s, after, after_s)
        u = np.clip((times_s - times[i])[:, None] / own_s, 0.0, 1.0)
        bent: FloatArray = u * (1.0 - u) * own_s * ((1.0 - u) * (start - own) - u * (end - own))
        return poses[i] + u * own_s * own + bent

    @property
    def start_s(self) -> float:
        """Time of the first pose known [s]; infinite where none is."""
        times, _ = self._samples()
        return float(times[0]) if len(times) else math.inf

    @property
    def end_s(self) -> float:
        """Time of the latest pose known [s]; minus infinity where none is."""
        times, _ = self._samples()
        return float(times[-1]) if len(times) else -math.inf

    def pose_at(self, time_s: float) -> FloatArray:
        """(3,) pose at one time of the clock; see `at`."""
        times, poses = self._samples()
        n = len(times)
        if n and times[-1] == time_s:
            return np.asarray(poses[-1])
        if n < 2:
            return np.array(poses[0])
        if times[-2] == time_s:
            return np.asarray(poses[-2])
        k = min(max(bisect_left(times, time_s), 1), n - 1)
        start, end = float(times[k - 1]), float(times[k])
        if time_s == end:
            return np.asarray(poses[k])
        share = max((time_s - start) / max(end - start, 1e-6), 0.0)
        return np.asarray(poses[k - 1] + share * (poses[k] - poses[k - 1]))

    def _samples(self) -> tuple[FloatArray, FloatArray]:
        """Times (n,) of the clock and poses (n, 3): of the whole log, or of the scans so far."""
        if self._track is None:
            return self._times[: self._n], self._poses[: self._n]
        if self._track is not self._timed_track:
            self._timed_track = self._track
            self._track_times = self._track.stamps - self.clock.first_stamp
        return self._track_times, self._track.T_odom_base
