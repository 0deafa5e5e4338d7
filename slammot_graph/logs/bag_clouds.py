"""Scans made of a 3D lidar's clouds (PointCloud2): the nearest return of each angular bin in a slice of heights."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import FloatArray, IntArray

TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's names of sensor_msgs/PointField's data types."""

TIME_FIELDS = ("t", "time", "timestamp", "offset_time", "time_stamp")
"""Usual names of a point's time."""

TIME_UNITS = (1.0, 1e-3, 1e-6, 1e-9)
"""Seconds in the units of such a time, and how long one sweep takes [s]:"""

MIN_SWEEP_S, MAX_SWEEP_S = 2e-3, 2.0

BIN_COUNTS = (1440, 720, 360)
"""Beams of a full turn, the finest that the points fill."""

MIN_FILLED = 0.7
"""Share of the bins that are filled where the coarsest ones are."""

RANGE_MAX_M = 200.0
"""A cloud does not tell its lidar's reach."""


@dataclass(frozen=True, kw_only=True)
class CloudSlice:
    """Heights [m] above the base between which a cloud's points are taken."""

    z_min_m: float
    z_max_m: float


class Sweep(NamedTuple):
    """A cloud as a scan: ranges (n,) [m], NaN where no point is, and their times (n,) [s] after the stamp, or None."""

    ranges: FloatArray
    times_s: FloatArray | None


def cloud_fields(cloud: Any, names: Sequence[str]) -> dict[str, npt.NDArray[Any]]:
    """Fields (n,) of a PointCloud2's points by name, those that it has; organized clouds row by row.

    Raises
    ------
    ValueError
        The cloud contradicts itself, or a field has a type that is not known.
    """
    width, height, step = int(cloud.width), int(cloud.height), int(cloud.point_step)
    order = ">" if cloud.is_bigendian else "<"
    data = np.asarray(cloud.data, dtype=np.uint8).ravel()
    row_step = int(cloud.row_step) if height > 1 else width * step
    n_bytes = (height - 1) * row_step + width * step if width and height else 0
    if len(data) < n_bytes or row_step < width * step:
        raise ValueError(f"a cloud of {height} x {width} points of {step} bytes does not fit its data")
    if not n_bytes:
        return {x.name: np.empty(0) for x in cloud.fields if x.name in names}
    rows = np.lib.stride_tricks.as_strided(data, (height, width * step), (row_step, 1), writeable=False)
    points = np.ascontiguousarray(rows).reshape(height * width, step)
    found: dict[str, npt.NDArray[Any]] = {}
    for field in cloud.fields:
        if field.name not in names:
            continue
        if field.datatype not in TYPES:
            raise ValueError(f"field {field.name} of the cloud is of the unknown type {field.datatype}")
        kind = np.dtype(order + TYPES[field.datatype])
        if field.offset + kind.itemsize > step:
            raise ValueError(f"field {field.name} of the cloud lies outside its points of {step} bytes")
        part = points[:, field.offset : field.offset + kind.itemsize]
        found[field.name] = np.ascontiguousarray(part).view(kind)[:, 0]
    return found


def cloud_points(cloud: Any) -> tuple[FloatArray, FloatArray | None]:
    """Points (n, 3) [m] of a cloud in its frame that are numbers, and their times (n,) [s] after its stamp, or None.

    Raises
    ------
    ValueError
        It has no x, y and z, or contradicts itself.
    """
    fields = cloud_fields(cloud, ("x", "y", "z", *TIME_FIELDS))
    if not {"x", "y", "z"} <= fields.keys():
        raise ValueError("the cloud has no fields x, y and z")
    points = np.column_stack([fields[key].astype(np.float64) for key in ("x", "y", "z")])
    name = next((key for key in TIME_FIELDS if key in fields), None)
    is_finite = np.isfinite(points).all(axis=1)
    if name is None:
        return points[is_finite], None
    stamp_s = float(cloud.header.stamp.sec + cloud.header.stamp.nanosec * 1e-9)
    times_s = point_times(fields[name], stamp_s)
    return points[is_finite], None if times_s is None else times_s[is_finite]


def point_times(raw: npt.NDArray[Any], stamp_s: float) -> FloatArray | None:
    """Times (n,) [s] after a stamp, of numbers in seconds, milli-, micro- or nanoseconds, relative or absolute.

    The unit is that in which they span a sweep; None where there is none.
    """
    known = raw[np.isfinite(raw)] if raw.dtype.kind == "f" else raw
    if not len(known):
        return None
    span = float(known.max() - known.min())
    unit = next((x for x in TIME_UNITS if MIN_SWEEP_S <= span * x <= MAX_SWEEP_S), None)
    if unit is None:
        return None
    first = float(known.min()) * unit
    start_s = first - stamp_s if abs(first - stamp_s) < 10.0 * MAX_SWEEP_S else first
    if abs(start_s) > MAX_SWEEP_S:  # of a clock that is not the stamps'
        start_s = 0.0
    since_first = (raw - known.min()).astype(np.float64)  # before scaling: of nanoseconds no digit is lost
    return np.asarray(start_s + unit * since_first)


class CloudSlicer:
    """Makes scans of the clouds of one lidar.

    Parameters
    ----------
    T_base_cloud : (4, 4) array
        The lidar in the base.
    heights : CloudSlice
    n_beams : int
        Of a full turn.
    number : int
        Which of the robot's lasers it is.

    Attributes
    ----------
    laser : LaserModel
        Of the scans: at the lidar's place, with the base's heading.
    """

    def __init__(
        self, T_base_cloud: FloatArray, heights: CloudSlice, *, n_beams: int, number: int = 0
    ) -> None:
        self._T_base_cloud = T_base_cloud
        self._heights = heights
        step = 2.0 * math.pi / n_beams
        x, y = (round(float(v), 6) for v in T_base_cloud[:2, 3])
        self.laser = LaserModel(
            angle_min=-math.pi + 0.5 * step,
            angle_increment=step,
            n_beams=n_beams,
            range_min=0.05,
            range_max=RANGE_MAX_M,
            T_base_laser=(x, y, 0.0),
            number=number,
        )

    def sweep(self, points: FloatArray, times_s: FloatArray | None) -> Sweep:
        """Make a scan of points (n, 3) in the lidar's frame, with times (n,) [s] or None."""
        ranges, angles, kept = slice_polar(points, self._T_base_cloud, self._heights)
        n = self.laser.n_beams
        beams = bins_of(angles, n)
        nearest = np.argsort(-ranges, kind="stable")  # of several points of a bin the nearest is written last
        out = np.full(n, np.nan)
        out[beams[nearest]] = ranges[nearest]
        if times_s is None:
            return Sweep(out, None)
        found = np.full(n, np.nan)
        found[beams[nearest]] = times_s[kept][nearest]
        return Sweep(out, _filled(found))


def slice_polar(
    points: FloatArray, T_base_cloud: FloatArray, heights: CloudSlice
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Ranges (m,) [m] and angles (m,) [rad] about the lidar, base frame, of the points (n, 3) in a slice; which."""
    points_base = points @ T_base_cloud[:3, :3].T + T_base_cloud[:3, 3]
    offsets = points_base[:, :2] - T_base_cloud[:2, 3]
    ranges = np.hypot(offsets[:, 0], offsets[:, 1])
    z = points_base[:, 2]
    with np.errstate(invalid="ignore"):
        is_in = (z >= heights.z_min_m) & (z <= heights.z_max_m) & (ranges > 1e-3) & (ranges < RANGE_MAX_M)
    kept = np.flatnonzero(is_in).astype(np.int64)
    return ranges[kept], np.arctan2(offsets[kept, 1], offsets[kept, 0]), kept


def bins_of(angles: FloatArray, n: int) -> IntArray:
    """Which of n bins of a full turn, from -pi on, each angle (m,) [rad] falls into."""
    return np.mod(np.floor((angles + math.pi) / (2.0 * math.pi) * n).astype(np.int64), n)


def fitting_bin_count(angles: FloatArray) -> int:
    """The finest of `BIN_COUNTS` that points at these angles (m,) fill."""
    coarse = len(set(bins_of(angles, BIN_COUNTS[-1]).tolist()))
    for n in BIN_COUNTS[:-1]:
        if len(set(bins_of(angles, n).tolist())) >= MIN_FILLED * coarse * n / BIN_COUNTS[-1]:
            return n
    return BIN_COUNTS[-1]


def _filled(times_s: FloatArray) -> FloatArray:
    """Times of beams, those without a point as their neighbours'."""
    known = np.flatnonzero(np.isfinite(times_s))
    if not len(known):
        return np.zeros(len(times_s))
    beams = np.arange(len(times_s))
    after = np.minimum(np.searchsorted(known, beams), len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(np.abs(known[after] - beams) <= np.abs(known[before] - beams), after, before)
    return times_s[known[nearer]]
