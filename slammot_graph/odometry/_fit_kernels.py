"""Kernel of a robust linear fit of two parameters."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray

DOF = 4.0
"""Degrees of freedom of Student's t: slips and wrong matches have heavy tails."""

N_WIDE, N_STEPS = 2, 3
"""Steps of a fit: so many at the scale of the residuals, and then so many at the scale given."""

MEDIAN_OF_SQUARES = 0.4549
"""Of a standard normal variable."""


@kernel
def fit_two(
    A: FloatArray,
    y: FloatArray,
    std: FloatArray,
    mean: FloatArray,
    prior_std: FloatArray,
    is_scale_given: bool,
    x: FloatArray,
    information: FloatArray,
    scores: FloatArray,
    costs: FloatArray,
) -> None:
    """Fit ``y = A x`` (n, 2) under Student's t by iteratively reweighted least squares; see `robust_fit`.

    Writes `x` (2,), `information` (2, 2), `scores` (n, 2) and `costs` (n,).
    """
    n = len(y)
    prior0, prior1 = prior_std[0] ** -2.0, prior_std[1] ** -2.0
    x0, x1 = mean[0], mean[1]
    scaled2 = np.empty(n)
    weights = np.empty(n)
    for i in range(n):
        scaled2[i] = ((y[i] - A[i, 0] * x0 - A[i, 1] * x1) / std[i]) ** 2
    h00 = h01 = h11 = 0.0
    for step in range(N_WIDE + N_STEPS):
        wide2 = 1.0
        if n and (step < N_WIDE or not is_scale_given):
            wide2 = max(np.median(scaled2) / MEDIAN_OF_SQUARES, 1.0)
        var_scale = 1.0 if is_scale_given else wide2
        h00, h01, h11 = prior0, 0.0, prior1
        g0, g1 = prior0 * mean[0], prior1 * mean[1]
        for i in range(n):
            w = (DOF + 1.0) / (DOF + scaled2[i] / wide2) / (std[i] * std[i] * var_scale)
            weights[i] = w
            a, b = A[i, 0], A[i, 1]
            h00 += w * a * a
            h01 += w * a * b
            h11 += w * b * b
            g0 += w * a * y[i]
            g1 += w * b * y[i]
        determinant = h00 * h11 - h01 * h01
        x0 = (h11 * g0 - h01 * g1) / determinant
        x1 = (h00 * g1 - h01 * g0) / determinant
        for i in range(n):
            scaled2[i] = ((y[i] - A[i, 0] * x0 - A[i, 1] * x1) / std[i]) ** 2
    x[0], x[1] = x0, x1
    information[0, 0], information[1, 1] = h00, h11
    information[0, 1] = information[1, 0] = h01
    for i in range(n):
        weighted = weights[i] * (y[i] - A[i, 0] * x0 - A[i, 1] * x1)
        scores[i, 0] = A[i, 0] * weighted
        scores[i, 1] = A[i, 1] * weighted
        costs[i] = 0.5 * (DOF + 1.0) * math.log1p(scaled2[i] / DOF)
