"""Kernel of what the residuals of a match share: the scatter of its normal equations' right-hand side."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.registration._pair_kernels import partner


@kernel
def residual_scatter(
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
    max_gap: float,
    owner: "np.ndarray",
    keyframes: FloatArray,
    roots: FloatArray,
    white: FloatArray,
    common: FloatArray,
    inherited: FloatArray,
    by_keyframe: FloatArray,
) -> None:
    """Scatter of the normal equations' right-hand side for unit noise, pairs and weights as in `accumulate`.

    `white` (3, 3) gets the sum of ``w^2 J' J``: each residual with an error of its own. `common` gets the sum over
    lines of ``(sum w J)' (sum w J)``: all residuals on one line with the same error. Neighbouring pairs are on one
    line if their normals differ by less than 0.3 rad and the later one's map point is within `max_gap` [m] of the
    line through the earlier one's. `inherited` is what the keyframes' own errors bring in: keyframe number
    ``owner[map point]`` lies at ``keyframes`` (k, 3) with an error of covariance ``root root'``, `roots` (k, 3, 3) in
    its body frame; the errors of different keyframes are taken as fully correlated, in the local frame's axes.
    `by_keyframe` (k, 3, 3) gets the sum of ``w J' J`` over the points of each.
    """
    c = math.cos(T[2])
    s = math.sin(T[2])
    is_swept = lasers.shape[0] > 1
    laser_x = T[0] + c * lasers[0, 0] - s * lasers[0, 1]
    laser_y = T[1] + s * lasers[0, 0] + c * lasers[0, 1]
    by_keyframe[:] = 0.0
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
        m = partner(x, y, map_points, nearest, inv_cell, first, reach2)
        if m < 0:
            continue
        dx = x - map_points[m, 0]
        dy = y - map_points[m, 1]
        nx = map_normals[m, 0]
        ny = map_normals[m, 1]
        if nx == 0.0 and ny == 0.0:
            w = kernel_scale2 / (kernel_scale2 + dx * dx + dy * dy)
            w2 = (point_weight * w * w) ** 2
            white[0, 0] += w2
            white[0, 2] -= w2 * py
            white[1, 1] += w2
            white[1, 2] += w2 * px
            white[2, 2] += w2 * (px * px + py * py)
            w = point_weight * w * w
            own = by_keyframe[owner[m]]
            own[0, 0] += w
            own[0, 2] -= w * py
            own[1, 1] += w
            own[1, 2] += w * px
            own[2, 2] += w * (px * px + py * py)
            continue
        if is_swept:
            laser_x = T[0] + c * lasers[k, 0] - s * lasers[k, 1]
            laser_y = T[1] + s * lasers[k, 0] + c * lasers[k, 1]
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
