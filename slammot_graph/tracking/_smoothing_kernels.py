"""Kernel of the smoother: a constant-velocity filter forward and the Rauch-Tung-Striebel pass back."""

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.tracking._kernels import predict


@kernel
def smooth(
    stamps: FloatArray,
    is_seen: BoolArray,
    places: FloatArray,
    noise: FloatArray,
    acceleration_std: float,
    start_speed_std: float,
    states: FloatArray,
    covs: FloatArray,
) -> None:
    """Fill `states` (n, 4) and `covs` (n, 4, 4) with the smoothed x, y, vx, vy at `stamps` (n,) [s].

    `places` (n, 2) and their `noise` (n, 2, 2) count where `is_seen` (n,), at the first stamp in any case. Rauch, Tung
    and Striebel 1965; stamps that run backward count as no time passed.
    """
    n = stamps.shape[0]
    before = np.empty((n, 4))
    before_cov = np.empty((n, 4, 4))
    one = np.zeros((1, 4))
    one_cov = np.zeros((1, 4, 4))
    one[0, 0] = places[0, 0]
    one[0, 1] = places[0, 1]
    for i in range(2):
        for j in range(2):
            one_cov[0, i, j] = noise[0, i, j]
        one_cov[0, i + 2, i + 2] = start_speed_std * start_speed_std
    gain = np.empty((4, 2))
    for k in range(n):
        if k > 0:
            predict(one, one_cov, max(stamps[k] - stamps[k - 1], 0.0), acceleration_std)
        before[k] = one[0]
        before_cov[k] = one_cov[0]
        if k > 0 and is_seen[k]:
            P = one_cov[0]
            s_xx = P[0, 0] + noise[k, 0, 0]
            s_xy = P[0, 1] + noise[k, 0, 1]
            s_yy = P[1, 1] + noise[k, 1, 1]
            det = s_xx * s_yy - s_xy * s_xy
            for i in range(4):
                gain[i, 0] = (P[i, 0] * s_yy - P[i, 1] * s_xy) / det
                gain[i, 1] = (P[i, 1] * s_xx - P[i, 0] * s_xy) / det
            dx = places[k, 0] - one[0, 0]
            dy = places[k, 1] - one[0, 1]
            for i in range(4):
                one[0, i] += gain[i, 0] * dx + gain[i, 1] * dy
            row_x = P[0].copy()
            row_y = P[1].copy()
            for i in range(4):
                for j in range(4):
                    P[i, j] -= gain[i, 0] * row_x[j] + gain[i, 1] * row_y[j]
        states[k] = one[0]
        covs[k] = one_cov[0]
    for k in range(n - 2, -1, -1):
        dt = max(stamps[k + 1] - stamps[k], 0.0)
        F = np.eye(4)
        F[0, 2] = F[1, 3] = dt
        G = covs[k] @ F.T @ np.linalg.inv(before_cov[k + 1])
        states[k] += G @ (states[k + 1] - before[k + 1])
        covs[k] += G @ (covs[k + 1] - before_cov[k + 1]) @ G.T
        covs[k] = 0.5 * (covs[k] + covs[k].T)
