"""Increments between matched scans and those that the odometry tells, in windows and smoothed for a clock offset."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.odometry.history import OdometryHistory


class Windows:
    """Increments joined so that they are long enough for scales to stand out.

    Attributes
    ----------
    told, found : (n, 3) arrays
        By the odometry at the corrected times, and by the matches.
    steps : (n, k, 3) array
        The odometry's increments from scan to scan.
    var : (n, 2) array
        Variances of the matched motion, translation per axis and rotation.
    """

    def __init__(
        self,
        rows: FloatArray,
        offset_s: float,
        history: OdometryHistory,
        *,
        length_m: float,
        max_size: int,
    ) -> None:
        way = np.hypot(rows[:, 2], rows[:, 3])
        moving = way[way > 0.3 * way.max(initial=0.0)]
        usual = float(np.median(moving)) if moving.size else 0.0
        self.size = size = int(np.clip(round(length_m / max(usual, 1e-3)), 1, max_size))
        first = np.arange(0, max(len(rows) - size + 1, 0), max(size // 2, 1))
        within = first[:, None] + np.arange(size)[None, :]
        # the scans of a window follow each other without a gap
        is_whole: BoolArray = np.ones(len(first), dtype=np.bool_)
        if size > 1 and len(first):
            is_whole = (np.abs(rows[within[:, 1:], 0] - rows[within[:, :-1], 1]) < 1e-9).all(axis=1)
        within = within[is_whole]
        self.n = len(within)
        self.steps = told_increments(rows[within, 0], rows[within, 1], offset_s, history)
        self.found = joined(rows[within, 2:5])
        self.told = told_increments(rows[within[:, 0], 0], rows[within[:, -1], 1], offset_s, history)
        self.var = rows[within[:, -1], 5:7] if self.n else np.zeros((0, 2))


def joined(increments: FloatArray) -> FloatArray:
    """(n, 3) motion over increments (n, k, 3) in a row."""
    T = increments[:, 0]
    for k in range(1, increments.shape[1]):
        T = se2.compose(T, increments[:, k])
    return T


SMOOTHING = np.array([-0.8, -0.4, 0.0, 0.4, 0.8])
"""Poses are means over these parts of the usual step, so that interpolation between samples smooths no offset more."""


def usual_step(rows: FloatArray) -> float:
    """Time of an increment (n, 7) in which half of the time passes in longer ones [s].

    Where scans are stamped in bursts most increments may be far shorter, and their times mean nothing.
    """
    steps = np.sort(rows[:, 1] - rows[:, 0])
    passed = np.cumsum(steps)
    return float(steps[np.searchsorted(passed, 0.5 * passed[-1])])


def smoothed_rows(rows: FloatArray) -> FloatArray:
    """Rows whose increments are those between smoothed matched poses; those with neighbours on both sides only.

    The last column says which laser a row is of; the rows of each stand together.
    """
    starts = np.flatnonzero(np.diff(rows[:, 10])) + 1 if rows.shape[1] > 10 else np.empty(0, dtype=np.int64)
    return np.concatenate([_smoothed(part) for part in np.split(rows, starts)])


def _smoothed(rows: FloatArray) -> FloatArray:
    times, poses = rows[:, 1], rows[:, 7:10].copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    offsets = SMOOTHING * usual_step(rows)

    def smoothed(at_s: FloatArray) -> FloatArray:
        around = at_s[:, None] + offsets
        return np.stack([np.interp(around, times, poses[:, k]).mean(axis=1) for k in range(3)], axis=-1)

    is_gap = np.ones(len(rows) + 1, dtype=np.bool_)
    is_gap[1:-1] = rows[1:, 0] - rows[:-1, 1] > 1e-9
    out = rows.copy()
    out[:, 2:5] = _relative(smoothed(rows[:, 0]), smoothed(rows[:, 1]))
    is_inner = ~(is_gap[:-1] | is_gap[1:])
    is_inner[1:] &= ~is_gap[:-2]  # the pose before reaches back one step more
    return np.asarray(out[is_inner])


def _relative(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n, 3) poses `b` in the frames of `a`, angles as they are."""
    c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
    dx, dy = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    return np.stack([c * dx + s * dy, -s * dx + c * dy, b[:, 2] - a[:, 2]], axis=-1)


def told_increments(
    before_s: FloatArray,
    after_s: FloatArray,
    offset_s: float,
    history: OdometryHistory,
    spread_s: float = 0.0,
) -> FloatArray:
    """(..., 3) increments that the odometry tells between times (...), both shifted; poses smoothed over a spread."""

    def poses(at_s: FloatArray) -> FloatArray:
        if not spread_s:
            return history.at(at_s)
        around = (at_s[:, None] + SMOOTHING * spread_s).ravel()
        return np.asarray(history.at(around).reshape(len(at_s), -1, 3).mean(axis=1))

    increments = _relative(poses(before_s.ravel() + offset_s), poses(after_s.ravel() + offset_s))
    return increments.reshape(*before_s.shape, 3)
