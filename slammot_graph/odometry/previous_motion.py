"""The previous motion as a prediction: the robot goes on as it went."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Positive, PositiveShare
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry._motion_kernels import learn_velocities
from slammot_graph.odometry.history import USUAL_RATIO, ScanClock
from slammot_graph.odometry.motion import Motion

MAX_STEP_S = 1.0
"""The previous motion is not believed to go on for longer."""

LEAP_M, LEAP_RAD = 3.0, 0.8
"""At most; standard deviations of the motion while the stamps leap, as the robot may have driven on unseen."""

LEVER_M, CAP_M = 2.0, 0.5
"""Errors of both clocks: a turn counts as its arc at this distance, and a single one for no more than this."""

CLOCK_GAIN, CLOCK_RATIO = 0.02, 0.8
"""Weight of the latest error in the mean ones; equal steps are used once their squared errors are smaller by this."""


@dataclass(frozen=True, kw_only=True)
class PreviousMotionConfig(Checked):
    """How far velocities are believed to change from one scan to the next; learnt while running.

    Attributes
    ----------
    first_std_m_per_s, first_std_rad_per_s : float
        Change of the velocity from scan to scan, as long as nothing is learnt.
    least_std_m_per_s, least_std_rad_per_s : float
        Lower bounds of what is learnt.
    gain : float
        Weight of the latest change among those before.
    """

    first_std_m_per_s: Positive = 0.5
    first_std_rad_per_s: Positive = 1.0
    least_std_m_per_s: Positive = 0.03
    least_std_rad_per_s: Positive = 0.03
    gain: PositiveShare = 0.15


class Velocity:
    """Velocity of the base by a Kalman filter, axis by axis, that learns how far it changes.

    Attributes
    ----------
    table : (4, 3) array
        Its rows are the four below.
    """

    def __init__(self, config: PreviousMotionConfig) -> None:
        self.table = np.zeros((4, 3))
        self.table[1:4:2] = _squares(config.first_std_m_per_s, config.first_std_rad_per_s)

    @property
    def value(self) -> FloatArray:
        """(3,) [m/s, m/s, rad/s]."""
        return np.asarray(self.table[0])

    @property
    def var(self) -> FloatArray:
        """(3,) its variance."""
        return np.asarray(self.table[1])

    @property
    def cross(self) -> FloatArray:
        """(3,) covariance with the way that was predicted by it.

        Down a bare corridor, where no match corrects it, one error of the velocity adds up over all steps.
        """
        return np.asarray(self.table[2])

    @property
    def var_change(self) -> FloatArray:
        """(3,) variance of its change from scan to scan."""
        return np.asarray(self.table[3])


class PreviousMotion:
    """Predicts an increment from the velocity, and learns how far that is wrong.

    The stamps of some logs are not those of the laser, but of whoever wrote them down. Where equal steps predict the
    motion better than the steps of the stamps do, the steps count as equal.

    Attributes
    ----------
    config : PreviousMotionConfig
    by_stamps, by_count : Velocity
        With the steps of the stamps, and with equal ones.
    """

    def __init__(self, config: PreviousMotionConfig) -> None:
        self.config = config
        self.by_stamps, self.by_count = Velocity(config), Velocity(config)
        self._errors2 = np.zeros(2)  # means, by stamps and by count
        self._least_var = _squares(config.least_std_m_per_s, config.least_std_rad_per_s)
        self._n_missed = 0

    @property
    def is_by_count(self) -> bool:
        """Whether the steps count as equal."""
        by_stamps, by_count = self._errors2.tolist()
        return bool(by_count < CLOCK_RATIO * by_stamps)

    @property
    def velocity(self) -> Velocity:
        """The velocity in use."""
        return self.by_count if self.is_by_count else self.by_stamps

    @property
    def std(self) -> FloatArray:
        """(3,) standard deviation of the velocity's change from scan to scan."""
        return np.asarray(np.sqrt(self.velocity.var_change))

    @property
    def cov_velocity(self) -> FloatArray:
        """(3, 3) covariance of the velocity after the latest scan; after scans that were not matched it is larger."""
        velocity = self.velocity
        return np.diag((1 + self._n_missed) ** 2 * (velocity.var_change + velocity.var))

    def body_velocity(self, clock: ScanClock) -> FloatArray:
        """(3,) constant velocity in the body frame that makes the increment of the latest step."""
        step_s = self._step_s(clock)
        return se2.log(step_s * self.velocity.value) / step_s

    def increment(self, clock: ScanClock) -> FloatArray:
        """(3,) motion over the latest step of the clock."""
        if self.is_by_count:
            return np.asarray(min(clock.usual_s, MAX_STEP_S) * self.by_count.value)
        return np.asarray(min(clock.step_s, MAX_STEP_S) * self.by_stamps.value)

    def motion(self, clock: ScanClock, elapsed_s: float | None = None) -> Motion:
        """Predict the motion over the latest step of the clock, or over the time since another laser's scan.

        After scans that were not matched it is known less well. Over a gap the robot may have stopped, or gone on for
        the whole of it.
        """
        velocity, step_s = self.velocity, self._step_s(clock) if elapsed_s is None else elapsed_s
        spread_s = (1 + self._n_missed) * step_s
        var = spread_s * spread_s * (velocity.var_change + velocity.var) + 2.0 * spread_s * velocity.cross
        if step_s > USUAL_RATIO * clock.usual_s:
            var = var + np.square((step_s - clock.usual_s) * velocity.value)
            var[:2] = var[:2].max()  # it may have turned meanwhile
        if elapsed_s is None and clock.leap_s > 0.0:
            way_m = min(clock.leap_s * float(np.hypot(*velocity.value[:2])), LEAP_M)
            var = var + np.square((way_m, way_m, LEAP_RAD * way_m / LEAP_M))
        return Motion(increment=min(step_s, MAX_STEP_S) * velocity.value, cov=np.diag(var))

    def learn(self, increment: FloatArray, cov: FloatArray, clock: ScanClock) -> None:
        """Take in an increment (3,) over the latest step that a match found, and its covariance (3, 3)."""
        learn_velocities(
            increment,
            cov,
            (clock.step_s, clock.usual_s),
            0.0 if self._n_missed else self.config.gain,
            LEVER_M,
            CAP_M,
            CLOCK_GAIN,
            self._least_var,
            self.by_stamps.table,
            self.by_count.table,
            self._errors2,
        )
        self._n_missed = 0

    def miss(self) -> None:
        """Go on from a scan that was not matched."""
        self._n_missed = min(self._n_missed + 1, 20)

    def _step_s(self, clock: ScanClock) -> float:
        return clock.usual_s if self.is_by_count else clock.step_s


def _squares(std_m_per_s: float, std_rad_per_s: float) -> FloatArray:
    return np.square((std_m_per_s, std_m_per_s, std_rad_per_s))
