"""Kernels of the moving-point test: end-point covariances, ellipses on the grid, what is seen through."""

import math

import numpy as np
import numpy.typing as npt

from slammot_graph.core._numba import kernel
from slammot_graph.core.se2 import transform_points
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection.reasons import FREE, NOT_VALID, OCCUPIED, TOO_UNCERTAIN, UNKNOWN

SWEPT_ROUNDS = 2
"""How often the beam towards a point is looked for from where the beam found before starts."""


@kernel
def end_point_covariances(
    ranges: FloatArray,
    directions_base: FloatArray,
    origins_base: FloatArray,
    times: FloatArray,
    cov_velocity: FloatArray,
    theta: float,
    cov_pose: FloatArray,
    range_std: float,
    angle_std: float,
    out: FloatArray,
) -> None:
    """Fill `out` (n, 3) with (xx, xy, yy) of each end point's covariance in the frame of the pose (eq. 9).

    ``H_r R_r H_r' + H_l R_l H_l'`` with the pose perturbed in the body frame: ``H_r = R [I | (-py, px)']`` and
    ``H_l = R [u | r u_perp]``. Beams start from `origins_base`, (1, 2) or (n, 2). Of a sweep `times` (n,) are given
    (else (0,)): the pose of a beam that is t seconds late has ``t^2 cov_velocity`` more.
    """
    step = 1 if origins_base.shape[0] > 1 else 0
    is_swept = times.shape[0] > 0
    p00 = cov_pose[0, 0]
    p01 = cov_pose[0, 1]
    p02 = cov_pose[0, 2]
    p11 = cov_pose[1, 1]
    p12 = cov_pose[1, 2]
    p22 = cov_pose[2, 2]
    c = math.cos(theta)
    s = math.sin(theta)
    for k in range(ranges.shape[0]):
        r = ranges[k]
        ux = directions_base[k, 0]
        uy = directions_base[k, 1]
        px = origins_base[k * step, 0] + r * ux
        py = origins_base[k * step, 1] + r * uy
        if is_swept:
            t2 = times[k] * times[k]
            p00 = cov_pose[0, 0] + t2 * cov_velocity[0, 0]
            p01 = cov_pose[0, 1] + t2 * cov_velocity[0, 1]
            p02 = cov_pose[0, 2] + t2 * cov_velocity[0, 2]
            p11 = cov_pose[1, 1] + t2 * cov_velocity[1, 1]
            p12 = cov_pose[1, 2] + t2 * cov_velocity[1, 2]
            p22 = cov_pose[2, 2] + t2 * cov_velocity[2, 2]
        # H_r R_r H_r' in the base frame, J = [I | (-py, px)']
        xx = p00 - 2.0 * py * p02 + py * py * p22
        xy = p01 + px * p02 - py * p12 - px * py * p22
        yy = p11 + 2.0 * px * p12 + px * px * p22
        # H_l R_l H_l'
        var_r = range_std * range_std
        var_t = r * r * angle_std * angle_std
        xx += var_r * ux * ux + var_t * uy * uy
        xy += (var_r - var_t) * ux * uy
        yy += var_r * uy * uy + var_t * ux * ux
        # into the frame of the pose
        out[k, 0] = c * c * xx - 2.0 * c * s * xy + s * s * yy
        out[k, 1] = c * s * (xx - yy) + (c * c - s * s) * xy
        out[k, 2] = s * s * xx + 2.0 * c * s * xy + c * c * yy


@kernel
def _edge_distance2(ax: float, ay: float, bx: float, by: float, p: float, q: float, r: float) -> float:
    """Least of ``v' [[p, q], [q, r]] v`` over v on the segment from a to b."""
    ex = bx - ax
    ey = by - ay
    ee = p * ex * ex + 2.0 * q * ex * ey + r * ey * ey
    ae = p * ax * ex + q * (ax * ey + ay * ex) + r * ay * ey
    t = min(max(-ae / ee, 0.0), 1.0)
    vx = ax + t * ex
    vy = ay + t * ey
    return p * vx * vx + 2.0 * q * vx * vy + r * vy * vy


@kernel
def _touches(dx: float, dy: float, size: float, p: float, q: float, r: float, limit2: float) -> bool:
    """Tell whether the ellipse ``v' [[p, q], [q, r]] v <= limit2`` at 0 touches the cell with lower corner (dx, dy)."""
    if dx <= 0.0 and dy <= 0.0 and dx + size >= 0.0 and dy + size >= 0.0:
        return True
    x1 = dx + size
    y1 = dy + size
    return (
        _edge_distance2(dx, dy, x1, dy, p, q, r) <= limit2
        or _edge_distance2(dx, y1, x1, y1, p, q, r) <= limit2
        or _edge_distance2(dx, dy, dx, y1, p, q, r) <= limit2
        or _edge_distance2(x1, dy, x1, y1, p, q, r) <= limit2
    )


@kernel
def log_odds_at(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    oldest: int,
    is_fixed: bool,
    i: int,
    j: int,
) -> float:
    """Log-odds of a cell by its row and column; 0 where never seen, expired, or outside of a grid that is fixed."""
    rows, cols = log_odds.shape
    i_s = i - row0
    j_s = j - col0
    if is_fixed and (i_s < 0 or i_s >= rows or j_s < 0 or j_s >= cols):
        return 0.0
    i_s &= rows - 1
    j_s &= cols - 1
    return log_odds[i_s, j_s] if stamp[i_s, j_s] >= oldest else 0.0


@kernel
def ellipse_test(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    resolution: float,
    oldest: int,
    is_fixed: bool,
    l_free: float,
    l_occupied: float,
    points: FloatArray,
    cov: FloatArray,
    is_valid: BoolArray,
    n_sigma: float,
    max_cells: int,
    margin_cells: int,
    out: IntArray,
) -> None:
    """Fill `out` with what the cells under each end point's ellipse say: FREE only if every one of them is free.

    `cov` is (n, 3): xx, xy, yy. The first cell that is not free decides; an ellipse that spans more than
    `max_cells` cells is TOO_UNCERTAIN. With a margin, the cells around the end point's own count too.
    """
    inv_resolution = 1.0 / resolution
    for k in range(points.shape[0]):
        if not is_valid[k]:
            out[k] = NOT_VALID
            continue
        x = points[k, 0]
        y = points[k, 1]
        half_x = n_sigma * math.sqrt(cov[k, 0])
        half_y = n_sigma * math.sqrt(cov[k, 2])
        i_c = math.floor(y * inv_resolution)
        j_c = math.floor(x * inv_resolution)
        i_lo = min(math.floor((y - half_y) * inv_resolution), i_c - margin_cells)
        i_hi = max(math.floor((y + half_y) * inv_resolution), i_c + margin_cells)
        j_lo = min(math.floor((x - half_x) * inv_resolution), j_c - margin_cells)
        j_hi = max(math.floor((x + half_x) * inv_resolution), j_c + margin_cells)
        det = cov[k, 0] * cov[k, 2] - cov[k, 1] * cov[k, 1]
        p = cov[k, 2] / det
        q = -cov[k, 1] / det
        r = cov[k, 0] / det
        verdict = FREE
        # the cell of the end point itself first: it decides nearly always
        for m in range(-1, (i_hi - i_lo + 1) * (j_hi - j_lo + 1)):
            if m < 0:
                i = i_c
                j = j_c
            else:
                i = i_lo + m // (j_hi - j_lo + 1)
                j = j_lo + m % (j_hi - j_lo + 1)
            value = log_odds_at(log_odds, stamp, row0, col0, oldest, is_fixed, i, j)
            if value < l_free:
                if m < 0 and (i_hi - i_lo + 1) * (j_hi - j_lo + 1) > max_cells:
                    verdict = TOO_UNCERTAIN
                    break
                continue
            if max(abs(i - i_c), abs(j - j_c)) > margin_cells and not _touches(
                j * resolution - x, i * resolution - y, resolution, p, q, r, n_sigma * n_sigma
            ):
                continue
            verdict = OCCUPIED if value > l_occupied else UNKNOWN
            break
        out[k] = verdict


@kernel
def test_beams(
    log_odds: "np.ndarray",
    stamp: "np.ndarray",
    row0: int,
    col0: int,
    resolution: float,
    oldest: int,
    is_fixed: bool,
    l_free: float,
    l_occupied: float,
    points_base: FloatArray,
    ranges: FloatArray,
    directions_base: FloatArray,
    origins_base: FloatArray,
    times: FloatArray,
    cov_velocity: FloatArray,
    is_valid: BoolArray,
    T: FloatArray,
    cov_pose: FloatArray,
    range_std: float,
    angle_std: float,
    n_sigma: float,
    max_cells: int,
    margin_cells: int,
    points: FloatArray,
    cov: FloatArray,
    reason: IntArray,
) -> None:
    """Put a scan at the pose `T` and test it: fills its `points` (n, 2), their `cov` (n, 3) and `reason` (n,)."""
    transform_points(T, points_base, points)
    end_point_covariances(
        ranges, directions_base, origins_base, times, cov_velocity, T[2], cov_pose, range_std, angle_std, cov
    )
    ellipse_test(
        log_odds,
        stamp,
        row0,
        col0,
        resolution,
        oldest,
        is_fixed,
        l_free,
        l_occupied,
        points,
        cov,
        is_valid,
        n_sigma,
        max_cells,
        margin_cells,
        reason,
    )


@kernel
def _beam_towards(
    x: float, y: float, directions: FloatArray, angle_first: float, angle_increment: float, guess: int
) -> int:
    """Number of the beam nearest to the direction (x, y), perhaps outside the scan; quick if `guess` is near it."""
    if 0 <= guess < directions.shape[0]:
        along = directions[guess, 0] * x + directions[guess, 1] * y
        aside = directions[guess, 0] * y - directions[guess, 1] * x
        if abs(aside) < 0.1 * along:
            t = aside / along
            turned = t * (1.0 - t * t * (1.0 / 3.0 - 0.2 * t * t))  # its arc tangent, to 1e-8 rad
            number = guess + math.floor(turned / angle_increment + 0.5)
            if 0 <= number < directions.shape[0]:
                return int(number)
    turn = math.copysign(2.0 * math.pi, angle_increment)
    angle = math.atan2(y, x) - angle_first
    angle -= turn * math.floor(angle / turn)
    number = math.floor(angle / angle_increment + 0.5)
    return int(number)


@kernel
def seen_through(
    points: FloatArray,
    is_used: BoolArray,
    T_base: FloatArray,
    origins_base: FloatArray,
    directions_base: FloatArray,
    angle_first: float,
    angle_increment: float,
    ranges: FloatArray,
    is_valid: BoolArray,
    margin: float,
    min_run: int,
    out: FloatArray,
) -> int:
    """Gather in `out` the used points, in beam order, that the beams of a later scan pass by at least `margin` [m].

    The beam towards a point and both its neighbours must be valid and reach beyond it; runs of fewer than `min_run`
    such points, with no other used one in between, do not count. `T_base` is in the frame of the points, beam 0 of the
    later scan has the direction `angle_first` in the base frame. Its beams start from `origins_base`, (1, 2) or
    (n, 2). Returns their number.
    """
    c = math.cos(T_base[2])
    s = math.sin(T_base[2])
    is_swept = origins_base.shape[0] > 1
    laser_x = T_base[0] + c * origins_base[0, 0] - s * origins_base[0, 1]
    laser_y = T_base[1] + s * origins_base[0, 0] + c * origins_base[0, 1]
    n_gone = 0
    run = 0
    m = -1
    last = 0
    for k in range(points.shape[0]):
        if not is_used[k]:
            continue
        dx = points[k, 0] - laser_x
        dy = points[k, 1] - laser_y
        m = _beam_towards(
            c * dx + s * dy, -s * dx + c * dy, directions_base, angle_first, angle_increment, m + k - last
        )
        if is_swept:
            # the beam found tells from where, and how turned, the laser looked this way
            for _ in range(SWEPT_ROUNDS):
                if not 0 <= m < ranges.shape[0]:
                    break
                laser_x = T_base[0] + c * origins_base[m, 0] - s * origins_base[m, 1]
                laser_y = T_base[1] + s * origins_base[m, 0] + c * origins_base[m, 1]
                dx = points[k, 0] - laser_x
                dy = points[k, 1] - laser_y
                m = _beam_towards(
                    c * dx + s * dy, -s * dx + c * dy, directions_base, angle_first, angle_increment, m
                )
        last = k
        passes = m >= 1 and m < ranges.shape[0] - 1
        if passes:
            past = math.sqrt(dx * dx + dy * dy) + margin
            for i in range(m - 1, m + 2):
                passes = passes and is_valid[i] and ranges[i] > past
        if not passes:
            if run < min_run:
                n_gone -= run
            run = 0
            continue
        out[n_gone, 0] = points[k, 0]
        out[n_gone, 1] = points[k, 1]
        n_gone += 1
        run += 1
    return n_gone - run if run < min_run else n_gone


@kernel
def unpack_masks(masks: "npt.NDArray[np.uint8]", out: BoolArray) -> None:
    """Fill `out` (m, n) with the lowest m bits of masks (n,), as `pack_masks` makes them."""
    for k in range(masks.shape[0]):
        for i in range(out.shape[0]):
            out[i, k] = masks[k] & (1 << i) != 0


@kernel
def pack_masks(
    is_valid: BoolArray,
    is_moving: BoolArray,
    reason: IntArray,
    marks: BoolArray,
    out: "npt.NDArray[np.uint8]",
) -> None:
    """Fill `out` (n,) with bits: 1 valid, 2 moving, 4 on an occupied cell, 8, 16 and 32 as of `marks` (3, n)."""
    for k in range(is_valid.shape[0]):
        bits = 1 if is_valid[k] else 0
        bits += 2 if is_moving[k] else 0
        bits += 4 if reason[k] == OCCUPIED else 0
        bits += 8 if marks[0, k] else 0
        bits += 16 if marks[1, k] else 0
        bits += 32 if marks[2, k] else 0
        out[k] = bits
