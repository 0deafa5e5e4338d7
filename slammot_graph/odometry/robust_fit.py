"""Robust fits under Student's t: of linear parameters with their standard deviations, and of a noise's scale."""

import math
from dataclasses import dataclass

import numpy as np

from slammot_graph.core.odometry_report import Estimated
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry import _fit_kernels
from slammot_graph.odometry._fit_kernels import DOF, MEDIAN_OF_SQUARES

SLOPE_OF_WEIGHTS = 0.75
"""Mean slope of Student's gradient over the mean weight, for normal residuals of its scale."""

N_LAGS = 12
"""Rows that are further apart are independent."""


@dataclass(frozen=True, eq=False)
class RobustFit:
    """A robust linear fit.

    Attributes
    ----------
    x : (2,) array
    information : (2, 2) array
        Of the weighted squares, the prior's included.
    scores : (n, 2) array
        Each row's part of the gradient of the cost.
    costs : (n,) array
        Negative log likelihood of each row.
    """

    x: FloatArray
    information: FloatArray
    scores: FloatArray
    costs: FloatArray


def robust_fit(
    A: FloatArray,
    y: FloatArray,
    std: FloatArray,
    prior: tuple[FloatArray, FloatArray],
    *,
    is_scale_given: bool = True,
) -> RobustFit:
    """Fit ``y = A x``, A (n, 2), under Student's t, with a Gaussian prior (mean, std) of the two parameters.

    The first steps widen the scale to that of the residuals: far from the solution nearly all of them are in the
    tails, which would hold it where it is. Where `std` is a lower bound of the scale only, all steps do.
    """
    n = len(y)
    x, information, scores, costs = np.empty(2), np.empty((2, 2)), np.empty((n, 2)), np.empty(n)
    _fit_kernels.fit_two(A, y, std, *prior, is_scale_given, x, information, scores, costs)
    return RobustFit(x, information, scores, costs)


def stds_of(fit: RobustFit, prior_std: FloatArray, n_series: int = 1) -> list[float]:
    """Standard deviations of the parameters; infinite where the data say no more than the prior.

    The residuals hold more than the matches' errors, and neighbours are not independent. So the larger counts of the
    variance that the fit expects, and the one by how the rows' gradients add up in fact (`long_run_variance`).

    Parameters
    ----------
    fit : RobustFit
    prior_std : (p,) array
    n_series : int
        So many series in time follow each other in the rows, of which row i of each belongs to the same time.
    """
    cov = np.linalg.inv(fit.information)
    scores = fit.scores.reshape(n_series, -1, len(fit.x)).sum(axis=0)
    # the gradient's slope is less than the weights, for a residual counts less the larger it is
    spread = SLOPE_OF_WEIGHTS**-2.0 * cov @ long_run_variance(scores) @ cov
    stds = np.sqrt(np.maximum(np.diag(cov), few_samples(len(scores)) ** 2 * np.diag(spread)))
    return [float(std) if std < 0.5 * prior else math.inf for std, prior in zip(stds, prior_std, strict=True)]


def residual_scale(normalised: FloatArray) -> float:
    """Robust standard deviation of residuals (n,) around 0, by their median square."""
    return math.sqrt(float(np.median(normalised**2)) / MEDIAN_OF_SQUARES)


def scaled_and_turned(u: FloatArray) -> FloatArray:
    """(2n, 2) columns of a linear fit to the motion (n, 3): a scale times cosine and sine of a direction."""
    return np.vstack([np.column_stack([u[:, 0], -u[:, 1]]), np.column_stack([u[:, 1], u[:, 0]])])


def few_samples(n: int) -> float:
    """How much larger a standard deviation by `long_run_variance` must be for its interval to hold 95% of n rows.

    With so many lags in so few rows it is too small, and uncertain: the critical values are those of Kiefer and
    Vogelsang (2005), Table 1, for the share b of the lags in the rows.
    """
    b = min((N_LAGS + 1.0) / n, 1.0)
    return (1.96 + 2.9694 * b + 0.4160 * b**2 - 0.5324 * b**3) / 1.96


def long_run_variance(scores: FloatArray) -> FloatArray:
    """(p, p) covariance of the sum of a series (n, p) whose neighbours go together (Newey and West, 1987)."""
    scores = scores - scores.mean(axis=0)
    n, p = scores.shape
    total = scores.T @ scores
    n_lags = min(N_LAGS, n - 1)
    for lag in range(1, n_lags + 1):
        product = scores[lag:].T @ scores[:-lag]
        total += (1.0 - lag / (n_lags + 1.0)) * (product + product.T)
    return np.asarray(total * (n / max(n - p, 1)))


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
