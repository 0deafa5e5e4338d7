"""The previous motion as a prediction: the robot goes on as it went from the scan before last to the last."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Positive, PositiveShare
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry._motion_kernels import learn_velocity
from slammot_graph.odometry.motion import Motion

MAX_STEP_S = 1.0
"""The previous motion is not believed to go on for longer."""


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
    gain: PositiveShare = 0.03


class PreviousMotion:
    """Predicts an increment from the velocity between the last two scans, and learns how far that is wrong.

    Attributes
    ----------
    config : PreviousMotionConfig
    velocity : (3,) array
        Of the base between the last two scans [m/s, m/s, rad/s].
    var : (3,) array
        Variance of its change from scan to scan.
    """

    def __init__(self, config: PreviousMotionConfig) -> None:
        self.config = config
        self.velocity: FloatArray = np.zeros(3)
        self.var: FloatArray = _squares(config.first_std_m_per_s, config.first_std_rad_per_s)
        self._least_var = _squares(config.least_std_m_per_s, config.least_std_rad_per_s)
        self._n_missed = 0

    @property
    def std(self) -> FloatArray:
        """(3,) standard deviation of the velocity's change from scan to scan."""
        return np.asarray(np.sqrt(self.var))

    @property
    def cov_velocity(self) -> FloatArray:
        """(3, 3) covariance of the velocity after the latest scan; after scans that were not matched it is larger."""
        return np.diag((1 + self._n_missed) ** 2 * self.var)

    def body_velocity(self, step_s: float) -> FloatArray:
        """(3,) constant velocity in the body frame that makes the increment of the latest step."""
        return se2.log(step_s * self.velocity) / step_s

    def increment(self, step_s: float) -> FloatArray:
        """(3,) motion over the next `step_s`."""
        return min(step_s, MAX_STEP_S) * self.velocity

    def motion(self, step_s: float) -> Motion:
        """Predict the motion over the next `step_s`; after scans that were not matched it is known less well."""
        spread_s = (1 + self._n_missed) * step_s
        return Motion(increment=self.increment(step_s), cov=np.diag(spread_s * spread_s * self.var))

    def learn(self, increment: FloatArray, cov: FloatArray, step_s: float) -> None:
        """Take in an increment (3,) that a match found, and its covariance (3, 3)."""
        gain = 0.0 if self._n_missed else self.config.gain
        learn_velocity(increment, cov, step_s, gain, self._least_var, self.velocity, self.var)
        self._n_missed = 0

    def miss(self) -> None:
        """Go on from a scan that was not matched."""
        self._n_missed = min(self._n_missed + 1, 20)


def _squares(std_m_per_s: float, std_rad_per_s: float) -> FloatArray:
    return np.square((std_m_per_s, std_m_per_s, std_rad_per_s))
