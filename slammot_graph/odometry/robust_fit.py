"""Robust fits under Student's t: of linear parameters with their standard deviations, and of a noise's scale."""

import math
from dataclasses import dataclass

import numpy as np

from slammot_graph.core.odometry_report import Estimated
from slammot_graph.core.types import FloatArray

DOF = 4.0
"""Degrees of freedom of Student's t: slips and wrong matches have heavy tails."""

N_WIDE, N_STEPS = 2, 3
"""Steps of a fit: so many at the scale of the residuals, and then so many at the scale given."""

MEDIAN_OF_SQUARES = 0.4549
"""Of a standard normal variable."""


@dataclass(frozen=True, eq=False)
class RobustFit:
    """A robust linear fit: parameters, their information, residuals and cost."""

    x: FloatArray
    information: FloatArray
    residuals: FloatArray
    cost: float


def robust_fit(
    A: FloatArray, y: FloatArray, std: FloatArray, prior: tuple[FloatArray, FloatArray]
) -> RobustFit:
    """Fit ``y = A x`` under Student's t of a given scale, with a Gaussian prior (mean, std) of x.

    The first steps widen the scale to that of the residuals: far from the solution nearly all of them are in the
    tails, which would hold it where it is.
    """
    mean, prior_std = prior
    prior_information = np.diag(prior_std**-2.0)
    x: FloatArray = mean
    information: FloatArray = prior_information
    residuals = y - A @ x
    for step in range(N_WIDE + N_STEPS):
        scaled2 = np.square(residuals / std)
        wide2 = max(float(np.median(scaled2)) / MEDIAN_OF_SQUARES, 1.0) if step < N_WIDE else 1.0
        weights = (DOF + 1.0) / (DOF + scaled2 / wide2) / np.square(std)
        weighted = A * weights[:, None]
        information = weighted.T @ A + prior_information
        x = np.asarray(np.linalg.solve(information, weighted.T @ y + prior_information @ mean))
        residuals = y - A @ x
    cost = 0.5 * (DOF + 1.0) * float(np.log1p(np.square(residuals / std) / DOF).sum())
    return RobustFit(x, information, residuals, cost)


def stds_of(fit: RobustFit, prior_std: FloatArray) -> list[float]:
    """Standard deviations of the parameters; infinite where the data say no more than the prior."""
    cov = np.linalg.inv(fit.information)
    stds = np.sqrt(np.diag(cov))
    return [float(std) if std < 0.5 * prior else math.inf for std, prior in zip(stds, prior_std, strict=True)]


def noise_scale_of(errors2: FloatArray, model: FloatArray, own: FloatArray, spread: float) -> Estimated:
    """Scale of a standard deviation so that errors have variance ``scale^2 model + own``, under Student's t."""
    logs = np.linspace(math.log(1e-5), math.log(100.0), 36)
    costs = np.empty(len(logs))
    for k, log_scale in enumerate(logs):
        var = math.exp(log_scale) * model + own
        costs[k] = 0.5 * (np.log(var) + (DOF + 1.0) * np.log1p(errors2 / var / DOF)).sum()
    costs += 0.5 * (logs / spread) ** 2
    k = int(np.argmin(costs))
    step = logs[1] - logs[0]
    inner = int(np.clip(k, 1, len(logs) - 2))
    curvature = (costs[inner - 1] - 2.0 * costs[inner] + costs[inner + 1]) / step**2
    value = math.exp(0.5 * logs[k])
    std = 0.5 * value / math.sqrt(curvature) if curvature > 1e-6 else math.inf
    return Estimated(value=value, std=std)
