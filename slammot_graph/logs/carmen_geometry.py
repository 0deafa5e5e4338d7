"""First pass over a CARMEN log: counts, stamps, odometry, the laser's maximum range and its mounting."""

import math
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.types import FloatArray
from slammot_graph.logs.carmen_lines import KINDS, split_laser_line
from slammot_graph.logs.text_lines import numbered_lines

MAX_PLAUSIBLE_RANGE_M = 1000.0
"""No planar laser sees further; a larger reading is a fault and says nothing about the laser's limit."""

MAX_MOUNTING_SPREAD = 0.1
"""Laser poses that wander further about the odometry than this [m, rad] are not a mounting."""

MAX_ODOMETRY_DISTANCE_M, MAX_ODOMETRY_TURN_RAD = 0.2, 0.1
"""ODOM lines whose median distance from the odometry in the laser's lines is larger are of another odometry."""

MIN_ODOMETRY_COVER = 0.9
"""Share of the scans that ODOM lines must cover to be used."""

_MAX_READINGS_HELD = 100_000


@dataclass(frozen=True, kw_only=True)
class CarmenSurvey:
    """Outcome of the first pass over a CARMEN log.

    Attributes
    ----------
    kind : str
        The laser message to read, one of `KINDS`.
    n_scans : int
        Lines of that kind.
    n_beams : int
        Beams of the first well-formed line of that kind; 0 if there is none.
    largest_reading_m : float
        Largest reading of the well-formed lines; 0 if there is none.
    T_base_laser : (x, y, theta)
    mounting_told_by : "given", "the laser's lines" or "assumed"
    stamps : (n_scans,) array [s]
    T_odom_base : (n_scans, 3) array
        Both of the laser's lines, NaN where they are malformed.
    odom_lines : (m, 4) array
        Stamp [s] and base in odom of the ODOM lines.
    warnings : tuple of str
    """

    kind: str
    n_scans: int
    n_beams: int
    largest_reading_m: float
    T_base_laser: tuple[float, float, float]
    mounting_told_by: str
    stamps: FloatArray
    T_odom_base: FloatArray
    odom_lines: FloatArray
    warnings: tuple[str, ...]

    def odometry_lines(self, scan_stamps: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Stamps (m,) and poses (m, 3) of the ODOM lines; None unless they tell the same as the laser's lines."""
        lines = self.odom_lines[np.isfinite(self.odom_lines).all(axis=1)]
        if len(lines) < 2:
            return None
        track = OdometryTrack.from_samples(lines[:, 0], lines[:, 1:])
        is_known = np.isfinite(self.T_odom_base).all(axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            apart = np.abs(se2.between(track.at_many(scan_stamps[is_known]), self.T_odom_base[is_known]))
        apart = apart[np.isfinite(apart).all(axis=1)]
        if len(apart) < MIN_ODOMETRY_COVER * max(1, int(np.count_nonzero(is_known))):
            return None
        x, y, turn = np.median(apart, axis=0)
        if math.hypot(x, y) > MAX_ODOMETRY_DISTANCE_M or turn > MAX_ODOMETRY_TURN_RAD:
            return None
        return lines[:, 0], lines[:, 1:]


class _Readings:
    """Finds the largest of very many readings; they repeat, so each different text is parsed once."""

    def __init__(self) -> None:
        self._texts: set[bytes] = set()
        self._largest_m = 0.0

    def add(self, texts: Iterable[bytes]) -> None:
        self._texts.update(texts)
        if len(self._texts) > _MAX_READINGS_HELD:
            self.largest_m()

    def largest_m(self) -> float:
        for text in self._texts:
            try:
                value = float(text)
            except ValueError:
                continue
            if self._largest_m < value <= MAX_PLAUSIBLE_RANGE_M:
                self._largest_m = value
        self._texts.clear()
        return self._largest_m


class _KindSurvey:
    """What is known from the lines of one kind."""

    def __init__(self) -> None:
        self.n_lines = 0
        self.n_beams = 0
        self.readings = _Readings()
        self.poses: list[tuple[float, ...]] = []
        self.stamps: list[float] = []


def survey_carmen(path: Path, laser_pose: tuple[float, float, float] | None = None) -> CarmenSurvey:
    """Read through a CARMEN log once, decoding no more than needed; a `laser_pose` replaces that of the lines.

    Raises
    ------
    InputError
        The file cannot be read, is truncated, or holds no laser line.
    """
    surveys = {kind: _KindSurvey() for kind in KINDS}
    prefixes = tuple(kind.encode() + b" " for kind in KINDS)
    odom_lines: list[tuple[float, ...]] = []
    with closing(numbered_lines(path)) as lines:
        for _, line in lines:
            if not line.startswith(prefixes):
                if line.startswith(b"ODOM "):
                    odom_lines.append(_odom_line(line))
                continue
            tokens = line.split()
            kind = tokens[0].decode()
            survey = surveys[kind]
            survey.n_lines += 1
            try:
                parts = split_laser_line(kind, tokens)
                stamp, poses = float(parts.stamp), tuple(map(float, parts.laser_and_base))
            except ValueError:  # the decoder will name the line and the reason
                survey.stamps.append(math.nan)
                survey.poses.append((math.nan,) * 6)
                continue
            survey.stamps.append(stamp)
            survey.poses.append(poses)
            survey.n_beams = survey.n_beams or len(parts.ranges)
            if kind != "ROBOTLASER1":
                survey.readings.add(parts.ranges)

    present = [kind for kind in KINDS if surveys[kind].n_lines]
    if not present:
        raise InputError(
            f"{path}: no laser lines ({', '.join(KINDS)}); give a CARMEN log, a bag or an .npz with scans"
        )
    kind, *others = present
    survey = surveys[kind]
    warnings = [f"{other} lines are not used, as the log has {kind} lines" for other in others]
    if kind == "RLASER":
        warnings.append("the log has the rear laser only (RLASER)")
    told_by = "given"
    if laser_pose is None:
        laser_pose, mounting_warning = _mounting(survey.poses)
        told_by = "assumed" if mounting_warning else "the laser's lines"
        warnings += [mounting_warning] if mounting_warning else []
    return CarmenSurvey(
        kind=kind,
        n_scans=survey.n_lines,
        n_beams=survey.n_beams,
        largest_reading_m=survey.readings.largest_m(),
        T_base_laser=laser_pose,
        mounting_told_by=told_by,
        stamps=np.array(survey.stamps),
        T_odom_base=np.array(survey.poses).reshape(-1, 6)[:, 3:],
        odom_lines=np.array(odom_lines, dtype=np.float64).reshape(-1, 4),
        warnings=tuple(warnings),
    )


def _odom_line(line: bytes) -> tuple[float, ...]:
    """Stamp, x, y, theta of ``ODOM x y theta tv rv accel ipc_timestamp ipc_hostname logger_timestamp``."""
    tokens = line.split()
    try:
        return tuple(float(x) for x in (tokens[-3], *tokens[1:4])) if len(tokens) == 10 else (math.nan,) * 4
    except ValueError:
        return (math.nan,) * 4


def _mounting(laser_and_base_poses: list[tuple[float, ...]]) -> tuple[tuple[float, float, float], str]:
    """Median of the laser's pose seen from the base, and a warning when it is no rigid mounting."""
    poses: FloatArray = np.array(laser_and_base_poses, dtype=np.float64).reshape(-1, 6)
    poses = poses[np.isfinite(poses).all(axis=1)]
    if len(poses) == 0:
        return (0.0, 0.0, 0.0), ""
    T_base_laser = se2.between(poses[:, 3:], poses[:, :3])
    T_first_laser = T_base_laser - T_base_laser[0]
    T_first_laser[:, 2] = se2.wrap_angle(
        T_first_laser[:, 2]
    )  # so that a mounting near 180 degrees has a median
    median = np.median(T_first_laser, axis=0)
    spread = np.percentile(np.abs(T_first_laser - median), 90, axis=0)
    if spread.max() > MAX_MOUNTING_SPREAD:
        return (0.0, 0.0, 0.0), (
            "laser poses wander about the odometry (corrected poses?);"
            " the laser is taken to sit on the base, unless --laser-pose says where"
        )
    x, y, theta = (median + T_base_laser[0]).round(4).tolist()
    return (x + 0.0, y + 0.0, math.remainder(theta, math.tau) + 0.0), ""
