"""A look at the raw odometry: whether it moves, stands still while the robot drives, leaps, or tells the impossible."""

import math
import struct

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.findings import Finding
from slammot_graph.core.spool import Spool
from slammot_graph.core.types import BoolArray, FloatArray

STILL_M, STILL_RAD = 1e-6, 1e-6
"""An increment below both is none: encoders that count give more, or exactly nothing."""

MOVES_M, MOVES_RAD = 0.3, 0.3
"""A robot that got this far while the odometry stood still has moved."""

MIN_STILL_SCANS = 5
"""Shorter standstills are those of an odometry that comes seldom."""

MIN_LEAPS, LEAP_SHARE, LEAP_FACTOR = 5, 0.01, 1.7
"""A leap is an increment this many times the usual that follows one of nothing amid motion."""

JUMP_SPEED_M_S, JUMP_SPEED_RAD_S = 5.0, 10.0
USUAL_PERCENTILE = 75.0
"""Up to a quarter of the increments may jump."""
JUMP_FACTOR, JUMP_M, JUMP_RAD = 5.0, 0.3, 0.5
"""A jump is faster than this, this many times faster than the log mostly is while it moves, and this long."""
WRONG_WAY_SHARE, MIN_TURNED_RAD = 0.8, 2.0
"""Of so much turning at least, this share has the other sign than the laser's where the sign is wrong."""
TURNS_RAD = 0.02
"""From scan to scan; smaller turns may have either sign by noise."""

_ROW = struct.Struct("=7d")
_MOST_IN_MEMORY = 1 << 20
_UNKNOWN = [math.nan] * 3


class OdometryStatistics:
    """The increments of the raw odometry, and how far the robot was estimated to get meanwhile.

    Attributes
    ----------
    n_scans : int
    n_with_odometry : int
        Scans that have any.
    spool : Spool
        Stamp, odometry and estimate of each.
    """

    def __init__(self) -> None:
        self.n_scans = 0
        self.n_with_odometry = 0
        self.spool = Spool(_MOST_IN_MEMORY)

    def add(self, stamp: float, T_odom_base: FloatArray | None, T_map_base: FloatArray) -> None:
        """Take in the next scan.

        Parameters
        ----------
        stamp : float
            [s].
        T_odom_base : (3,) array or None
            Raw odometry.
        T_map_base : (3,) array
            Estimate of the time.
        """
        self.n_scans += 1
        self.n_with_odometry += T_odom_base is not None
        odometry = _UNKNOWN if T_odom_base is None else T_odom_base.tolist()
        self.spool.add(_ROW.pack(stamp, *odometry, *T_map_base.tolist()))

    @property
    def distance_m(self) -> float:
        """Path length of the raw odometry; it may be infinite where that is absurd."""
        return float(self._table[:, 2].sum())

    @property
    def turn_rad(self) -> float:
        """Sum of its turns, whichever way."""
        return float(self._table[:, 3].sum())

    def findings(self, *, has_moved: bool) -> list[Finding]:
        """Say what the odometry alone shows, given whether the ranges say that the laser moved."""
        if self.n_scans and not self.n_with_odometry:
            return [_nothing(self.n_scans)]
        table = self._table
        if not len(table):
            return []
        is_still = (table[:, 2] < STILL_M) & (table[:, 3] < STILL_RAD)
        if is_still.all():
            return [_never_moves(self.n_with_odometry)] if has_moved or _gets_far(table).any() else []
        return [*_standstills(table, is_still), *_leaps(table, is_still), *_jumps(table), *_wrong_way(table)]

    @property
    def _table(self) -> FloatArray:
        """(k, 8) scan, time step [s], told distance [m] and turn [rad], estimate's step (x, y, theta), signed turn."""
        poses = np.frombuffer(self.spool.since(0), dtype=np.float64).reshape(-1, 7)
        before, after = poses[:-1], poses[1:]
        has_both = np.isfinite(before[:, 1]) & np.isfinite(after[:, 1])
        before, after = before[has_both], after[has_both]
        told = se2.between(before[:, 1:4], after[:, 1:4])
        moved = after[:, 4:] - before[:, 4:]
        moved[:, 2] = se2.wrap_angle(moved[:, 2])
        scans = 1.0 + np.flatnonzero(has_both)
        distance_m, turn_rad = np.hypot(told[:, 0], told[:, 1]), np.abs(told[:, 2])
        step_s = after[:, 0] - before[:, 0]
        return np.column_stack([scans, step_s, distance_m, turn_rad, moved, told[:, 2]])


def n_times(n: int) -> str:
    """Say how often."""
    return "once" if n == 1 else f"{n} times"


def _nothing(n_scans: int) -> Finding:
    return Finding(
        kind="no odometry",
        severity="info",
        cause=f"no odometry in {n_scans} scans: the laser alone tells the motion",
        remedy="",
        data={"n_scans": n_scans},
    )


def _never_moves(n_scans: int) -> Finding:
    return Finding(
        kind="odometry never moves",
        severity="warning",
        cause=f"the odometry never moves in {n_scans} scans, while the laser does",
        remedy="look at the encoders and the odometry's topic, or run with --odometry off",
        data={"n_scans": n_scans},
    )


def _runs(mask: BoolArray) -> list[tuple[int, int]]:
    """First and one past the last row of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def _gets_far(table: FloatArray) -> BoolArray:
    """Whether the estimate got far over each row's end since the first row."""
    steps = np.cumsum(table[:, 4:7], axis=0)
    far: BoolArray = (np.hypot(steps[:, 0], steps[:, 1]) > MOVES_M) | (np.abs(steps[:, 2]) > MOVES_RAD)
    return far


def _standstills(table: FloatArray, is_still: BoolArray) -> list[Finding]:
    """Long standstills in which the robot got somewhere."""
    found = [
        (first, last)
        for first, last in _runs(is_still)
        if last - first >= MIN_STILL_SCANS and _gets_far(table[first:last])[-1]
    ]
    if not found:
        return []
    n_scans = sum(last - first for first, last in found)
    where = [[int(table[first, 0]), int(table[last - 1, 0])] for first, last in found]
    return [
        Finding(
            kind="odometry stands still",
            severity="warning",
            cause=(
                f"the odometry stands still in {n_scans} scans while the laser moves,"
                f" {n_times(len(found))}, first from scan {where[0][0]} on: encoders or their driver stop"
            ),
            remedy="look at the encoders and the odometry's topic",
            data={"n_scans": n_scans, "intervals": where[:20]},
        )
    ]


def _leaps(table: FloatArray, is_still: BoolArray) -> list[Finding]:
    """Standing still amid motion, and leaping after: an odometry that comes seldom or late."""
    is_moving = ~is_still
    usual_m, usual_rad = (
        float(np.median(column[is_moving & (column > 0.0)]))
        if (is_moving & (column > 0.0)).any()
        else math.inf
        for column in (table[:, 2], table[:, 3])
    )
    is_leap = np.zeros(len(table), dtype=np.bool_)
    for first, last in _runs(is_still):
        if last - first >= MIN_STILL_SCANS or first == 0 or last == len(table):
            continue
        around = table[[first - 1, last]]
        # a step from rest to motion is no leap: there was motion before, and more than usual after
        is_leap[last] = (
            around[1, 2] > LEAP_FACTOR * max(usual_m, around[0, 2] / (last - first + 1))
            and around[0, 2] > 0.3 * usual_m
        ) or (around[1, 3] > LEAP_FACTOR * max(usual_rad, 0.02) and around[0, 3] > 0.3 * usual_rad)
    n_leaps, n_moving = int(np.count_nonzero(is_leap)), int(np.count_nonzero(is_moving))
    if n_leaps < max(MIN_LEAPS, LEAP_SHARE * n_moving):
        return []
    return [
        Finding(
            kind="odometry leaps",
            severity="warning",
            cause=(
                f"the odometry stands still and leaps, {n_times(n_leaps)} amid motion, first at scan"
                f" {int(table[is_leap, 0][0])}: it is published too seldom, or arrives late"
            ),
            remedy="publish the odometry at the rate of the scans or above, with the stamps of its encoders",
            data={"n_leaps": n_leaps, "n_moving": n_moving},
        )
    ]


def _jumps(table: FloatArray) -> list[Finding]:
    """Increments that no robot makes."""
    dt, distance, turn = table[:, 1], table[:, 2], table[:, 3]
    has_time = dt > 1e-3
    if np.count_nonzero(has_time) < MIN_STILL_SCANS:
        return []
    with np.errstate(over="ignore"):
        speed, rate = distance[has_time] / dt[has_time], turn[has_time] / dt[has_time]
    usual_m_s, usual_rad_s = (
        float(np.percentile(column[column > 0.0], USUAL_PERCENTILE)) if (column > 0.0).any() else 0.0
        for column in (speed, rate)
    )
    is_jump = (speed > max(JUMP_SPEED_M_S, JUMP_FACTOR * usual_m_s)) & (distance[has_time] > JUMP_M)
    is_jump |= (rate > max(JUMP_SPEED_RAD_S, JUMP_FACTOR * usual_rad_s)) & (turn[has_time] > JUMP_RAD)
    if not is_jump.any():
        return []
    scans = table[has_time, 0][is_jump].astype(np.int64)
    largest_m, largest_rad = (float(column[has_time][is_jump].max()) for column in (distance, turn))
    return [
        Finding(
            kind="odometry jumps",
            severity="warning",
            cause=(
                f"the odometry jumps {n_times(len(scans))}, by up to {largest_m:.3g} m and"
                f" {math.degrees(largest_rad):.3g} degrees from one scan to the next, first at scan {scans[0]}"
            ),
            remedy="look at what resets or corrects the odometry; take that of the wheels, not one fused with a map",
            data={"n_jumps": len(scans), "largest_m": largest_m, "scans": scans[:20].tolist()},
        )
    ]


def _wrong_way(table: FloatArray) -> list[Finding]:
    """Turns that have mostly the other sign than those of the laser."""
    told, moved = table[:, 7], table[:, 6]
    is_turn = (np.abs(told) > TURNS_RAD) & (np.abs(told) < JUMP_RAD) & (np.abs(moved) > TURNS_RAD)
    turned_rad = float(np.abs(told[is_turn]).sum())
    if turned_rad < MIN_TURNED_RAD:
        return []
    share = float(np.abs(told[is_turn & (told * moved < 0.0)]).sum()) / turned_rad
    if share < WRONG_WAY_SHARE:
        return []
    return [
        Finding(
            kind="odometry turns the wrong way",
            severity="warning",
            cause=(
                "the odometry contradicts the laser: it turns the opposite way, or the laser's angles do (mounted"
                f" upside down, or in reverse order), in {100.0 * share:.0f}% of {math.degrees(turned_rad):.0f} degrees"
            ),
            remedy=(
                "look which of them is wrong: where it is the laser the whole map is mirrored, give its"
                " --laser-pose with flip; else mend the sign of the odometry's heading, or run with --odometry off"
            ),
            data={"share": share, "turned_rad": turned_rad},
        )
    ]
