"""Kernels of the occupancy grid: beams free the cells they cross, end points occupy theirs.

Cells are addressed by global integers (row = floor(y / resolution), column likewise) and stored at
``(row - row0) & (rows - 1)``; both sides of the storage are powers of two, so that one addressing serves a
grid that covers a fixed area and one that rolls along with the robot.
"""

import math

import numpy as np

from slammot_graph._numba import kernel
from slammot_graph.types import BoolArray, FloatArray


@kernel
def update_beams(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    inv_resolution: float,
    now: int,
    oldest: int,
    origin: FloatArray,
    end_points: FloatArray,
    is_beam: BoolArray,
    is_hit: BoolArray,
    is_soft_hit: BoolArray,
    l_free: float,
    l_occupied: float,
    l_soft: float,
    fill_gaps: bool,
    l_min: float,
    l_max: float,
) -> None:
    """Update the grid with one scan: each touched cell once, a hit before a pass.

    A beam frees the cells on its line, and with the beam beside it those between them, so that beams that are
    farther apart than a cell leave no gaps.

    `stamp` holds for each cell the number `now` of the last scan that touched it; a cell whose stamp is
    below `oldest` has expired and counts as never seen.
    """
    n = end_points.shape[0]
    for k in range(n):
        if is_hit[k]:
            _add_hit(
                log_odds, stamp, row0, col0, inv_resolution, now, oldest, end_points[k], l_occupied, l_max
            )
    for k in range(n):
        if is_soft_hit[k]:
            _add_hit(log_odds, stamp, row0, col0, inv_resolution, now, oldest, end_points[k], l_soft, l_max)
    x0 = origin[0] * inv_resolution
    y0 = origin[1] * inv_resolution
    last = -2
    x_last = y_last = range_last = 1.0
    for k in range(n):
        if not is_beam[k]:
            last = -2
            continue
        x1 = end_points[k, 0] * inv_resolution - x0
        y1 = end_points[k, 1] * inv_resolution - y0
        range1 = math.sqrt(x1 * x1 + y1 * y1)
        if range1 == 0.0:
            last = -2
            continue
        _free_line(
            log_odds, stamp, row0, col0, now, oldest, x0, y0, x1, y1, 0.0, 1.0, l_free, l_min
        )  # fmt: skip
        if fill_gaps and last == k - 1:
            # beside the beam before: lines in between, from where the two are a cell apart to the shorter one's end
            reach = min(range1, range_last)
            cross = abs(x1 * y_last - y1 * x_last) / (range1 * range_last)
            n_between = int(reach * cross) if cross < 0.1 else 0
            for m in range(1, n_between + 1):
                share = m / (n_between + 1)
                ux = x_last / range_last * (1.0 - share) + x1 / range1 * share
                uy = y_last / range_last * (1.0 - share) + y1 / range1 * share
                start = 1.0 / cross / reach
                _free_line(
                    log_odds, stamp, row0, col0, now, oldest, x0, y0, ux * reach, uy * reach,
                    start, 1.0 - 1.0 / reach, l_free, l_min,
                )  # fmt: skip
        last = k
        x_last = x1
        y_last = y1
        range_last = range1


@kernel
def _add_hit(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    inv_resolution: float,
    now: int,
    oldest: int,
    point: FloatArray,
    l_hit: float,
    l_max: float,
) -> None:
    i = (math.floor(point[1] * inv_resolution) - row0) & (log_odds.shape[0] - 1)
    j = (math.floor(point[0] * inv_resolution) - col0) & (log_odds.shape[1] - 1)
    if stamp[i, j] != now:
        value = log_odds[i, j] if stamp[i, j] >= oldest else np.float32(0.0)
        log_odds[i, j] = min(value + l_hit, l_max)
        stamp[i, j] = now


@kernel
def _free_line(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    now: int,
    oldest: int,
    x0: float,
    y0: float,
    dx: float,
    dy: float,
    start: float,
    end: float,
    l_free: float,
    l_min: float,
) -> None:
    """Free the cells from share `start` to share `end` of a line, its last cell left out; lengths in cells."""
    row_mask = log_odds.shape[0] - 1
    col_mask = log_odds.shape[1] - 1
    longest = max(abs(dx), abs(dy))
    step_x = dx / longest
    step_y = dy / longest
    i_end = math.floor(y0 + dy)
    j_end = math.floor(x0 + dx)
    for m in range(int(start * longest), int(end * longest) + 1):
        ig = math.floor(y0 + step_y * m)
        jg = math.floor(x0 + step_x * m)
        if ig == i_end and jg == j_end:
            break
        i = (ig - row0) & row_mask
        j = (jg - col0) & col_mask
        if stamp[i, j] == now:
            continue
        value = log_odds[i, j] if stamp[i, j] >= oldest else np.float32(0.0)
        log_odds[i, j] = max(value + l_free, l_min)
        stamp[i, j] = now
