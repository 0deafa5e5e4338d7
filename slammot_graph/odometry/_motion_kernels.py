"""Kernels of the motion between two scans: errors of its predictions, and how far evidence stretches a covariance."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.linalg import invert3
from slammot_graph.core.types import FloatArray


@kernel
def relative(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Fill `out` with the pose `b` in the frame of `a`, all (3,)."""
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    out[0] = c * dx + s * dy
    out[1] = -s * dx + c * dy
    turn = b[2] - a[2]
    out[2] = turn - 2.0 * math.pi * math.floor((turn + math.pi) / (2.0 * math.pi))


@kernel
def prediction_error2(predicted: FloatArray, found: FloatArray, lever_m: float, cap_m: float) -> float:
    """Squared distance of two increments (3,), a turn counted at a lever [m^2]; no more than that of `cap_m`."""
    e = np.empty(3)
    relative(predicted, found, e)
    error2 = e[0] * e[0] + e[1] * e[1] + (lever_m * e[2]) * (lever_m * e[2])
    return float(min(error2, cap_m * cap_m))


@kernel
def normalised_error2(
    predicted: FloatArray, cov_predicted: FloatArray, found: FloatArray, cov_found: FloatArray
) -> float:
    """Mean squared error of a predicted increment (3,) over its variance, axis by axis: 1 if that is right."""
    e = np.empty(3)
    relative(predicted, found, e)
    total = 0.0
    for i in range(3):
        total += e[i] * e[i] / (cov_predicted[i, i] + cov_found[i, i])
    return float(total / 3.0)


@kernel
def judge_predictions(
    odometry: FloatArray,
    cov_odometry: FloatArray,
    previous: FloatArray,
    found: FloatArray,
    cov_found: FloatArray,
    lever_m: float,
    cap_m: float,
    gain: float,
    max_excess: float,
    means: FloatArray,
) -> None:
    """Update running means by a found increment: squared errors of both predictions, excess of the odometry."""
    means[0] += gain * (prediction_error2(odometry, found, lever_m, cap_m) - means[0])
    means[1] += gain * (prediction_error2(previous, found, lever_m, cap_m) - means[1])
    excess = normalised_error2(odometry, cov_odometry, found, cov_found)
    means[2] += gain * (min(excess, max_excess) - means[2])


OPEN_M2 = 1.0
"""A match whose variances are larger than this leaves a direction open."""


@kernel
def learn_velocity(
    increment: FloatArray,
    cov: FloatArray,
    step_s: float,
    gain: float,
    least_var: FloatArray,
    velocity: FloatArray,
    var: FloatArray,
    cross: FloatArray,
    var_change: FloatArray,
) -> None:
    """Take an increment (3,) into a velocity by a Kalman filter, and learn the variance of its change.

    The velocity's errors are taken as independent from axis to axis; those of the increment are not: down a corridor
    its covariance (3, 3) is open in one direction, into which a robot that does not drive straight along brings all
    three axes, and across it and in heading it tells nevertheless. Increments that are noisier than all that was learnt
    tell of no change: down a bare corridor the robot is taken to keep its speed, but for the least change.

    `cross` is the covariance of the velocity with the way that was predicted by it since it was last known well.
    """
    innovation = increment / step_s - velocity
    noise = cov / (step_s * step_s)
    inverse = np.zeros((3, 3))
    is_open = cov[0, 0] + cov[1, 1] > OPEN_M2 and invert3(noise, inverse)
    if not is_open:
        noise = np.diag(np.diag(noise))
    for i in range(3):
        # where a direction is open: its noise once the other axes are known
        alone = 1.0 / inverse[i, i] if is_open else noise[i, i]
        change2 = innovation[i] * innovation[i] - alone - var[i]
        var_change[i] += gain * (min(change2, 25.0 * var_change[i]) - var_change[i])
        var_change[i] = max(var_change[i], least_var[i])
    predicted = var + var_change
    whole = noise + np.diag(predicted)
    if not invert3(whole, inverse):
        return
    for i in range(3):
        cross[i] += step_s * predicted[i]
        weight = predicted[i] * inverse[i, i]
        for j in range(3):
            velocity[i] += predicted[i] * inverse[i, j] * innovation[j]
        var[i] = (1.0 - weight) * predicted[i]
        cross[i] *= 1.0 - weight


@kernel
def learn_velocities(
    increment: FloatArray,
    cov: FloatArray,
    steps_s: tuple[float, float],
    gain: float,
    lever_m: float,
    cap_m: float,
    error_gain: float,
    least_var: FloatArray,
    first: FloatArray,
    second: FloatArray,
    errors2: FloatArray,
) -> None:
    """Let two velocities, (4, 3) tables as of `previous_motion.Velocity`, learn an increment, each over its own step.

    Before, `errors2` (2,) takes in the squared errors of what they predict with the weight `error_gain`, unless `gain`
    is 0.
    """
    predicted = np.empty(3)
    for k in range(2):
        table = first if k == 0 else second
        if gain > 0.0:
            for i in range(3):
                predicted[i] = steps_s[k] * table[0, i]
            error2 = prediction_error2(predicted, increment, lever_m, cap_m)
            errors2[k] += error_gain * (error2 - errors2[k])
        learn_velocity(increment, cov, steps_s[k], gain, least_var, table[0], table[1], table[2], table[3])


@kernel
def heavy_tail_scale(
    innovation: FloatArray,
    cov_predicted: FloatArray,
    cov_match: FloatArray,
    cov_motion: FloatArray,
    dof: float,
) -> float:
    """Scale of the motion's covariance under Student's t, given how far a match lies from the prediction.

    The motion's error w ~ N(0, s Q) with 1/s ~ Gamma(dof/2, dof/2) (Student's t); its posterior given the innovation
    (3,) has mean and covariance by a Kalman update, and s is found by expectation-maximisation:
    ``s = (dof + E[w' inv(Q) w]) / (dof + 3)``. At least 1. (Liu and Rubin, 1995.)
    """
    inverse_motion, S, gain, rest = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    if not invert3(cov_motion, inverse_motion):
        return 1.0
    scale = 1.0
    for _ in range(12):
        for i in range(3):
            for j in range(3):
                S[i, j] = cov_predicted[i, j] + cov_match[i, j] + (scale - 1.0) * cov_motion[i, j]
        if not invert3(S, rest):
            return scale
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += cov_motion[i, k] * rest[k, j]
                gain[i, j] = scale * total
        w = gain @ innovation
        # E[w' inv(Q) w] = w' inv(Q) w + trace(inv(Q) (sQ - K sQ)) = w' inv(Q) w + s (3 - trace(K))
        expected = float(w @ (inverse_motion @ w)) + scale * float(3.0 - gain[0, 0] - gain[1, 1] - gain[2, 2])
        new = (dof + expected) / (dof + 3.0)
        if abs(new - scale) < 0.01 * scale:
            return max(new, 1.0)
        scale = new
    return max(scale, 1.0)
