"""Kernels of place recognition: max-pooled score grids and a branch-and-bound search over them."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray


@kernel
def max_pool(score: "np.ndarray", step: int, out: "np.ndarray") -> None:
    """Fill ``out[i, j]`` with the largest of ``score[i : i + 2 * step : step, j : j + 2 * step : step]``.

    Pooling a grid that is pooled over `step` cells gives one pooled over ``2 * step``.
    """
    rows, cols = score.shape
    for i in range(rows):
        for j in range(cols):
            best = score[i, j]
            if i + step < rows:
                best = max(best, score[i + step, j])
            if j + step < cols:
                best = max(best, score[i, j + step])
            if i + step < rows and j + step < cols:
                best = max(best, score[i + step, j + step])
            out[i, j] = best


@kernel
def _score_at(grid: "np.ndarray", rows_of: "np.ndarray", cols_of: "np.ndarray", di: int, dj: int) -> int:
    rows, cols = grid.shape
    total = 0
    for k in range(rows_of.shape[0]):
        i = rows_of[k] + di
        j = cols_of[k] + dj
        if i >= 0 and i < rows and j >= 0 and j < cols:
            total += grid[i, j]
    return total


@kernel
def branch_and_bound(
    pyramid: "np.ndarray",
    origin_x: float,
    origin_y: float,
    inv_cell: float,
    points: FloatArray,
    centre: FloatArray,
    n_cells: int,
    n_turns: int,
    turn_step: float,
    excluded: FloatArray,
    exclude_m: float,
    exclude_rad: float,
    min_score: int,
    out: FloatArray,
) -> int:
    """Find the pose of `points` in the grid with the largest score, above `min_score`, around `centre`.

    `pyramid` (levels, rows, cols) holds the score grid with a margin, level l pooled over 2**l cells. The search
    covers +-`n_cells` cells in x and y and +-`n_turns` steps of `turn_step` [rad], less a ball around the pose
    `excluded`. Fills `out` (3,) and returns the score; 0 where nothing is above `min_score`.
    """
    levels = pyramid.shape[0]
    n = points.shape[0]
    top = levels - 1
    width = 1 << top
    rows_of = np.empty(n, dtype=np.int64)
    cols_of = np.empty(n, dtype=np.int64)
    best = min_score
    found = False
    stack = np.empty((4096, 4), dtype=np.int64)
    n_blocks = (2 * n_cells + width) // width
    order = np.empty(n_blocks * n_blocks, dtype=np.int64)
    bounds = np.empty(n_blocks * n_blocks, dtype=np.int64)
    for turn_number in range(2 * n_turns + 1):
        # from the middle outwards: 0, -1, 1, -2, 2 ...
        turn = (turn_number + 1) // 2 * (1 if turn_number % 2 == 0 else -1)
        theta = centre[2] + turn * turn_step
        c = math.cos(theta)
        s = math.sin(theta)
        for k in range(n):
            x = centre[0] + c * points[k, 0] - s * points[k, 1]
            y = centre[1] + s * points[k, 0] + c * points[k, 1]
            rows_of[k] = math.floor((y - origin_y) * inv_cell)
            cols_of[k] = math.floor((x - origin_x) * inv_cell)
        for b in range(n_blocks * n_blocks):
            di = -n_cells + (b // n_blocks) * width
            dj = -n_cells + (b % n_blocks) * width
            bounds[b] = -_score_at(pyramid[top], rows_of, cols_of, di, dj)
        order[:] = np.argsort(bounds, kind="mergesort")
        for b in order:
            if -bounds[b] <= best:
                break
            size = 0
            stack[0, 0] = top
            stack[0, 1] = -n_cells + (b // n_blocks) * width
            stack[0, 2] = -n_cells + (b % n_blocks) * width
            stack[0, 3] = -bounds[b]
            size = 1
            while size > 0:
                size -= 1
                level = stack[size, 0]
                di = stack[size, 1]
                dj = stack[size, 2]
                if stack[size, 3] <= best:
                    continue
                if level == 0:
                    x = centre[0] + dj / inv_cell
                    y = centre[1] + di / inv_cell
                    turned = (theta - excluded[2] + math.pi) % (2.0 * math.pi) - math.pi
                    near = math.hypot(x - excluded[0], y - excluded[1]) < exclude_m
                    if near and abs(turned) < exclude_rad:
                        continue
                    best = stack[size, 3]
                    found = True
                    out[0] = x
                    out[1] = y
                    out[2] = theta
                    continue
                half = 1 << (level - 1)
                first = size
                for child in range(4):
                    ci = di + half * (child // 2)
                    cj = dj + half * (child % 2)
                    if ci > n_cells or cj > n_cells:
                        continue
                    bound = _score_at(pyramid[level - 1], rows_of, cols_of, ci, cj)
                    if bound <= best:
                        continue
                    # keep the new ones sorted, the best on top
                    at = size
                    while at > first and stack[at - 1, 3] > bound:
                        stack[at] = stack[at - 1]
                        at -= 1
                    stack[at, 0] = level - 1
                    stack[at, 1] = ci
                    stack[at, 2] = cj
                    stack[at, 3] = bound
                    size += 1
    return best if found else 0
