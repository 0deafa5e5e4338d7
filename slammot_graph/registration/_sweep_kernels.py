"""Kernel of a match in which the velocity during the sweep is open too."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.registration._pair_kernels import partner


@kernel
def accumulate_sweep(
    map_points: FloatArray,
    map_normals: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    points: FloatArray,
    is_used: BoolArray,
    lasers: FloatArray,
    times: FloatArray,
    T: FloatArray,
    reach2: float,
    kernel_scale2: float,
    point_weight: float,
    h: FloatArray,
    g: FloatArray,
) -> float:
    """Normal equations (6, 6) and (6,) in pose and velocity, pairs and weights as in `_solve_kernels.accumulate`.

    A point seen t seconds after the stamp moves with ``exp(pose + t velocity)`` (right perturbation, body frame): the
    row of a pair is ``[J, t J]``. Returns the sum of the weights.
    """
    c = math.cos(T[2])
    s = math.sin(T[2])
    step = 1 if lasers.shape[0] > 1 else 0
    h[:] = 0.0
    g[:] = 0.0
    row = np.zeros((2, 6))
    r = np.zeros(2)
    sum_w = 0.0
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
        n_rows = 1
        if nx == 0.0 and ny == 0.0:
            n_rows = 2
            w = kernel_scale2 / (kernel_scale2 + dx * dx + dy * dy)
            w = point_weight * w * w
            r[0] = c * dx + s * dy
            r[1] = -s * dx + c * dy
            row[0, 0] = 1.0
            row[0, 1] = 0.0
            row[0, 2] = -py
            row[1, 0] = 0.0
            row[1, 1] = 1.0
            row[1, 2] = px
        else:
            laser_x = T[0] + c * lasers[k * step, 0] - s * lasers[k * step, 1]
            laser_y = T[1] + s * lasers[k * step, 0] + c * lasers[k * step, 1]
            if nx * (laser_x - map_points[m, 0]) + ny * (laser_y - map_points[m, 1]) < 0.0:
                continue
            r[0] = nx * dx + ny * dy
            w = kernel_scale2 / (kernel_scale2 + r[0] * r[0])
            w = w * w
            row[0, 0] = nx * c + ny * s
            row[0, 1] = -nx * s + ny * c
            row[0, 2] = px * row[0, 1] - py * row[0, 0]
        sum_w += w
        for i in range(n_rows):
            for j in range(3):
                row[i, j + 3] = times[k] * row[i, j]
            for a in range(6):
                g[a] += w * row[i, a] * r[i]
                for b in range(a, 6):
                    h[a, b] += w * row[i, a] * row[i, b]
    for a in range(6):
        for b in range(a):
            h[a, b] = h[b, a]
    return sum_w
