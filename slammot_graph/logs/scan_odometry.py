"""The odometry of a log's scans: which poses make sense, which scans go without, and the track of all."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core.log_info import SourceInfo
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.types import BoolArray, FloatArray

MAX_COORDINATE_M = 1e6
"""Odometry further than this from where the log's odometry is (its median) makes no sense [m]."""

MAX_TURN_RAD = 1e6
"""Nor does a heading above this."""

MAX_EARTH_M = 1e8
"""No frame on Earth has larger coordinates [m]."""

LASER_ALONE = "the laser alone tells of the motion"

MAX_SKIPPED_RUN = 5
"""Scans in a row that lack odometry are left out up to this many; a longer run is kept, for the laser alone."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanOdometry:
    """Odometry of the n scan records of a log, in the file's order.

    Attributes
    ----------
    is_usable : (n,) bool array
        The scan has odometry that makes sense.
    is_optional : (n,) bool array
        The scan is used without odometry; the others need theirs.
    track : OdometryTrack or None
        See `Scan.odometry`.
    warnings : tuple of str
    is_wanted : bool
        False: the user leaves the log's odometry aside.
    """

    is_usable: BoolArray
    is_optional: BoolArray
    track: OdometryTrack | None = None
    warnings: tuple[str, ...] = ()
    is_wanted: bool = True

    def of(self, record: int, told: FloatArray) -> FloatArray | None:
        """(3,) odometry of a scan record of which the file told this (3,); None: use the scan without.

        Raises
        ------
        ValueError
            The scan cannot be used.
        """
        if self.is_optional[record]:
            return None
        if not self.is_usable[record]:
            if np.isfinite(told).all():
                numbers = ", ".join(f"{x:.4g}" for x in told.tolist())
                raise ValueError(f"its odometry ({numbers}) is out of any sense")
            raise ValueError("its odometry is not finite")
        return told

    @property
    def source(self) -> SourceInfo:
        """What `source_of` says of it: nothing where it is used."""
        if not self.is_wanted:
            return {"odometry": "off"}
        return {"odometry": "none"} if self.is_optional.all() else {}


def no_odometry(n_scans: int, why: str) -> ScanOdometry:
    """A log without odometry, or without any that can be used, with a warning that says so."""
    return _none(n_scans, warnings=(f"{why}: {LASER_ALONE}",))


def odometry_of_log(
    T_odom_base: FloatArray | None,
    scan_stamps: FloatArray,
    track_stamps: FloatArray | None = None,
    track_poses: FloatArray | None = None,
    *,
    is_wanted: bool = True,
) -> ScanOdometry:
    """Sort out the odometry of a log.

    Parameters
    ----------
    T_odom_base : (n, 3) array or None
        Odometry of the scan records, NaN where there is none; None: the log has none.
    scan_stamps : (n,) array [s]
        May hold NaN.
    track_stamps, track_poses : (m,) array [s], (m, 3) array, optional
        The log's odometry on its own stamps; by default that of the scans.
    is_wanted : bool
        False: the user leaves it aside.
    """
    n_scans = len(scan_stamps)
    if not is_wanted:
        return _none(n_scans, is_wanted=False)
    if T_odom_base is None:
        return no_odometry(n_scans, "no odometry")
    is_sane = are_sane_poses(T_odom_base)
    if not is_sane.any():
        return no_odometry(n_scans, "no odometry pose is finite and makes sense")
    is_optional = _long_runs(~is_sane)
    warnings = []
    if is_optional.any():
        n = np.count_nonzero(is_optional)
        warnings.append(f"{n} of {n_scans} scans have no odometry: {LASER_ALONE} there")
    if track_stamps is None or track_poses is None:
        track_stamps, track_poses = scan_stamps, T_odom_base
    return ScanOdometry(
        is_usable=is_sane,
        is_optional=is_optional,
        track=rising_track(track_stamps, track_poses, scan_stamps),
        warnings=tuple(warnings),
    )


def _none(n_scans: int, *, warnings: tuple[str, ...] = (), is_wanted: bool = True) -> ScanOdometry:
    return ScanOdometry(
        is_usable=np.zeros(n_scans, dtype=np.bool_),
        is_optional=np.ones(n_scans, dtype=np.bool_),
        warnings=warnings,
        is_wanted=is_wanted,
    )


def rising_track(
    stamps: FloatArray, T_odom_base: FloatArray, scan_stamps: FloatArray
) -> OdometryTrack | None:
    """The poses (m, 3) that make sense as a track; None unless its stamps and the scans' rise in their order."""
    is_used = are_sane_poses(T_odom_base) & np.isfinite(stamps)
    stamps, T_odom_base = stamps[is_used], T_odom_base[is_used]
    if len(stamps) < 2 or not (_rise(stamps) and _rise(scan_stamps)):
        return None
    return OdometryTrack.from_samples(stamps, T_odom_base)


def are_sane_poses(poses: FloatArray) -> BoolArray:
    """(n,) mask of the poses (n, 3) that are finite and not out of any sense."""
    with np.errstate(invalid="ignore", over="ignore"):
        is_sane: BoolArray = (np.abs(poses[:, :2]).max(axis=1, initial=0.0) <= MAX_EARTH_M) & (
            np.abs(poses[:, 2]) <= MAX_TURN_RAD
        )
        if not is_sane.any():
            return is_sane
        centre = np.median(poses[is_sane, :2], axis=0)
        is_near: BoolArray = np.abs(poses[:, :2] - centre).max(axis=1) <= MAX_COORDINATE_M
        return is_sane & is_near


def _rise(stamps: FloatArray) -> bool:
    """Whether the finite stamps go up, never down."""
    steps_s = np.diff(stamps[np.isfinite(stamps)])
    return bool((steps_s >= 0.0).all() and (steps_s > 0.0).any())


def _long_runs(is_missing: BoolArray) -> BoolArray:
    """(n,) mask of the runs of missing odometry that are too long to leave their scans out."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_missing, [False]]).astype(np.int8)))
    is_long = np.zeros(len(is_missing), dtype=np.bool_)
    for first, end in edges.reshape(-1, 2):
        is_long[first:end] = end - first > MAX_SKIPPED_RUN
    return is_long
