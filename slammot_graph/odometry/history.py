"""The odometry of the scans so far, on a clock that never runs backward, to be asked for poses between them."""

import math

import numpy as np

from slammot_graph.core.types import FloatArray

MAX_STEP_RATIO = 20.0
"""A step of the stamps that is no step forward, or longer than this many usual ones, tells nothing of time."""

USUAL_RATIO = 2.5
"""Velocities are told by steps within this ratio of the usual one; a longer or shorter one counts as usual for them."""

FIRST_STEP_S = 0.1
"""Time between two scans as long as none is known [s]."""


class OdometryHistory:
    """Odometry poses at the scans, in the order of the log.

    Attributes
    ----------
    clock_s : float
        Time of the latest scan since the first one [s]: the stamps' own where they rise, usual steps elsewhere.
    step_s : float
        Since the scan before, as velocities count it [s].
    is_regular : bool
        The latest step is that of the stamps.
    """

    N_KEPT = 4096

    def __init__(self) -> None:
        self.clock_s = 0.0
        self.step_s = FIRST_STEP_S
        self.is_regular = False
        self._usual_s = math.nan
        self._stamp = math.nan
        self._times = np.zeros(2 * self.N_KEPT)
        self._poses = np.zeros((2 * self.N_KEPT, 3))
        self._n = 0

    def append(self, stamp: float, T_odom_base: FloatArray) -> None:
        """Move on to the next scan, with its stamp [s] and odometry (3,)."""
        step_s = stamp - self._stamp
        usual_s = FIRST_STEP_S if math.isnan(self._usual_s) else self._usual_s
        self.is_regular = 0.0 < step_s < MAX_STEP_RATIO * usual_s or (
            step_s > 0.0 and math.isnan(self._usual_s)
        )
        if self.is_regular:
            self._usual_s = (
                step_s if math.isnan(self._usual_s) else self._usual_s + 0.05 * (step_s - self._usual_s)
            )
        self._stamp = stamp
        if self._n:
            self.clock_s += step_s if self.is_regular else usual_s
        is_usual = self.is_regular and usual_s / USUAL_RATIO < step_s < USUAL_RATIO * usual_s
        self.step_s = step_s if is_usual else usual_s
        if self._n == len(self._times):
            self._times[: self.N_KEPT] = self._times[self.N_KEPT :]
            self._poses[: self.N_KEPT] = self._poses[self.N_KEPT :]
            self._n = self.N_KEPT
        x, y, theta = T_odom_base.tolist()
        if self._n:
            before = float(self._poses[self._n - 1, 2])
            theta = before + math.remainder(theta - before, 2.0 * math.pi)
        self._times[self._n] = self.clock_s
        self._poses[self._n] = x, y, theta
        self._n += 1

    def at(self, times_s: FloatArray) -> FloatArray:
        """(n, 3) poses at times (n,) of the clock; beyond the latest scan the latest motion goes on.

        Theta is unwrapped.
        """
        times, poses = self._times[: self._n], self._poses[: self._n]
        out = np.stack([np.interp(times_s, times, poses[:, k]) for k in range(3)], axis=-1)
        if self._n >= 2:
            ahead_s = np.maximum(times_s - times[-1], 0.0)
            if ahead_s.any():
                speed = (poses[-1] - poses[-2]) / max(times[-1] - times[-2], 1e-6)
                out += ahead_s[:, None] * speed
        return out

    def pose_at(self, time_s: float) -> FloatArray:
        """(3,) pose at one time of the clock; see `at`."""
        n = self._n
        times, poses = self._times, self._poses
        k = n - 1
        while k > 1 and times[k - 1] > time_s:
            k -= 1
        if n < 2:
            return poses[0].copy()
        share = (time_s - times[k - 1]) / max(times[k] - times[k - 1], 1e-6)
        pose: FloatArray = poses[k - 1] + max(share, 0.0) * (poses[k] - poses[k - 1])
        return pose
