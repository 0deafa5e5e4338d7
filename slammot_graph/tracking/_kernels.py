"""Kernels of the tracks' Kalman filter, all tracks at once: predict, costs of pairs, nearest tracks, correct."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray, IntArray

OUTSIDE = 1e6
"""Cost of a pair outside the gate."""


@kernel
def predict(states: FloatArray, covs: FloatArray, dt: float, acceleration_std: float) -> None:
    """Carry `states` (n, 4) of x, y, vx, vy [m, m/s] and `covs` (n, 4, 4) over `dt` [s], in place.

    ``F P F' + Q`` with ``F = [[I, dt I], [0, I]]`` and ``Q`` of an acceleration [m/s^2] that holds for `dt`.
    """
    q = acceleration_std * acceleration_std
    for t in range(states.shape[0]):
        P = covs[t]
        for i in range(2):
            states[t, i] += dt * states[t, i + 2]
            for j in range(2):
                P[i, j] += dt * (P[i, j + 2] + P[i + 2, j]) + dt * dt * P[i + 2, j + 2]
        for i in range(2):
            for j in range(2):
                P[i, j + 2] += dt * P[i + 2, j + 2]
                P[i + 2, j] += dt * P[i + 2, j + 2]
        for i in range(2):
            P[i, i] += 0.25 * q * dt * dt * dt * dt
            P[i, i + 2] += 0.5 * q * dt * dt * dt
            P[i + 2, i] += 0.5 * q * dt * dt * dt
            P[i + 2, i + 2] += q * dt * dt


@kernel
def _innovation(
    state: FloatArray, cov: FloatArray, centre: FloatArray, noise: FloatArray
) -> tuple[float, float, float, float, float]:
    """Offset of a centre (2,) from a track (4,) as two uncorrelated numbers: u, var_u, w, var_w, slope.

    ``u = dx`` and ``w = dy - slope * dx``: the factors L D L' of the offset's covariance, which lose fewer digits
    than its inverse when a pose is very uncertain in one direction.
    """
    var_u = cov[0, 0] + noise[0, 0]
    cov_xy = cov[0, 1] + noise[0, 1]
    slope = cov_xy / var_u
    var_w = cov[1, 1] + noise[1, 1] - slope * cov_xy
    u = centre[0] - state[0]
    w = centre[1] - state[1] - slope * u
    return u, var_u, w, var_w, slope


@kernel
def pair_costs(
    states: FloatArray,
    covs: FloatArray,
    centres: FloatArray,
    noise: FloatArray,
    gate: float,
    out: FloatArray,
) -> None:
    """Fill `out` (n, k) with the squared Mahalanobis distance of each cluster to each track, or `OUTSIDE`.

    `centres` is (k, 2) [m], `noise` (k, 2, 2) their covariances [m^2].
    """
    for t in range(states.shape[0]):
        for c in range(centres.shape[0]):
            u, var_u, w, var_w, _ = _innovation(states[t], covs[t], centres[c], noise[c])
            distance2 = u * u / var_u + w * w / var_w
            out[t, c] = distance2 if distance2 <= gate else OUTSIDE


@kernel
def join_nearest(costs: FloatArray, cluster_of: IntArray) -> bool:
    """Join each cluster to its nearest track; False where that may not be the joining of least total cost.

    Fills `cluster_of` (n,) from `costs` (n, k), -1 for none. When no cluster has two nearest tracks and no two
    clusters the same one, every other joining costs some cluster more and none less.
    """
    cluster_of[:] = -1
    for c in range(costs.shape[1]):
        nearest = -1
        least = OUTSIDE
        is_tie = False
        for t in range(costs.shape[0]):
            if costs[t, c] < least:
                nearest = t
                least = costs[t, c]
                is_tie = False
            elif nearest >= 0 and costs[t, c] == least:
                is_tie = True
        if nearest >= 0:
            if is_tie or cluster_of[nearest] >= 0:
                return False
            cluster_of[nearest] = c
    return True


@kernel
def correct(
    states: FloatArray, covs: FloatArray, centres: FloatArray, noise: FloatArray, cluster_of: IntArray
) -> None:
    """Correct `states` (n, 4) and `covs` (n, 4, 4) by the clusters joined to them, in place; -1 in `cluster_of`: none.

    The covariances stay symmetric to the last bit.
    """
    a = np.empty(4)
    b = np.empty(4)
    for t in range(states.shape[0]):
        c = cluster_of[t]
        if c < 0:
            continue
        P = covs[t]
        u, var_u, w, var_w, slope = _innovation(states[t], P, centres[c], noise[c])
        for i in range(4):  # covariances of the state with u and w
            a[i] = P[i, 0]
            b[i] = P[i, 1] - slope * P[i, 0]
        for i in range(4):
            states[t, i] += a[i] * u / var_u + b[i] * w / var_w
            for j in range(4):
                P[i, j] -= a[i] * a[j] / var_u + b[i] * b[j] / var_w


@kernel
def carry_track(
    state: FloatArray, cov: FloatArray, T_a_b: FloatArray, motion: FloatArray, place_cov: FloatArray
) -> None:
    """Carry a state (4,) and its covariance (4, 4) into frame a, in which theirs lies at (3,).

    Fills `motion` (4,) and `place_cov` (2, 2).
    """
    R = np.empty((2, 2))
    R[0, 0] = R[1, 1] = math.cos(T_a_b[2])
    R[1, 0] = math.sin(T_a_b[2])
    R[0, 1] = -R[1, 0]
    for i in range(2):
        motion[i] = T_a_b[i] + R[i, 0] * state[0] + R[i, 1] * state[1]
        motion[i + 2] = R[i, 0] * state[2] + R[i, 1] * state[3]
        for j in range(2):
            place_cov[i, j] = 0.0
            for m in range(2):
                for n in range(2):
                    place_cov[i, j] += R[i, m] * cov[m, n] * R[j, n]
