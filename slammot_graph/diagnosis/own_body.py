"""Beams that hit the robot's own body: the same range at the same angle whatever the pose."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.logs import source_of
from slammot_graph.logs.remounted import RemountedLog
from slammot_graph.logs.source import LaserLog, beginning_of

MAX_RANGE_M = 1.2
"""No part of the robot is farther from its laser."""

STEP_M, STEP_RAD = 0.2, 0.2
"""A scan is looked at each time that the odometry has moved or turned so far."""

MAX_SCANS, N_LOOKED_AT, N_FIRST = 3000, 100, 12
"""Scans read at most; scans looked at; after so many a log without a beam that is always near is read no further."""

MIN_SHARE = 0.9
"""Share of the scans looked at, and of the headings, in which a beam hits the body."""

HEADING_RAD, MIN_HEADINGS = math.radians(20.0), 7
"""Headings are told apart by this, and so many are needed: along a wall the beams across do not change either."""

LEAST_SPREAD_M, MOST_SPREAD_M = 0.02, 0.05
"""Bounds of how far from its usual range a return of the body may be."""

MIN_CHANGE_M = 0.3
"""The ranges of the other beams have changed by this in the median: the robot has truly moved."""

Source = TypeVar("Source", bound=Iterable[Scan])


@dataclass(frozen=True, kw_only=True, eq=False)
class OwnBody:
    """Where the beams of a laser hit the robot.

    Attributes
    ----------
    range_m : (n,) array
        Their usual range there; NaN of beams that do not.
    spread_m : (n,) array
        How far from it such a return may be.
    """

    range_m: FloatArray
    spread_m: FloatArray

    def hits(self, ranges: FloatArray) -> BoolArray:
        """(n,) mask of the ranges (n,) [m] that are of the body."""
        return np.asarray(np.abs(ranges - self.range_m) <= self.spread_m)  # NaN is no hit


def without_own_body(log: Source) -> Source | RemountedLog:
    """Give a recorded log without the returns of the robot's own body; a log that has none as it is."""
    if "odometry" in source_of(log) or not isinstance(log, LaserLog):
        return log
    bodies = {
        laser: body for laser, looked in look_at(log).items() if (body := find_body(looked)) is not None
    }
    if not bodies:
        return log

    def leave_aside(scan: Scan) -> Scan:
        body = bodies.get(scan.laser)
        is_body = None if body is None else body.hits(scan.ranges)
        if is_body is None or not is_body.any():
            return scan
        return replace(scan, ranges=np.where(is_body, np.nan, scan.ranges))

    warnings = [_warning(laser, body) for laser, body in bodies.items()]
    return RemountedLog(log, mend=leave_aside, warnings=warnings)


def _warning(laser: LaserModel, body: OwnBody) -> str:
    beams = np.flatnonzero(np.isfinite(body.range_m))
    edges = np.flatnonzero(np.diff(beams) > 1)
    firsts, lasts = beams[np.append(0, edges + 1)], beams[np.append(edges, len(beams) - 1)]
    degrees = np.degrees(laser.angle_min + laser.angle_increment * np.arange(laser.n_beams))
    ends = zip(firsts, lasts, strict=True)
    sectors = [f"{degrees[a]:.0f}" + ("" if a == b else f" to {degrees[b]:.0f}") for a, b in ends]
    more = "" if len(sectors) <= 4 else f" and {len(sectors) - 4} more"
    low, high = np.nanmin(body.range_m), np.nanmax(body.range_m)
    where = (
        f"at {', '.join(sectors[:4])}{more} degrees of the laser, {low:.2f} to {high:.2f} m whatever the pose"
    )
    return f"{len(beams)} beams hit the robot's own body ({where}); these returns are left aside"


@dataclass(eq=False)
class LookedAt:
    """Scans of a laser at different poses: ranges (n,) [m] and headings [rad]."""

    ranges: list[FloatArray] = field(default_factory=list)
    headings: list[float] = field(default_factory=list)
    n_near: FloatArray | None = None

    def add(self, ranges: FloatArray, heading: float) -> None:
        """Take in a scan."""
        self.ranges.append(ranges)
        self.headings.append(heading)
        is_near = (ranges > 1e-3) & (ranges < MAX_RANGE_M)
        self.n_near = is_near.astype(np.float64) if self.n_near is None else self.n_near + is_near

    @property
    def may_see_body(self) -> bool:
        """Whether a beam is nearly always near."""
        return self.n_near is None or bool((self.n_near >= MIN_SHARE * len(self.ranges)).any())


def look_at(log: Iterable[Scan]) -> dict[LaserModel, LookedAt]:
    """Take scans of a log at different poses by the odometry, for each laser."""
    looked: dict[LaserModel, LookedAt] = {}
    last: dict[LaserModel, FloatArray] = {}
    with beginning_of(log) as scans:
        for n_scans, scan in enumerate(scans, start=1):
            if scan.T_odom_base is not None:
                distance_m, turn_rad = (
                    se2.distance(last[scan.laser], scan.T_odom_base)
                    if scan.laser in last
                    else (math.inf, 0.0)
                )
                if distance_m > STEP_M or turn_rad > STEP_RAD:
                    last[scan.laser] = scan.T_odom_base
                    looked.setdefault(scan.laser, LookedAt()).add(scan.ranges, float(scan.T_odom_base[2]))
            n = sum(len(x.ranges) for x in looked.values())
            is_clear = n >= N_FIRST * len(looked) and not any(x.may_see_body for x in looked.values())
            if (looked and is_clear) or n_scans >= MAX_SCANS or n >= N_LOOKED_AT * max(len(looked), 1):
                break
    return looked


def find_body(looked: LookedAt) -> OwnBody | None:
    """Find the beams that hit the robot's body; None where there are none, or too little motion tells of them."""
    bins = np.floor(np.mod(looked.headings, 2.0 * math.pi) / HEADING_RAD).astype(np.int64)
    headings = np.unique(bins)
    if len(headings) < MIN_HEADINGS or len(looked.ranges) < 2 * MIN_HEADINGS:
        return None
    ranges = np.array(looked.ranges)
    is_return = np.isfinite(ranges) & (ranges > 1e-3)
    known = np.where(is_return, ranges, 1e6)  # no return is far
    usual = np.median(known, axis=0)
    spread = np.clip(4.0 * 1.4826 * np.median(np.abs(known - usual), axis=0), LEAST_SPREAD_M, MOST_SPREAD_M)
    is_same = np.abs(known - usual) <= spread
    share_of_heading = np.array([is_same[bins == k].mean(axis=0) for k in headings])
    is_body = (
        (usual < MAX_RANGE_M)
        & (is_same.mean(axis=0) >= MIN_SHARE)
        & ((share_of_heading >= 0.5).mean(axis=0) >= MIN_SHARE)
    )
    if not is_body.any() or is_body.mean() > 0.5:
        return None
    low, high = np.percentile(known[:, ~is_body], (10.0, 90.0), axis=0)
    if not np.median(high - low) > MIN_CHANGE_M:
        return None
    return OwnBody(range_m=np.where(is_body, usual, np.nan), spread_m=spread)
