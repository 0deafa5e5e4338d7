"""A look at the scans alone: what the laser says of itself, whether it sees anything, and in which units."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from slammot_graph.core.findings import Finding
from slammot_graph.core.scan import NO_RETURN_FRACTION, LaserModel, Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.localization.config import ScanToMapConfig
from slammot_graph.methods import Config
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.registration.point_to_line import PointToLineConfig

N_FIRST_SCANS = 20
"""So many scans are looked at before a run."""

N_ALL, EVERY = 100, 10
"""Of the first scans each is measured, of the later ones one of so many."""

METRES_AT_MOST = 200.0
"""A median range above this is none of a laser in a building or a street."""

FULL_TURN = 1.1
"""A field of view of more turns than this is no field of view."""

MOST = 0.9
"""What holds for this share of the scans holds for the log."""

MOVED_M = 0.1
"""In the median over the beams, the ranges of a scan have changed by this since the first one: the laser has moved."""


@dataclass(frozen=True, kw_only=True)
class MatchLimits:
    """What a method asks of a scan.

    Attributes
    ----------
    makes_matches : bool
    min_points : int
        Fewer cannot be matched.
    max_range_m : float
        Farther returns are left aside.
    """

    makes_matches: bool = True
    min_points: int = PointToLineConfig().min_pairs
    max_range_m: float = math.inf


def limits_of(config: Config) -> MatchLimits:
    """Give what the method of a configuration asks of a scan."""
    if not isinstance(config, PipelineConfig):
        return MatchLimits(max_range_m=config.max_range_m)
    localizer = config.localizer
    if isinstance(localizer, ScanToMapConfig):
        return MatchLimits(min_points=localizer.point_to_line.min_pairs, max_range_m=config.max_range_m)
    return MatchLimits(
        makes_matches=config.has_matches,
        max_range_m=config.max_range_m,
    )


class ScanStatistics:
    """Figures of the scans, gathered one by one.

    Attributes
    ----------
    limits : MatchLimits
    n_scans : int
    laser : LaserModel or None
        Of the first scan.
    n_lasers : int
        Geometries that followed each other, one more than the changes.
    first_stamp, last_stamp : float
        [s]; NaN without scans.
    """

    def __init__(self, limits: MatchLimits) -> None:
        self.limits = limits
        self.n_scans = 0
        self.laser: LaserModel | None = None
        self.n_lasers = 0
        self.first_stamp = self.last_stamp = math.nan
        self._rows: list[tuple[float, float, float, float, float, float]] = []
        self._reference: FloatArray | None = None
        self._latest_laser: LaserModel | None = None

    def add(self, scan: Scan) -> None:
        """Take in the next scan."""
        if self.n_scans == 0:
            self.laser, self.first_stamp = scan.laser, scan.stamp
        if scan.laser is not self._latest_laser:
            self.n_lasers += scan.laser != self._latest_laser
            self._latest_laser = scan.laser
        self.last_stamp = scan.stamp
        if self.n_scans < N_ALL or self.n_scans % EVERY == 0:
            self._rows.append(self._measure(scan))
        self.n_scans += 1

    @property
    def duration_s(self) -> float:
        """Between the first and the last stamp; NaN without scans."""
        return self.last_stamp - self.first_stamp

    @property
    def rate_hz(self) -> float:
        """Scans per second; NaN where the stamps do not tell."""
        return (self.n_scans - 1) / self.duration_s if self.duration_s > 0.0 else math.nan

    @property
    def field_of_view_rad(self) -> float:
        """Between the first and the last beam; NaN without scans."""
        return math.nan if self.laser is None else self.laser.field_of_view_rad

    @property
    def n_measured(self) -> int:
        """Scans that the figures below are of."""
        return len(self._rows)

    @property
    def n_points(self) -> FloatArray:
        """(k,) returns within the laser's limits and `max_range_m`, for each measured scan."""
        return self._column(0)

    @property
    def n_beyond(self) -> FloatArray:
        """(k,) returns within the laser's limits, but beyond `max_range_m`."""
        return self._column(1)

    @property
    def no_return_share(self) -> FloatArray:
        """(k,) share of beams without a return: at or beyond the laser's maximum, or not a number."""
        return self._column(2)

    @property
    def median_range_m(self) -> FloatArray:
        """(k,) median of what are numbers, save those equal to the largest; NaN where too few are."""
        return self._column(3)

    @property
    def nearest_m(self) -> FloatArray:
        """(k,) nearest return within the laser's limits; NaN without any."""
        return self._column(4)

    @property
    def has_moved(self) -> bool:
        """Whether the ranges say by themselves that the laser moved, whatever match and odometry tell."""
        changes = self._column(5)
        changes = changes[np.isfinite(changes)]
        return len(changes) >= N_FIRST_SCANS and bool(np.mean(changes > MOVED_M) > 0.2)

    def findings(self) -> list[Finding]:
        """Say what the scans alone show."""
        if self.laser is None:
            return []
        laser, limits = self.laser, self.limits
        found = [*_of_angles(laser), *self._of_units()]
        if not limits.makes_matches or found:
            return found
        if laser.n_beams < limits.min_points:
            return [
                Finding(
                    kind="too few beams",
                    severity="error",
                    cause=(
                        f"too few beams: {laser.n_beams} beams, a match needs {limits.min_points} points:"
                        " nothing can be matched"
                    ),
                    remedy="take a laser with more beams, or the topic that has all of them",
                    data={"n_beams": laser.n_beams, "min_points": limits.min_points},
                )
            ]
        return self._of_returns()

    def _of_units(self) -> list[Finding]:
        medians = self.median_range_m
        medians = medians[np.isfinite(medians)]
        if not len(medians) or not np.median(medians) > METRES_AT_MOST:
            return []
        median = float(np.median(medians))
        return [
            Finding(
                kind="ranges in millimetres",
                severity="error",
                cause=(
                    f"ranges look like millimetres or centimetres: their median, {median:.0f} m, lies beyond"
                    " what a laser reaches"
                ),
                remedy="divide ranges, range_min and range_max by 1000, or by 100",
                data={"median_range_m": median},
            )
        ]

    def _of_returns(self) -> list[Finding]:
        assert self.laser is not None
        limits, n_points, n_beyond = self.limits, self.n_points, self.n_beyond
        is_short = n_points < limits.min_points
        n_short, n = int(np.count_nonzero(is_short)), self.n_measured
        data = {"n_scans": n_short, "n_measured": n}
        if n_short <= MOST * n:
            if n_short <= 0.2 * n:
                return []
            return [
                Finding(
                    kind="too few returns",
                    severity="warning",
                    cause=(
                        f"too few returns: {n_short} of {n} scans looked at have fewer than {limits.min_points}"
                        " points, which a match needs"
                    ),
                    remedy="look what occludes the laser, and whether it reaches the walls",
                    data=data,
                )
            ]
        if np.mean(n_beyond[is_short] >= limits.min_points) > 0.5:
            return [
                Finding(
                    kind="beyond max_range",
                    severity="error",
                    cause=(
                        f"nothing can be matched: nearly every return lies beyond max_range"
                        f" ({limits.max_range_m:g} m), in {n_short} of {n} scans looked at"
                    ),
                    remedy="give a larger --max-range",
                    data=data,
                )
            ]
        share = float(np.mean(self.no_return_share[is_short]))
        return [
            Finding(
                kind="no returns",
                severity="error",
                cause=(
                    f"no return in {n_short} of {n} scans looked at: {100.0 * share:.0f}% of the beams are empty"
                    f" or at the laser's range_max ({self.laser.range_max:g} m), nothing can be matched"
                ),
                remedy="look whether the laser is covered, out of its reach, or range_max is too small",
                data={**data, "no_return_share": share},
            )
        ]

    def _column(self, column: int) -> FloatArray:
        return np.array([row[column] for row in self._rows], dtype=np.float64)

    def _measure(self, scan: Scan) -> tuple[float, float, float, float, float, float]:
        ranges, limits = scan.ranges, self.limits
        is_return = scan.is_valid()
        n_returns = int(np.count_nonzero(is_return))
        n_points = int(np.count_nonzero(is_return & (ranges < limits.max_range_m)))
        known = ranges[np.isfinite(ranges) & (ranges > 0.0)]
        # drivers put one large number where there is no return
        known = known[known < known.max()] if len(known) else known
        median = float(np.median(known)) if len(known) >= max(3, 0.1 * len(ranges)) else math.nan
        missing = ~np.isfinite(ranges) | (ranges >= NO_RETURN_FRACTION * scan.laser.range_max)
        nearest = float(ranges[is_return].min()) if n_returns else math.nan
        seen = np.where(is_return, ranges, np.nan)
        change = math.nan
        if self._reference is None:
            self._reference = seen if n_returns else None
        elif len(self._reference) == len(seen):
            both = np.isfinite(self._reference) & is_return
            if both.any():
                change = float(np.median(np.abs(seen[both] - self._reference[both])))
        return n_points, n_returns - n_points, float(np.mean(missing)), median, nearest, change


def _of_angles(laser: LaserModel) -> list[Finding]:
    view = laser.field_of_view_rad
    turns = view / (2.0 * math.pi)
    if turns <= FULL_TURN:
        return []
    data = {"field_of_view_rad": view, "angle_increment_rad": laser.angle_increment}
    if view <= FULL_TURN * 360.0:
        return [
            Finding(
                kind="angles in degrees",
                severity="error",
                cause=f"angles look like degrees: {laser.n_beams} beams cover {turns:.3g} turns, more than a full turn",
                remedy="give angle_min and angle_increment in radians",
                data=data,
            )
        ]
    return [
        Finding(
            kind="more than a full turn",
            severity="error",
            cause=f"the angles are wrong: {laser.n_beams} beams cover {turns:.3g} turns, more than a full turn",
            remedy="mend angle_increment, it is the step from one beam to the next in radians",
            data=data,
        )
    ]


def inspect_first(scans: Iterable[Scan], limits: MatchLimits, n_scans: int = N_FIRST_SCANS) -> list[Finding]:
    """Look at the first scans of a log that can be read again: what is plainly wrong before a run has begun."""
    statistics = ScanStatistics(limits)
    iterator = iter(scans)
    for scan in islice(iterator, n_scans):
        statistics.add(scan)
    close = getattr(iterator, "close", None)
    if close is not None:
        close()
    return statistics.findings()
