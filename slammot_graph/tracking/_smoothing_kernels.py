"""Kernel of the smoother: a constant-velocity filter forward and the Rauch-Tung-Striebel pass back."""

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.tracking._kernels import correct, predict


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
    joined = np.zeros(1, dtype=np.int64)
    for k in range(n):
        if k > 0:
            predict(one, one_cov, max(stamps[k] - stamps[k - 1], 0.0), acceleration_std)
        before[k] = one[0]
        before_cov[k] = one_cov[0]
        if k > 0 and is_seen[k]:
            correct(one, one_cov, places[k : k + 1], noise[k : k + 1], joined)
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
