"""What a run found out about its odometry: plain numbers with their standard deviations."""

import math
from dataclasses import dataclass, field
from typing import Literal

MotionSource = Literal["odometry", "previous motion"]
"""What predicts the motion between two scans."""


@dataclass(frozen=True, kw_only=True)
class Estimated:
    """A number with its standard deviation, which is infinite where the drive does not tell it."""

    value: float
    std: float = math.inf


@dataclass(frozen=True, kw_only=True)
class OdometryReport:
    """Calibration of the odometry against the matches, as of the end of a run.

    Attributes
    ----------
    source : "odometry" or "previous motion"
        What predicted the motion last.
    has_odometry : bool
        The log has odometry, and it was not switched off.
    clock_offset_s : Estimated
        A scan stamped t was taken when the odometry's clock showed t + this [s]: negative where the laser's stamps lag.
    distance_scale, heading_scale : Estimated
        True motion over that which the odometry tells.
    heading_bias_rad_per_m : Estimated
        True turn per metre driven where the odometry tells of none [rad/m].
    direction_rad : Estimated
        Direction of the true motion where the odometry tells of one straight ahead [rad]: a laser whose mounting is
        turned by pi moves backward.
    laser_shift_x_m, laser_shift_y_m : Estimated
        How much farther forward and left the laser sits on the base than its pose says [m], by the way it swings in
        turns; not corrected, for the base the odometry turns about may be meant to be another.
    noise_scale_m, noise_scale_rad : Estimated
        Standard deviation of the odometry's increments over that of the noise model, translation and rotation.
    n_by_odometry, n_by_previous_motion : int
        Scans whose motion was predicted by either.
    n_contradictions : int
        Scans at which odometry and match contradicted each other.
    """

    source: MotionSource = "odometry"
    has_odometry: bool = True
    clock_offset_s: Estimated = field(default_factory=lambda: Estimated(value=0.0))
    distance_scale: Estimated = field(default_factory=lambda: Estimated(value=1.0))
    heading_scale: Estimated = field(default_factory=lambda: Estimated(value=1.0))
    heading_bias_rad_per_m: Estimated = field(default_factory=lambda: Estimated(value=0.0))
    direction_rad: Estimated = field(default_factory=lambda: Estimated(value=0.0))
    laser_shift_x_m: Estimated = field(default_factory=lambda: Estimated(value=0.0))
    laser_shift_y_m: Estimated = field(default_factory=lambda: Estimated(value=0.0))
    noise_scale_m: Estimated = field(default_factory=lambda: Estimated(value=1.0))
    noise_scale_rad: Estimated = field(default_factory=lambda: Estimated(value=1.0))
    n_by_odometry: int = 0
    n_by_previous_motion: int = 0
    n_contradictions: int = 0
