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
    l_free: float,
    l_occupied: float,
    l_min: float,
    l_max: float,
) -> None:
    """Update the grid with one scan: each touched cell once, a hit before a pass.

    `stamp` holds for each cell the number `now` of the last scan that touched it; a cell whose stamp is
    below `oldest` has expired and counts as never seen.
    """
    row_mask = log_odds.shape[0] - 1
    col_mask = log_odds.shape[1] - 1
    n = end_points.shape[0]
    for k in range(n):
        if not is_hit[k]:
            continue
        i = (math.floor(end_points[k, 1] * inv_resolution) - row0) & row_mask
        j = (math.floor(end_points[k, 0] * inv_resolution) - col0) & col_mask
        if stamp[i, j] == now:
            continue
        value = log_odds[i, j] if stamp[i, j] >= oldest else np.float32(0.0)
        log_odds[i, j] = min(value + l_occupied, l_max)
        stamp[i, j] = now
    x0 = origin[0] * inv_resolution
    y0 = origin[1] * inv_resolution
    for k in range(n):
        if not is_beam[k]:
            continue
        x1 = end_points[k, 0] * inv_resolution
        y1 = end_points[k, 1] * inv_resolution
        dx = x1 - x0
        dy = y1 - y0
        n_steps = int(max(abs(dx), abs(dy)))
        if n_steps == 0:
            continue
        # cell centres along the longer axis, the end point's own cell left out
        step_x = dx / max(abs(dx), abs(dy))
        step_y = dy / max(abs(dx), abs(dy))
        i_end = math.floor(y1)
        j_end = math.floor(x1)
        for m in range(n_steps):
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
