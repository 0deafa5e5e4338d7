"""How the robot moved while a laser swept: where each beam of a scan was sent out, seen from the scan's stamp."""

from dataclasses import dataclass, replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class SweepMotion:
    """Motion of the base during a sweep, between knots that are evenly spaced in time.

    Attributes
    ----------
    first_s, last_s : float
        Times of the first and the last knot since the scan's stamp [s].
    T_stamp_base : (m, 3) array
        The base at each of m >= 2 knots, in the base at the stamp; theta is not wrapped, and linear in between.
    cov_velocity : (3, 3) array
        Covariance of the mean velocity (body frame, per s), which is what the sweep is not known better by: an end
        point t seconds after the stamp is as uncertain as under a pose of t^2 times this.
    """

    first_s: float
    last_s: float
    T_stamp_base: FloatArray
    cov_velocity: FloatArray

    @property
    def knot_times(self) -> FloatArray:
        """(m,) times of the knots since the stamp [s]."""
        return np.linspace(self.first_s, self.last_s, len(self.T_stamp_base))

    @property
    def velocity(self) -> FloatArray:
        """(3,) mean velocity over the sweep, in the base frame at the first knot [m/s, m/s, rad/s]."""
        first, last = self.T_stamp_base[0], self.T_stamp_base[-1]
        return se2.log(se2.between(first, last)) / max(self.last_s - self.first_s, 1e-9)

    def corrected(self, velocity: FloatArray, cov_velocity: FloatArray) -> "SweepMotion":
        """Add a velocity (3,) in the base frame at the stamp, whose covariance (3, 3) is then that of the sum."""
        added = se2.exp(self.knot_times[:, None] * velocity)
        moved = se2.compose(added, self.T_stamp_base)
        moved[:, 2] = added[:, 2] + self.T_stamp_base[:, 2]
        return replace(self, T_stamp_base=moved, cov_velocity=cov_velocity)

    def at(self, times_s: FloatArray) -> FloatArray:
        """(n, 3) base at times (n,) since the stamp, in the base at the stamp; theta is not wrapped."""
        knots = self.knot_times
        return np.stack([np.interp(times_s, knots, self.T_stamp_base[:, k]) for k in range(3)], axis=-1)
