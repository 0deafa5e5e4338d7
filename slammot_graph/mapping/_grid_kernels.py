"""Kernels of the occupancy grid: beams free the cells they cross, end points occupy theirs.

Cells are addressed by global integers (row = floor(y / resolution), column likewise) and stored at
``(row - row0) & (rows - 1)``; both sides of the storage are powers of two, so that one addressing serves a
grid that covers a fixed area and one that rolls along with the robot.
"""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.scan import runs_beyond
from slammot_graph.core.types import BoolArray, FloatArray

FROM_LASER = 32
"""Every so many beams one frees its cells from the laser on; a power of two."""


@kernel
def update_beams(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    inv_resolution: float,
    now: int,
    oldest: int,
    origins: FloatArray,
    end_points: FloatArray,
    is_beam: BoolArray,
    is_hit: BoolArray,
    is_soft_hit: BoolArray,
    l_free: float,
    l_occupied: float,
    l_soft: float,
    fill_gaps: bool,
    max_apart: float,
    l_min: float,
    l_max: float,
) -> None:
    """Update the grid with one scan: each touched cell once, a hit before a pass.

    The beams start from `origins` [m], (1, 2) or (n, 2): neighbours so near to each other that rays are compared as if
    they started from one place.

    A beam frees the cells on its line, and with the beam beside it those between them, so that beams that are
    farther apart than a cell leave no gaps. Where beams lie closer than cells, some leave theirs to the beams beside
    them; single cells on the diagonals, or right before an end point, may so be left out.

    `stamp` holds for each cell the number `now` of the last scan that touched it; a cell whose stamp is
    below `oldest` has expired and counts as never seen.
    """
    n = end_points.shape[0]
    for k in range(n):
        if is_hit[k]:
            _add_hit(
                log_odds,
                stamp,
                row0,
                col0,
                inv_resolution,
                now,
                oldest,
                end_points[k, 0],
                end_points[k, 1],
                l_occupied,
                l_max,
            )
    for k in range(n):
        if is_soft_hit[k]:
            _add_hit(
                log_odds,
                stamp,
                row0,
                col0,
                inv_resolution,
                now,
                oldest,
                end_points[k, 0],
                end_points[k, 1],
                l_soft,
                l_max,
            )
    step = 1 if origins.shape[0] > 1 else 0
    x0 = origins[0, 0] * inv_resolution
    y0 = origins[0, 1] * inv_resolution
    ray = np.empty((n, 3))  # direction and length, in cells; a length of 0 for what frees nothing
    for k in range(n):
        if step:
            x0 = origins[k, 0] * inv_resolution
            y0 = origins[k, 1] * inv_resolution
        dx = end_points[k, 0] * inv_resolution - x0
        dy = end_points[k, 1] * inv_resolution - y0
        length = math.sqrt(dx * dx + dy * dy) if is_beam[k] else 0.0
        ray[k, 0] = dx / length
        ray[k, 1] = dy / length
        ray[k, 2] = length
    for k in range(n):
        ux = ray[k, 0]
        uy = ray[k, 1]
        length = ray[k, 2]
        if length == 0.0:
            continue
        if step:
            x0 = origins[k, 0] * inv_resolution
            y0 = origins[k, 1] * inv_resolution
        freed = _freed_by_others(ray, k, max_apart)
        if length - freed > 0.5:
            _free_line(
                log_odds, stamp, row0, col0, now, oldest, x0, y0, ux * length, uy * length,
                freed / length, 1.0, l_free, l_min,
            )  # fmt: skip
        if fill_gaps and k > 0 and ray[k - 1, 2] > 0.0:
            # beside the beam before: lines in between, from where the two are a cell apart to the shorter one's end
            reach = min(length, ray[k - 1, 2])
            cross = abs(ux * ray[k - 1, 1] - uy * ray[k - 1, 0])
            n_between = int(reach * cross) if cross < 0.1 else 0
            for m in range(1, n_between + 1):
                share = m / (n_between + 1)
                vx = ray[k - 1, 0] * (1.0 - share) + ux * share
                vy = ray[k - 1, 1] * (1.0 - share) + uy * share
                start = 1.0 / cross / reach
                _free_line(
                    log_odds, stamp, row0, col0, now, oldest, x0, y0, vx * reach, vy * reach,
                    start, 1.0 - 1.0 / reach, l_free, l_min,
                )  # fmt: skip


@kernel
def _freed_by_others(ray: FloatArray, k: int, max_apart: float) -> float:
    """How far from the laser [cells] the cells on ray `k` are freed by the rays beside it.

    Near the laser rays lie closer than cells. Every `FROM_LASER`-th ray begins there, the ones halfway between where
    those are `max_apart` [cells] from each other, and so on.
    """
    apart = 1
    while k % (2 * apart) == 0 and apart < FROM_LASER:
        apart *= 2
    if apart == FROM_LASER or k < apart or k + apart >= ray.shape[0]:
        return 0.0
    before = ray[k - apart, 0] * ray[k, 1] - ray[k - apart, 1] * ray[k, 0]
    after = ray[k, 0] * ray[k + apart, 1] - ray[k, 1] * ray[k + apart, 0]
    reach = min(ray[k - apart, 2], ray[k + apart, 2])
    if not (before * after > 0.0 and abs(before + after) < 0.5 and reach > 0.0):
        return 0.0
    return float(min(max_apart / abs(before + after), reach))


@kernel
def _add_hit(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    inv_resolution: float,
    now: int,
    oldest: int,
    x: float,
    y: float,
    l_hit: float,
    l_max: float,
) -> None:
    i = (math.floor(y * inv_resolution) - row0) & (log_odds.shape[0] - 1)
    j = (math.floor(x * inv_resolution) - col0) & (log_odds.shape[1] - 1)
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
    zero = np.float32(0.0)
    l_pass = np.float32(l_free)
    least = np.float32(l_min)
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
        seen = stamp[i, j]
        before = log_odds[i, j]
        value = before if seen >= oldest else zero
        freed = max(value + l_pass, least)
        log_odds[i, j] = before if seen == now else freed  # no branch: which cells are new is hard to foresee
        stamp[i, j] = now


@kernel
def far_beams(
    T_a_base: FloatArray,
    origins_base: FloatArray,
    directions_base: FloatArray,
    reach: float,
    is_missing: BoolArray,
    points: FloatArray,
    is_valid: BoolArray,
    origins: FloatArray,
    ends: FloatArray,
    is_beam: BoolArray,
) -> None:
    """Let the beams that met nothing end at `reach` [m]: fills `ends` (n, 2), `is_beam` (n,) and `origins`.

    The beams start from `origins_base` [m], (1, 2) or (n, 2).
    """
    c = math.cos(T_a_base[2])
    s = math.sin(T_a_base[2])
    n_origins = origins_base.shape[0]
    for k in range(n_origins):
        origins[k, 0] = T_a_base[0] + c * origins_base[k, 0] - s * origins_base[k, 1]
        origins[k, 1] = T_a_base[1] + s * origins_base[k, 0] + c * origins_base[k, 1]
    for k in range(points.shape[0]):
        is_beam[k] = is_valid[k] or is_missing[k]
        if is_missing[k]:
            first = origins_base[k if n_origins > 1 else 0]
            x = first[0] + reach * directions_base[k, 0]
            y = first[1] + reach * directions_base[k, 1]
            ends[k, 0] = T_a_base[0] + c * x - s * y
            ends[k, 1] = T_a_base[1] + s * x + c * y
        else:
            ends[k] = points[k]


@kernel
def update_by_scan(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    inv_resolution: float,
    now: int,
    oldest: int,
    T_a_base: FloatArray,
    origins_base: FloatArray,
    directions_base: FloatArray,
    ranges: FloatArray,
    no_return: float,
    min_run: int,
    reach: float,
    points: FloatArray,
    is_valid: BoolArray,
    is_hit: BoolArray,
    l_free: float,
    l_occupied: float,
    l_soft: float,
    fill_gaps: bool,
    max_apart: float,
    l_min: float,
    l_max: float,
) -> None:
    """Update the grid with a scan at a pose (3,): `runs_beyond`, `far_beams` and `update_beams` in one go.

    Runs of at least `min_run` ranges from `no_return` [m] on free cells up to `reach` [m].
    """
    n = points.shape[0]
    is_missing, is_beam, is_soft_hit = np.empty(n, np.bool_), np.empty(n, np.bool_), np.empty(n, np.bool_)
    origins, ends = np.empty(origins_base.shape), np.empty(points.shape)
    runs_beyond(ranges, no_return, min_run, is_missing)
    far_beams(
        T_a_base, origins_base, directions_base, reach, is_missing, points, is_valid, origins, ends, is_beam
    )
    for k in range(n):
        is_soft_hit[k] = is_valid[k] and not is_hit[k]
    update_beams(
        log_odds, stamp, row0, col0, inv_resolution, now, oldest, origins, ends, is_beam, is_hit, is_soft_hit,
        l_free, l_occupied, l_soft, fill_gaps, max_apart, l_min, l_max,
    )  # fmt: skip
