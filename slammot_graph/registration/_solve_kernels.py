"""Kernels that solve a match: normal equations, point to line."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.registration._pair_kernels import partner


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
    lasers: FloatArray,
    T: FloatArray,
    reach2: float,
    kernel_scale2: float,
    point_weight: float,
    h: FloatArray,
    g: FloatArray,
    stats: FloatArray,
) -> None:
    """Normal equations of the point-to-line match at pose T (right perturbation, body frame).

    A line that shows the laser its back makes no pair: it is the wall's other side. `lasers`, (1, 2) or (n, 2), is
    where all points, or each, were seen from, base frame.
    Row of a pair: ``n' R [I | (-py, px)']``, weighted by Geman-McClure ``(s^2 / (s^2 + r^2))^2``; where the map's
    point has no normal, both axes of the offset count, `point_weight` times as much. `stats` gets
    the number of points used, of pairs, the sum of weights, the weighted sum of squared residuals.
    """
    c = math.cos(T[2])
    s = math.sin(T[2])
    is_swept = lasers.shape[0] > 1
    laser_x = T[0] + c * lasers[0, 0] - s * lasers[0, 1]
    laser_y = T[1] + s * lasers[0, 0] + c * lasers[0, 1]
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
        m = partner(x, y, map_points, nearest, inv_cell, first, reach2)
        if m < 0:
            continue
        dx = x - map_points[m, 0]
        dy = y - map_points[m, 1]
        nx = map_normals[m, 0]
        ny = map_normals[m, 1]
        if nx == 0.0 and ny == 0.0:
            # no line: both axes of the offset count, in the body frame
            r2 = dx * dx + dy * dy
            w = kernel_scale2 / (kernel_scale2 + r2)
            w = point_weight * w * w
            n_pairs += 1
            sum_w += w / point_weight
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
        if is_swept:
            laser_x = T[0] + c * lasers[k, 0] - s * lasers[k, 1]
            laser_y = T[1] + s * lasers[k, 0] + c * lasers[k, 1]
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
def match_point_to_line(
    map_points: FloatArray,
    map_normals: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    points: FloatArray,
    is_used: BoolArray,
    lasers: FloatArray,
    T_start: FloatArray,
    T_prior: FloatArray,
    prior_information: FloatArray,
    sigma: float,
    reach: float,
    kernel_scale: float,
    point_weight: float,
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
            lasers,
            T,
            reach2,
            scale2,
            point_weight,
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
        lasers,
        T,
        reach2,
        scale2,
        point_weight,
        h,
        g,
        stats,
    )
    return iterations
