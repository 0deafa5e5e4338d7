"""Kernels of scan matching: normals, the local map's nearest-point field, point-to-line and point-to-point ICP."""

import math

import numpy as np

from slammot_graph._numba import kernel
from slammot_graph.linalg import BARELY, eigh3, invert3, invert_lower, sandwich3
from slammot_graph.types import BoolArray, FloatArray, IntArray

LINE_FIRST_M2 = 0.04
"""A point without a normal takes a cell from one with a normal only if it is so much nearer [m^2]."""

POINT_WEIGHT = 0.2
"""Weight of a point without a normal (foliage, a table leg) against one on a line."""


@kernel
def estimate_normals(
    points: FloatArray,
    is_member: BoolArray,
    laser: FloatArray,
    half_window: int,
    max_gap: float,
    max_gap_slope: float,
    max_thickness: float,
    out: FloatArray,
) -> None:
    """Fill `out` (n, 2) with unit normals from neighbouring beams, towards the laser; (0, 0) on no line.

    The neighbours of a beam are up to `half_window` member beams on either side, as long as each is within
    `max_gap` [m] + `max_gap_slope` times the range of the one before; the points must lie within `max_thickness`
    [m] of their line.
    """
    n = points.shape[0]
    for k in range(n):
        out[k, 0] = 0.0
        out[k, 1] = 0.0
        if not is_member[k]:
            continue
        gap = max_gap + max_gap_slope * math.sqrt(points[k, 0] ** 2 + points[k, 1] ** 2)
        gap2 = gap * gap
        sx = points[k, 0]
        sy = points[k, 1]
        lo = k
        while lo > 0 and k - lo < half_window and is_member[lo - 1]:
            dx = points[lo - 1, 0] - points[lo, 0]
            dy = points[lo - 1, 1] - points[lo, 1]
            if dx * dx + dy * dy > gap2:
                break
            lo -= 1
            sx += points[lo, 0]
            sy += points[lo, 1]
        hi = k
        while hi < n - 1 and hi - k < half_window and is_member[hi + 1]:
            dx = points[hi + 1, 0] - points[hi, 0]
            dy = points[hi + 1, 1] - points[hi, 1]
            if dx * dx + dy * dy > gap2:
                break
            hi += 1
            sx += points[hi, 0]
            sy += points[hi, 1]
        count = hi - lo + 1
        if count < 3:
            _grazed_normal(points, is_member, k, max_thickness, out)
            _turn_to(laser, points, k, out)
            continue
        mx = sx / count
        my = sy / count
        xx = 0.0
        xy = 0.0
        yy = 0.0
        for m in range(lo, hi + 1):
            dx = points[m, 0] - mx
            dy = points[m, 1] - my
            xx += dx * dx
            xy += dx * dy
            yy += dy * dy
        half_trace = 0.5 * (xx + yy)
        root = math.sqrt(max(0.25 * (xx - yy) * (xx - yy) + xy * xy, 0.0))
        smallest = half_trace - root
        if smallest / count > max_thickness * max_thickness or root < 1e-9:
            continue
        # direction of the line: eigenvector of the larger eigenvalue
        angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
        out[k, 0] = -math.sin(angle)
        out[k, 1] = math.cos(angle)
        _turn_to(laser, points, k, out)


@kernel
def _turn_to(laser: FloatArray, points: FloatArray, k: int, out: FloatArray) -> None:
    """Let normal `k` look towards the laser."""
    if out[k, 0] * (laser[0] - points[k, 0]) + out[k, 1] * (laser[1] - points[k, 1]) < 0.0:
        out[k, 0] = -out[k, 0]
        out[k, 1] = -out[k, 1]


@kernel
def _grazed_normal(
    points: FloatArray, is_member: BoolArray, k: int, max_thickness: float, out: FloatArray
) -> None:
    """Give point `k` the normal of the line through the points before and after it, if it lies on that line.

    Beams that graze a wall hit it far apart; such points must not pass for landmarks, since they move along the
    wall with the robot.
    """
    if k == 0 or k == points.shape[0] - 1 or not (is_member[k - 1] and is_member[k + 1]):
        return
    ax = points[k, 0] - points[k - 1, 0]
    ay = points[k, 1] - points[k - 1, 1]
    bx = points[k + 1, 0] - points[k, 0]
    by = points[k + 1, 1] - points[k, 1]
    a = math.sqrt(ax * ax + ay * ay)
    b = math.sqrt(bx * bx + by * by)
    if ax * bx + ay * by <= 0.0 or max(a, b) > 4.0 * min(a, b):
        return
    dx = points[k + 1, 0] - points[k - 1, 0]
    dy = points[k + 1, 1] - points[k - 1, 1]
    length = math.sqrt(dx * dx + dy * dy)
    if abs(ax * dy - ay * dx) / length > 2.0 * max_thickness:
        return
    out[k, 0] = -dy / length
    out[k, 1] = dx / length


@kernel
def insert_points(
    map_points: FloatArray,
    map_normals: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    n_points: int,
    new_points: FloatArray,
    new_normals: FloatArray,
    is_new: BoolArray,
    min_spacing: float,
    reach_cells: int,
) -> int:
    """Add points to the nearest-point field; returns the new number of points.

    `nearest` (side, side), side a power of two, wraps around: cell (i & mask, j & mask) holds the number of the map
    point nearest to the cell's centre, among points numbered `first` and up. A point nearer than `min_spacing` to
    the one already there is left out, unless the two lie on different lines. Numbers are stored modulo the capacity,
    a power of two.
    """
    mask = nearest.shape[0] - 1
    capacity = map_points.shape[0]
    wrap = capacity - 1
    cell = 1.0 / inv_cell
    for k in range(new_points.shape[0]):
        if not is_new[k]:
            continue
        if n_points - first >= capacity:
            break
        x = new_points[k, 0]
        y = new_points[k, 1]
        ic = math.floor(y * inv_cell)
        jc = math.floor(x * inv_cell)
        old = nearest[ic & mask, jc & mask]
        if old >= first:
            dx = map_points[old & wrap, 0] - x
            dy = map_points[old & wrap, 1] - y
            ox = map_normals[old & wrap, 0]
            oy = map_normals[old & wrap, 1]
            alike = ox * new_normals[k, 0] + oy * new_normals[k, 1] > 0.7
            has_no_line = new_normals[k, 0] == 0.0 and new_normals[k, 1] == 0.0
            if dx * dx + dy * dy < min_spacing * min_spacing and (alike or has_no_line):
                continue
        slot = n_points & wrap
        map_points[slot, 0] = x
        map_points[slot, 1] = y
        map_normals[slot, 0] = new_normals[k, 0]
        map_normals[slot, 1] = new_normals[k, 1]
        handicap = LINE_FIRST_M2 if new_normals[k, 0] == 0.0 and new_normals[k, 1] == 0.0 else 0.0
        for i in range(ic - reach_cells, ic + reach_cells + 1):
            cy = (i + 0.5) * cell
            for j in range(jc - reach_cells, jc + reach_cells + 1):
                cx = (j + 0.5) * cell
                other = nearest[i & mask, j & mask]
                if other >= first:
                    ox = map_points[other & wrap, 0] - cx
                    oy = map_points[other & wrap, 1] - cy
                    other2 = ox * ox + oy * oy
                    if map_normals[other & wrap, 0] == 0.0 and map_normals[other & wrap, 1] == 0.0:
                        other2 += LINE_FIRST_M2
                    if other2 <= (x - cx) * (x - cx) + (y - cy) * (y - cy) + handicap:
                        continue
                nearest[i & mask, j & mask] = n_points
        n_points += 1
    return n_points


@kernel
def solve3(h: FloatArray, g: FloatArray, out: FloatArray) -> bool:
    """Solve the symmetric positive definite 3x3 system h out = g by Cholesky; False where it is not definite."""
    if not h[0, 0] > 0.0:
        return False
    l00 = math.sqrt(h[0, 0])
    l10 = h[1, 0] / l00
    l20 = h[2, 0] / l00
    d1 = h[1, 1] - l10 * l10
    if not d1 > 1e-12 * h[1, 1]:
        return False
    l11 = math.sqrt(d1)
    l21 = (h[2, 1] - l20 * l10) / l11
    d2 = h[2, 2] - l20 * l20 - l21 * l21
    if not d2 > 1e-12 * h[2, 2]:
        return False
    l22 = math.sqrt(d2)
    y0 = g[0] / l00
    y1 = (g[1] - l10 * y0) / l11
    y2 = (g[2] - l20 * y0 - l21 * y1) / l22
    out[2] = y2 / l22
    out[1] = (y1 - l21 * out[2]) / l11
    out[0] = (y0 - l10 * out[1] - l20 * out[2]) / l00
    return True


@kernel
def accumulate(
    map_points: FloatArray,
    map_normals: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    points: FloatArray,
    is_used: BoolArray,
    laser: FloatArray,
    T: FloatArray,
    reach2: float,
    kernel_scale2: float,
    h: FloatArray,
    g: FloatArray,
    stats: FloatArray,
) -> None:
    """Normal equations of the point-to-line match at pose T (right perturbation, body frame).

    A line that shows `laser` (2,), given in the base frame, its back makes no pair: it is the wall's other side.
    Row of a pair: ``n' R [I | (-py, px)']``, weighted by Geman-McClure ``(s^2 / (s^2 + r^2))^2``; where the map's
    point has no normal, both axes of the offset count, with less weight. `stats` gets
    the number of points used, of pairs, the sum of weights, the weighted sum of squared residuals.
    """
    mask = nearest.shape[0] - 1
    wrap = map_points.shape[0] - 1
    c = math.cos(T[2])
    s = math.sin(T[2])
    laser_x = T[0] + c * laser[0] - s * laser[1]
    laser_y = T[1] + s * laser[0] + c * laser[1]
    h00 = h01 = h02 = h11 = h12 = h22 = 0.0
    g0 = g1 = g2 = 0.0
    n_used = n_pairs = 0
    sum_w = sum_wr2 = 0.0
    for k in range(points.shape[0]):
        if not is_used[k]:
            continue
        n_used += 1
        px = points[k, 0]
        py = points[k, 1]
        x = T[0] + c * px - s * py
        y = T[1] + s * px + c * py
        number = nearest[math.floor(y * inv_cell) & mask, math.floor(x * inv_cell) & mask]
        if number < first:
            continue
        m = number & wrap
        dx = x - map_points[m, 0]
        dy = y - map_points[m, 1]
        if dx * dx + dy * dy > reach2:
            continue
        nx = map_normals[m, 0]
        ny = map_normals[m, 1]
        if nx == 0.0 and ny == 0.0:
            # no line: both axes of the offset count, in the body frame
            r2 = dx * dx + dy * dy
            w = kernel_scale2 / (kernel_scale2 + r2)
            w = POINT_WEIGHT * w * w
            n_pairs += 1
            sum_w += w / POINT_WEIGHT
            sum_wr2 += w * r2
            ex = c * dx + s * dy
            ey = -s * dx + c * dy
            h00 += w
            h02 -= w * py
            h11 += w
            h12 += w * px
            h22 += w * (px * px + py * py)
            g0 += w * ex
            g1 += w * ey
            g2 += w * (px * ey - py * ex)
            continue
        if nx * (laser_x - map_points[m, 0]) + ny * (laser_y - map_points[m, 1]) < 0.0:
            continue
        r = nx * dx + ny * dy
        w = kernel_scale2 / (kernel_scale2 + r * r)
        w = w * w
        n_pairs += 1
        sum_w += w
        sum_wr2 += w * r * r
        bx = nx * c + ny * s
        by = -nx * s + ny * c
        bt = px * by - py * bx
        h00 += w * bx * bx
        h01 += w * bx * by
        h02 += w * bx * bt
        h11 += w * by * by
        h12 += w * by * bt
        h22 += w * bt * bt
        g0 += w * bx * r
        g1 += w * by * r
        g2 += w * bt * r
    h[0, 0] = h00
    h[0, 1] = h[1, 0] = h01
    h[0, 2] = h[2, 0] = h02
    h[1, 1] = h11
    h[1, 2] = h[2, 1] = h12
    h[2, 2] = h22
    g[0] = g0
    g[1] = g1
    g[2] = g2
    stats[0] = n_used
    stats[1] = n_pairs
    stats[2] = sum_w
    stats[3] = sum_wr2


@kernel
def residual_scatter(
    map_points: FloatArray,
    map_normals: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    points: FloatArray,
    is_used: BoolArray,
    laser: FloatArray,
    T: FloatArray,
    reach2: float,
    kernel_scale2: float,
    max_gap: float,
    owner: "np.ndarray",
    keyframes: FloatArray,
    roots: FloatArray,
    white: FloatArray,
    common: FloatArray,
    inherited: FloatArray,
) -> None:
    """Scatter of the normal equations' right-hand side for unit noise, pairs and weights as in `accumulate`.

    `white` (3, 3) gets the sum of ``w^2 J' J``: each residual with an error of its own. `common` gets the sum over
    lines of ``(sum w J)' (sum w J)``: all residuals on one line with the same error. Neighbouring pairs are on one
    line if their normals differ by less than 0.3 rad and the later one's map point is within `max_gap` [m] of the
    line through the earlier one's. `inherited` is what the keyframes' own errors bring in: keyframe number
    ``owner[map point]`` lies at ``keyframes`` (k, 3) with an error of covariance ``root root'``, `roots` (k, 3, 3) in
    its body frame; the errors of different keyframes are taken as fully correlated, in the local frame's axes.
    """
    mask = nearest.shape[0] - 1
    wrap = map_points.shape[0] - 1
    by_keyframe = np.zeros((keyframes.shape[0], 3, 3))
    c = math.cos(T[2])
    s = math.sin(T[2])
    laser_x = T[0] + c * laser[0] - s * laser[1]
    laser_y = T[1] + s * laser[0] + c * laser[1]
    white[:] = 0.0
    common[:] = 0.0
    row = np.zeros(3)
    line = np.zeros(3)
    last = -1
    for k in range(points.shape[0]):
        if not is_used[k]:
            continue
        px = points[k, 0]
        py = points[k, 1]
        x = T[0] + c * px - s * py
        y = T[1] + s * px + c * py
        number = nearest[math.floor(y * inv_cell) & mask, math.floor(x * inv_cell) & mask]
        if number < first:
            continue
        m = number & wrap
        dx = x - map_points[m, 0]
        dy = y - map_points[m, 1]
        if dx * dx + dy * dy > reach2:
            continue
        nx = map_normals[m, 0]
        ny = map_normals[m, 1]
        if nx == 0.0 and ny == 0.0:
            w = kernel_scale2 / (kernel_scale2 + dx * dx + dy * dy)
            w2 = (POINT_WEIGHT * w * w) ** 2
            white[0, 0] += w2
            white[0, 2] -= w2 * py
            white[1, 1] += w2
            white[1, 2] += w2 * px
            white[2, 2] += w2 * (px * px + py * py)
            w = POINT_WEIGHT * w * w
            own = by_keyframe[owner[m]]
            own[0, 0] += w
            own[0, 2] -= w * py
            own[1, 1] += w
            own[1, 2] += w * px
            own[2, 2] += w * (px * px + py * py)
            continue
        if nx * (laser_x - map_points[m, 0]) + ny * (laser_y - map_points[m, 1]) < 0.0:
            continue
        r = nx * dx + ny * dy
        w = kernel_scale2 / (kernel_scale2 + r * r)
        w = w * w
        row[0] = w * (nx * c + ny * s)
        row[1] = w * (-nx * s + ny * c)
        row[2] = px * row[1] - py * row[0]
        is_same = False
        if last >= 0:
            ox = map_normals[last, 0]
            oy = map_normals[last, 1]
            off = ox * (map_points[m, 0] - map_points[last, 0]) + oy * (
                map_points[m, 1] - map_points[last, 1]
            )
            is_same = ox * nx + oy * ny > 0.95 and abs(off) < max_gap
        for i in range(3):
            for j in range(i, 3):
                white[i, j] += row[i] * row[j]
                by_keyframe[owner[m], i, j] += row[i] * row[j] / w
                if not is_same:
                    common[i, j] += line[i] * line[j]
            if not is_same:
                line[i] = 0.0
        for i in range(3):
            line[i] += row[i]
        last = m
    for i in range(3):
        for j in range(i, 3):
            common[i, j] += line[i] * line[j]
            common[j, i] = common[i, j]
            white[j, i] = white[i, j]
    root = np.zeros((3, 3))
    adjoint = np.zeros((3, 3))
    adjoint[2, 2] = 1.0
    for k in range(keyframes.shape[0]):
        for i in range(3):
            for j in range(i):
                by_keyframe[k, i, j] = by_keyframe[k, j, i]
        dx = keyframes[k, 0] - T[0]
        dy = keyframes[k, 1] - T[1]
        turn = keyframes[k, 2] - T[2]
        adjoint[0, 0] = adjoint[1, 1] = math.cos(turn)
        adjoint[1, 0] = math.sin(turn)
        adjoint[0, 1] = -adjoint[1, 0]
        adjoint[0, 2] = -s * dx + c * dy
        adjoint[1, 2] = -c * dx - s * dy
        # the same error for all keyframes means the same in the local frame's axes, however each was turned
        c_k = math.cos(keyframes[k, 2])
        s_k = math.sin(keyframes[k, 2])
        for i in range(3):
            r0 = r1 = r2 = 0.0
            for j in range(3):
                moved = 0.0
                for m in range(3):
                    moved += by_keyframe[k, i, m] * adjoint[m, j]
                r0 += moved * roots[k, j, 0]
                r1 += moved * roots[k, j, 1]
                r2 += moved * roots[k, j, 2]
            root[i, 0] += c_k * r0 - s_k * r1
            root[i, 1] += s_k * r0 + c_k * r1
            root[i, 2] += r2
    for i in range(3):
        for j in range(3):
            inherited[i, j] = root[i, 0] * root[j, 0] + root[i, 1] * root[j, 1] + root[i, 2] * root[j, 2]


@kernel
def match_point_to_line(
    map_points: FloatArray,
    map_normals: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    points: FloatArray,
    is_used: BoolArray,
    laser: FloatArray,
    T_start: FloatArray,
    T_prior: FloatArray,
    prior_information: FloatArray,
    sigma: float,
    reach: float,
    kernel_scale: float,
    max_iterations: int,
    min_step_m: float,
    min_step_rad: float,
    T: FloatArray,
    h: FloatArray,
    g: FloatArray,
    stats: FloatArray,
) -> int:
    """Iterate to the pose `T` that minimises the robust match and the pull of the prior; returns the iterations.

    The prior stands at `T_prior` with `prior_information` (body frame); a residual has the standard deviation
    `sigma` [m]. Fills `T`, and `h`, `g`, `stats` of the match alone at `T`, as `accumulate` does.
    """
    T[:] = T_start
    a = np.empty((3, 3))
    b = np.empty(3)
    step = np.zeros(3)
    delta = np.zeros(3)
    inv_var = 1.0 / (sigma * sigma)
    reach2 = reach * reach
    scale2 = kernel_scale * kernel_scale
    iterations = 0
    for _ in range(max_iterations):
        accumulate(
            map_points,
            map_normals,
            nearest,
            inv_cell,
            first,
            points,
            is_used,
            laser,
            T,
            reach2,
            scale2,
            h,
            g,
            stats,
        )
        iterations += 1
        # offset from the prior, in the body frame of T
        c = math.cos(T[2])
        s = math.sin(T[2])
        ex = T[0] - T_prior[0]
        ey = T[1] - T_prior[1]
        delta[0] = c * ex + s * ey
        delta[1] = -s * ex + c * ey
        et = T[2] - T_prior[2]
        delta[2] = (et + math.pi) % (2.0 * math.pi) - math.pi
        for i in range(3):
            b[i] = -inv_var * g[i]
            for j in range(3):
                a[i, j] = inv_var * h[i, j] + prior_information[i, j]
                b[i] -= prior_information[i, j] * delta[j]
        if not solve3(a, b, step):
            break
        # retract: T * (step) with the small-angle translation
        T[0] += c * step[0] - s * step[1]
        T[1] += s * step[0] + c * step[1]
        T[2] = (T[2] + step[2] + math.pi) % (2.0 * math.pi) - math.pi
        if abs(step[0]) + abs(step[1]) < min_step_m and abs(step[2]) < min_step_rad:
            break
    accumulate(
        map_points,
        map_normals,
        nearest,
        inv_cell,
        first,
        points,
        is_used,
        laser,
        T,
        reach2,
        scale2,
        h,
        g,
        stats,
    )
    return iterations


@kernel
def match_point_to_point(
    reference: FloatArray,
    is_reference: BoolArray,
    points: FloatArray,
    is_used: BoolArray,
    T_start: FloatArray,
    max_distance: float,
    tau: float,
    max_iterations: int,
    T: FloatArray,
    partner: IntArray,
    stats: FloatArray,
) -> int:
    """Classical ICP (eq. 3 to 5): nearest points, closed-form pose, until d_k - d_(k+1) < tau; returns the iterations.

    `d` is the mean distance of the pairs [m]; pairs beyond `max_distance` are left out. Fills `T`, `partner` (index
    into reference, -1 for none) and `stats`: points used, pairs, final d, d of the start.
    """
    T[:] = T_start
    n = points.shape[0]
    d_before = np.inf
    iterations = 0
    stats[3] = np.nan
    for iteration in range(max_iterations):
        c = math.cos(T[2])
        s = math.sin(T[2])
        n_used = n_pairs = 0
        total = 0.0
        mx = my = qx = qy = 0.0
        for k in range(n):
            partner[k] = -1
            if not is_used[k]:
                continue
            n_used += 1
            x = T[0] + c * points[k, 0] - s * points[k, 1]
            y = T[1] + s * points[k, 0] + c * points[k, 1]
            best = max_distance * max_distance
            for m in range(reference.shape[0]):
                if is_reference[m]:
                    dx = reference[m, 0] - x
                    dy = reference[m, 1] - y
                    d2 = dx * dx + dy * dy
                    if d2 < best:
                        best = d2
                        partner[k] = m
            if partner[k] >= 0:
                n_pairs += 1
                total += math.sqrt(best)
                mx += points[k, 0]
                my += points[k, 1]
                qx += reference[partner[k], 0]
                qy += reference[partner[k], 1]
        iterations = iteration + 1
        stats[0] = n_used
        stats[1] = n_pairs
        if n_pairs < 3:
            stats[2] = np.nan
            break
        d = total / n_pairs
        stats[2] = d
        if iteration == 0:
            stats[3] = d
        if d_before - d < tau:
            break
        d_before = d
        mx /= n_pairs
        my /= n_pairs
        qx /= n_pairs
        qy /= n_pairs
        sin_sum = cos_sum = 0.0
        for k in range(n):
            if partner[k] < 0:
                continue
            ax = points[k, 0] - mx
            ay = points[k, 1] - my
            bx = reference[partner[k], 0] - qx
            by = reference[partner[k], 1] - qy
            sin_sum += ax * by - ay * bx
            cos_sum += ax * bx + ay * by
        theta = math.atan2(sin_sum, cos_sum)
        c = math.cos(theta)
        s = math.sin(theta)
        T[0] = qx - c * mx + s * my
        T[1] = qy - s * mx - c * my
        T[2] = theta
    return iterations


@kernel
def judge_match(
    points: FloatArray,
    is_used: BoolArray,
    T_prior: FloatArray,
    T: FloatArray,
    h: FloatArray,
    g: FloatArray,
    white: FloatArray,
    common: FloatArray,
    inherited: FloatArray,
    n_pairs: float,
    residual_std: float,
    floor_std: float,
    noise_std: float,
    line_std: float,
    common_std_m: float,
    common_std_rad: float,
    outlier_std: float,
    weak_ratio: float,
    fragile_pairs: float,
    T_free: FloatArray,
    information: FloatArray,
    graph_information: FloatArray,
    gain_information: FloatArray,
    cov_own: FloatArray,
    cov_common: FloatArray,
    cov_map: FloatArray,
) -> int:
    """Split a match into strong and weak directions; returns the number of weak ones.

    Directions are eigenvectors of the normal matrix `h`, the rotation scaled by the points' root mean square
    distance. In weak ones `T` goes back to `T_prior`. `T_free` gets the optimum of the match alone in the strong ones.
    There the covariance has three parts: `cov_own` of the beams' own noise, ``noise_std^2 inv(h) white inv(h)``
    (Censi), `cov_common` of what the beams of one line and all beams have in common, and `cov_map` of the map's
    keyframes and of directions that few pairs determine.
    `information` gets the inverse of all but what the keyframes bring, `graph_information` the cautious
    ``1 / (residual_std^2 / eigenvalue + floor_std^2)`` of each direction, `gain_information` the same without floor.
    """
    total = 0.0
    n = 0
    for k in range(points.shape[0]):
        if is_used[k]:
            total += points[k, 0] ** 2 + points[k, 1] ** 2
            n += 1
    lever = math.sqrt(total / max(n, 1))
    scale = np.array([1.0, 1.0, 1.0 / lever])
    values = np.empty(3)
    vectors = np.empty((3, 3))
    scaled = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            scaled[i, j] = h[i, j] * (scale[i] * scale[j])
    eigh3(scaled, values, vectors)
    # the scaled tangent is (x, y, lever * theta)
    c = math.cos(T_prior[2])
    s = math.sin(T_prior[2])
    ex = T[0] - T_prior[0]
    ey = T[1] - T_prior[1]
    moved = np.empty(3)
    moved[0] = c * ex + s * ey
    moved[1] = -s * ex + c * ey
    moved[2] = (T[2] - T_prior[2] + math.pi) % (2.0 * math.pi) - math.pi
    kept = np.zeros(3)
    free = np.zeros(3)
    n_weak = 0
    # columns: the strong directions, scaled, over their eigenvalue
    back = np.zeros((3, 3))
    forth = np.zeros((3, 3))
    for m in range(3):
        if not values[m] > weak_ratio * n_pairs:
            n_weak += 1
            continue
        along = 0.0
        slope = 0.0
        for i in range(3):
            along += vectors[i, m] * moved[i] / scale[i]
            slope += vectors[i, m] * scale[i] * g[i]
        for i in range(3):
            kept[i] += vectors[i, m] * scale[i] * along
            free[i] -= vectors[i, m] * scale[i] * slope / values[m]
            back[i, m] = vectors[i, m] * scale[i]
            forth[i, m] = vectors[i, m] / scale[i]
    own_part = np.zeros((3, 3))
    common_part = np.zeros((3, 3))
    map_part = np.zeros((3, 3))
    for m in range(3):
        for k in range(3):
            if back[0, m] == 0.0 and back[1, m] == 0.0 and back[2, m] == 0.0:
                continue
            if back[0, k] == 0.0 and back[1, k] == 0.0 and back[2, k] == 0.0:
                continue
            a = 0.0
            b = 0.0
            d = 0.0
            for i in range(3):
                for j in range(3):
                    a += back[i, m] * white[i, j] * back[j, k]
                    b += back[i, m] * common[i, j] * back[j, k]
                    d += back[i, m] * inherited[i, j] * back[j, k]
            own_part[m, k] = noise_std**2 * a / (values[m] * values[k])
            common_part[m, k] = line_std**2 * b / (values[m] * values[k])
            map_part[m, k] = d / (values[m] * values[k])
    for m in range(3):
        if not values[m] > weak_ratio * n_pairs:
            continue
        map_part[m, m] += (outlier_std * (fragile_pairs / values[m]) ** 2) ** 2
        for k in range(3):
            if values[k] > weak_ratio * n_pairs:
                for i in range(3):
                    std = common_std_rad * lever if i == 2 else common_std_m
                    common_part[m, k] += std**2 * vectors[i, m] * vectors[i, k]
    sandwich3(back, common_part, cov_common)
    sandwich3(back, map_part, cov_map)
    sandwich3(back, own_part, cov_own)
    whole = own_part + common_part
    for m in range(3):
        if values[m] > weak_ratio * n_pairs:
            whole[m, m] += (outlier_std * (fragile_pairs / values[m]) ** 2) ** 2
    cautious = np.zeros((3, 3))
    gain = np.zeros((3, 3))
    for m in range(3):
        if values[m] > weak_ratio * n_pairs:
            cautious[m, m] = 1.0 / (residual_std**2 / values[m] + floor_std**2)
            gain[m, m] = values[m] / residual_std**2
        else:
            whole[m, m] = 1.0
    if not invert3(whole, scaled):
        scaled[:] = 0.0
    sandwich3(forth, scaled, information)
    sandwich3(forth, cautious, graph_information)
    sandwich3(forth, gain, gain_information)
    if n_weak > 0:
        T[0] = T_prior[0] + c * kept[0] - s * kept[1]
        T[1] = T_prior[1] + s * kept[0] + c * kept[1]
        T[2] = (T_prior[2] + kept[2] + math.pi) % (2.0 * math.pi) - math.pi
    c = math.cos(T[2])
    s = math.sin(T[2])
    T_free[0] = T[0] + c * free[0] - s * free[1]
    T_free[1] = T[1] + s * free[0] + c * free[1]
    T_free[2] = (T[2] + free[2] + math.pi) % (2.0 * math.pi) - math.pi
    return n_weak


@kernel
def innovate(
    T_predicted: FloatArray,
    T_match: FloatArray,
    cov_predicted: FloatArray,
    graph_information: FloatArray,
    information: FloatArray,
    innovation: FloatArray,
    cov: FloatArray,
) -> float:
    """Fill the `innovation` (3,) ``log(inverse(T_predicted) T_match)`` and `cov` (3, 3) of a match's information.

    Returns the innovation's normalised square, for the sum of the prediction's and the match's cautious covariance.
    """
    c = math.cos(T_predicted[2])
    s = math.sin(T_predicted[2])
    dx = T_match[0] - T_predicted[0]
    dy = T_match[1] - T_predicted[1]
    turn = (T_match[2] - T_predicted[2] + math.pi) % (2.0 * math.pi) - math.pi
    half = 0.5 * turn
    a = 1.0 - half * half / 3.0 if abs(turn) < 1e-6 else half / math.tan(half)
    x = c * dx + s * dy
    y = -s * dx + c * dy
    innovation[0] = a * x + half * y
    innovation[1] = -half * x + a * y
    innovation[2] = turn
    barely = np.empty((3, 3))
    whole = np.empty((3, 3))
    inverse = np.empty((3, 3))
    nis = np.nan
    for i in range(3):
        for j in range(3):
            barely[i, j] = graph_information[i, j] + (BARELY if i == j else 0.0)
    if invert3(barely, inverse):
        for i in range(3):
            for j in range(3):
                whole[i, j] = cov_predicted[i, j] + inverse[i, j]
        if invert3(whole, inverse):
            nis = 0.0
            for i in range(3):
                for j in range(3):
                    nis += innovation[i] * inverse[i, j] * innovation[j]
    for i in range(3):
        for j in range(3):
            barely[i, j] = information[i, j] + (BARELY if i == j else 0.0)
    if not invert3(barely, cov):
        cov[:] = np.nan
    return nis


@kernel
def fuse(
    cov_prior: FloatArray,
    cov_predicted: FloatArray,
    gain_information: FloatArray,
    cov_own: FloatArray,
    cov_map: FloatArray,
    out: FloatArray,
) -> None:
    """Covariance `out` (3, 3) of a prediction and a match taken together (Joseph's form).

    The gain is what the match's solver gave the scan against the prior, `cov_own` the noise that the scan had. Nothing
    is known better than the map: `out` is raised to `cov_map` where it is below.
    """
    whole = np.empty((3, 3))
    invert3(cov_prior, whole)
    gain = np.empty((3, 3))
    kept = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            whole[i, j] += gain_information[i, j]
    for j in range(3):
        solve3(whole, gain_information[:, j], gain[j])  # row j of the transpose
    for i in range(3):
        for j in range(i):
            gain[i, j], gain[j, i] = gain[j, i], gain[i, j]
    for i in range(3):
        for j in range(3):
            kept[i, j] = (1.0 if i == j else 0.0) - gain[i, j]
    fused = np.empty((3, 3))
    noise = np.empty((3, 3))
    sandwich3(kept, cov_predicted, fused)
    sandwich3(gain, cov_own, noise)
    for i in range(3):
        for j in range(3):
            fused[i, j] += noise[i, j]
    # its Cholesky factor, and the inverse of that
    root = np.zeros((3, 3))
    back = np.zeros((3, 3))
    for i in range(3):
        for j in range(i + 1):
            rest = 0.5 * (fused[i, j] + fused[j, i])
            for k in range(j):
                rest -= root[i, k] * root[j, k]
            if i == j:
                root[i, i] = math.sqrt(max(rest, 1e-15 * fused[i, i]))
            else:
                root[i, j] = rest / root[j, j]
    invert_lower(root, back)
    values = np.empty(3)
    vectors = np.empty((3, 3))
    sandwich3(back, cov_map, noise)
    eigh3(noise, values, vectors)
    for i in range(3):
        for j in range(3):
            kept[i, j] = root[i, 0] * vectors[0, j] + root[i, 1] * vectors[1, j] + root[i, 2] * vectors[2, j]
    for i in range(3):
        for j in range(3):
            out[i, j] = 0.0
            for k in range(3):
                out[i, j] += kept[i, k] * max(values[k], 1.0) * kept[j, k]
