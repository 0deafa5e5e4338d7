"""R_r: the covariance of an odometry increment, constant as in the paper or growing with the motion."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slammot_graph.core.checks import Checked, NotNegative, Positive
from slammot_graph.core.types import FloatArray

NOTHING_COMMON: FloatArray = np.zeros(4)
NOTHING_COMMON.setflags(write=False)
"""Standard deviations of what the errors of increments have in common, where that is nothing."""


@dataclass(frozen=True, kw_only=True)
class OdometryNoise(Checked):
    """Standard deviations of an odometry increment, body frame, order (x, y, theta).

    Variances add up: those of a still robot, per metre driven and per radian turned.

    Attributes
    ----------
    still_std_m, still_std_rad : float
        Of each increment, also without motion.
    std_m_per_sqrt_m, std_rad_per_sqrt_m, std_m_per_sqrt_rad, std_rad_per_sqrt_rad : float
        Random part; the variance grows in proportion to the distance.
    ratio_m_per_m, ratio_rad_per_rad : float
        Systematic part (wheel scale): the standard deviation is this share of the increment.
    """

    still_std_m: Positive = 0.002
    still_std_rad: Positive = 0.002
    std_m_per_sqrt_m: NotNegative = 0.02
    std_rad_per_sqrt_m: NotNegative = 0.04
    std_m_per_sqrt_rad: NotNegative = 0.02
    std_rad_per_sqrt_rad: NotNegative = 0.05
    ratio_m_per_m: NotNegative = 0.05
    ratio_rad_per_rad: NotNegative = 0.1

    @property
    def common_stds(self) -> FloatArray:
        """(4,) standard deviations of what the errors of all increments have in common; see `MotionModel`."""
        return np.array([self.ratio_m_per_m, 0.0, 0.0, self.ratio_rad_per_rad])

    def covariance(self, increment: FloatArray) -> FloatArray:
        """(3, 3) covariance of a (3,) increment [m, m, rad], right perturbation (body frame)."""
        var_m2, var_rad2 = self.variances(increment)
        return np.array([[var_m2, 0.0, 0.0], [0.0, var_m2, 0.0], [0.0, 0.0, var_rad2]])

    def variances(self, increment: FloatArray) -> tuple[float, float]:
        """Give the variances [m^2, rad^2] of a (3,) increment: of the translation, per axis, and of the rotation."""
        x, y, theta = increment.tolist()
        distance_m, turn_rad = math.hypot(x, y), abs(theta)
        still_m2, still_rad2, m2_per_m, m2_per_rad, rad2_per_m, rad2_per_rad = self._squares
        var_m2 = still_m2 + (m2_per_m * distance_m + m2_per_rad * turn_rad)
        var_rad2 = still_rad2 + (rad2_per_m * distance_m + rad2_per_rad * turn_rad)
        return (
            var_m2 + (self.ratio_m_per_m * distance_m) ** 2,
            var_rad2 + (self.ratio_rad_per_rad * turn_rad) ** 2,
        )

    @cached_property
    def _squares(self) -> tuple[float, float, float, float, float, float]:
        return (
            self.still_std_m**2,
            self.still_std_rad**2,
            self.std_m_per_sqrt_m**2,
            self.std_m_per_sqrt_rad**2,
            self.std_rad_per_sqrt_m**2,
            self.std_rad_per_sqrt_rad**2,
        )


@dataclass(frozen=True, kw_only=True)
class ConstantNoise(Checked):
    """The paper's R_r = diag(0.1^2, 0.1^2, 0.05^2) [m, m, rad], whatever the motion.

    Attributes
    ----------
    x_std_m, y_std_m, theta_std_rad : float
    """

    x_std_m: Positive = 0.1
    y_std_m: Positive = 0.1
    theta_std_rad: Positive = 0.05

    @property
    def common_stds(self) -> FloatArray:
        """(4,) zeros: the errors of increments are independent."""
        return NOTHING_COMMON

    def covariance(self, increment: FloatArray) -> FloatArray:
        """(3, 3) covariance; the (3,) increment does not matter."""
        del increment
        return np.diag([self.x_std_m**2, self.y_std_m**2, self.theta_std_rad**2])

    def variances(self, increment: FloatArray) -> tuple[float, float]:
        """Give the variances [m^2, rad^2], along x for the translation; the (3,) increment does not matter."""
        del increment
        return self.x_std_m**2, self.theta_std_rad**2


def variances_of(noise: OdometryNoise | ConstantNoise, increments: FloatArray) -> FloatArray:
    """(n, 2) variances [m^2, rad^2] of increments (n, 3): of the translation, per axis, and of the rotation."""
    return np.array([noise.variances(increment) for increment in increments])
