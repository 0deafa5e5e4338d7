"""One laser scan with what odometry there is, and the model of the laser that took it."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core._numba import kernel
from slammot_graph.core._sweep_kernels import sweep_geometry
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import BoolArray, FloatArray, IntArray

NO_RETURN_FRACTION = 0.97
"""By default a range above this share of `range_max` is a missing return, not a point."""

MAX_MOUNTING_M = 50.0
"""No robot carries its laser further from its base."""
MAX_YAW_RAD = 1e3


@dataclass(frozen=True, kw_only=True)
class LaserModel:
    """Geometry and limits of a planar laser scanner.

    Attributes
    ----------
    angle_min, angle_increment : float
        Direction of beam 0 and the step to the next [rad], laser frame, counter-clockwise.
    n_beams : int
    range_min, range_max : float
        Limits of a valid return [m]; ranges above ``NO_RETURN_FRACTION * range_max`` are missing returns.
    T_base_laser : (x, y, theta)
        Mounting: the laser in the robot's base frame [m, m, rad].
    number : int
        Which of the robot's lasers it is, from 0.
    """

    angle_min: float
    angle_increment: float
    n_beams: int
    range_min: float
    range_max: float
    T_base_laser: tuple[float, float, float] = (0.0, 0.0, 0.0)
    number: int = 0

    def __post_init__(self) -> None:
        if self.n_beams < 1:
            raise ConfigError(f"a laser needs at least one beam, not {self.n_beams}")
        if not (np.isfinite(self.angle_min) and np.isfinite(self.angle_increment)):
            raise ConfigError("the laser's angles are not finite")
        if self.angle_increment == 0.0:
            raise ConfigError("the laser's angle_increment is zero")
        if not 0.0 <= self.range_min < self.range_max:
            raise ConfigError(
                f"the laser's limits need 0 <= range_min < range_max, not {self.range_min}, {self.range_max}"
            )
        x, y, theta = self.T_base_laser
        if not (abs(theta) <= MAX_YAW_RAD and max(abs(x), abs(y)) <= MAX_MOUNTING_M):
            raise ConfigError(
                f"the laser's pose on the robot ({x:.6g}, {y:.6g}, {theta:.6g}) is out of any sense; give x, y [m]"
                f" within {MAX_MOUNTING_M:g} m and yaw [rad]"
            )

    @property
    def field_of_view_rad(self) -> float:
        """Between the first and the last beam."""
        return abs(self.angle_increment) * (self.n_beams - 1)

    @cached_property
    def angles_base(self) -> FloatArray:
        """(n_beams,) beam directions in the base frame [rad]."""
        steps = np.arange(self.n_beams, dtype=np.float64)
        return self.angle_min + self.T_base_laser[2] + self.angle_increment * steps

    @cached_property
    def directions_base(self) -> FloatArray:
        """(n_beams, 2) unit vectors of the beams in the base frame."""
        return np.column_stack([np.cos(self.angles_base), np.sin(self.angles_base)])

    @cached_property
    def origin_base(self) -> FloatArray:
        """(2,) the laser's place in the base frame [m]."""
        return np.array(self.T_base_laser[:2])

    @cached_property
    def origins_base(self) -> FloatArray:
        """(1, 2) the same, as the one origin of all beams."""
        return self.origin_base[None]


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanTruth:
    """What a simulator or an injection knows about a scan.

    Attributes
    ----------
    T_world_base : (3,) array or None
        True pose.
    is_moving : (n_beams,) bool array or None
        The beam hit a person or another moving object.
    object_id : (n_beams,) int array or None
        Which object; -1 for none.
    objects : (k, 4) array or None
        True states of the objects: x, y [m], vx, vy [m/s] in the world; NaN while away.
    """

    T_world_base: FloatArray | None = None
    is_moving: BoolArray | None = None
    object_id: IntArray | None = None
    objects: FloatArray | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """One scan in the log's order.

    Attributes
    ----------
    index : int
        Position among the usable scans of the log, from 0.
    stamp : float
        Time [s].
    ranges : (n_beams,) array
        As measured [m]; may hold NaN, infinity and missing returns.
    laser : LaserModel
        Shared by scans of equal geometry.
    T_odom_base : (3,) array or None
        Odometry at the stamp: base in odom. None where the log has none for this scan, or none at all.
    truth : ScanTruth or None
    odometry : OdometryTrack or None
        The odometry of the whole recorded log, also after this scan; shared by all scans. Its clock is that of the
        stamps but for an offset. None where there is no odometry or the stamps of scans or odometry do not rise,
        and of live sources.
    imu_yaw : float or None
        Yaw of the base at the stamp by an IMU's yaw rate alone [rad], not wrapped; its zero does not matter.
    beam_times : (n_beams,) array or None
        When each beam was sent out, since the stamp [s]; scans may share the array. None: all at the stamp.
    sweep : SweepMotion or None
        How the robot moved meanwhile: end points, origins and directions are then those in the base frame at the
        stamp. None: as if it stood still.
    """

    index: int
    stamp: float
    ranges: FloatArray
    laser: LaserModel
    T_odom_base: FloatArray | None
    truth: ScanTruth | None = field(default=None)
    odometry: OdometryTrack | None = field(default=None, repr=False)
    imu_yaw: float | None = None
    beam_times: FloatArray | None = field(default=None, repr=False)
    sweep: SweepMotion | None = field(default=None, repr=False)

    def is_valid(self, max_range: float = np.inf, range_fraction: float = NO_RETURN_FRACTION) -> BoolArray:
        """(n_beams,) mask of returns that are points: within the laser's limits and `max_range` [m].

        Beyond `range_fraction` of the laser's `range_max` a range is a missing return.
        """
        is_point = np.empty(len(self.ranges), dtype=np.bool_)
        limit = min(range_fraction * self.laser.range_max, max_range)
        _between(self.ranges, max(self.laser.range_min, 1e-3), limit, is_point)
        return is_point

    def is_no_return(self, min_run: int = 1, range_fraction: float = NO_RETURN_FRACTION) -> BoolArray:
        """(n_beams,) mask of beams that met nothing in reach, from `range_fraction` of the laser's maximum on.

        Only runs of at least `min_run` neighbours count: single ones are more often dark or shiny surfaces.
        """
        missing = np.empty(len(self.ranges), dtype=np.bool_)
        runs_beyond(self.ranges, range_fraction * self.laser.range_max, min_run, missing)
        return missing

    def points_base(self) -> FloatArray:
        """(n_beams, 2) end points in the base frame [m]: origin + r (cos, sin) (eq. 7); NaN for infinite r."""
        return self._points_base

    @property
    def origins_base(self) -> FloatArray:
        """(1, 2) where all beams start from, or (n_beams, 2) where each does, base frame [m]."""
        return self.laser.origins_base if self.sweep is None else self._swept[1]

    @property
    def directions_base(self) -> FloatArray:
        """(n_beams, 2) unit vectors of the beams in the base frame."""
        return self.laser.directions_base if self.sweep is None else self._swept[2]

    @cached_property
    def _points_base(self) -> FloatArray:
        if self.sweep is not None:
            points = self._swept[0]
        else:
            points = _end_points(self.ranges, self.laser.origin_base, self.laser.directions_base)
        points.setflags(write=False)
        return points

    @cached_property
    def _swept(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """End points, origins and directions (n_beams, 2) of a deskewed scan."""
        sweep, n = self.sweep, len(self.ranges)
        points, origins, directions = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2))
        if sweep is None or self.beam_times is None:
            raise ValueError("a scan without beam times has no motion during its sweep")
        sweep_geometry(
            self.beam_times,
            sweep.first_s,
            sweep.last_s,
            sweep.T_stamp_base,
            self.ranges,
            self.laser.origin_base,
            self.laser.directions_base,
            points,
            origins,
            directions,
        )
        return points, origins, directions

    def points(self, T_a_base: FloatArray) -> FloatArray:
        """(n_beams, 2) end points in frame a [m] (eq. 2)."""
        return se2.transform(T_a_base, self.points_base())


@kernel
def _between(ranges: FloatArray, low: float, high: float, out: BoolArray) -> None:
    for k in range(ranges.shape[0]):
        out[k] = low < ranges[k] < high


@kernel
def _end_points(ranges: FloatArray, origin: FloatArray, directions: FloatArray) -> FloatArray:
    out = np.empty(directions.shape)
    for k in range(ranges.shape[0]):
        r = ranges[k] if np.isfinite(ranges[k]) else np.nan
        out[k, 0] = origin[0] + r * directions[k, 0]
        out[k, 1] = origin[1] + r * directions[k, 1]
    return out


@kernel
def runs_beyond(ranges: FloatArray, limit: float, min_run: int, out: BoolArray) -> None:
    """Mark in `out` the ranges of at least `limit` [m] that come in runs of at least `min_run`."""
    first = 0
    for k in range(ranges.shape[0]):
        out[k] = ranges[k] >= limit
        if not out[k]:
            if k - first < min_run:
                out[first:k] = False
            first = k + 1
    if ranges.shape[0] - first < min_run:
        out[first:] = False
