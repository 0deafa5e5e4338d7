"""The kernel of the robust fit against a plain NumPy twin."""

import numpy as np
import pytest

from slammot_graph.core.types import FloatArray
from slammot_graph.odometry._fit_kernels import DOF, MEDIAN_OF_SQUARES, N_STEPS, N_WIDE
from slammot_graph.odometry.robust_fit import robust_fit


def twin(
    A: FloatArray,
    y: FloatArray,
    std: FloatArray,
    mean: FloatArray,
    prior_std: FloatArray,
    *,
    is_scale_given: bool,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    prior_information = np.diag(prior_std**-2.0)
    residuals = y - A @ mean
    for step in range(N_WIDE + N_STEPS):
        scaled2 = np.square(residuals / std)
        wide2 = 1.0
        if step < N_WIDE or not is_scale_given:
            wide2 = max(float(np.median(scaled2)) / MEDIAN_OF_SQUARES, 1.0)
        var = np.square(std) * (1.0 if is_scale_given else wide2)
        weights = (DOF + 1.0) / (DOF + scaled2 / wide2) / var
        weighted = A * weights[:, None]
        information = weighted.T @ A + prior_information
        x = np.linalg.solve(information, weighted.T @ y + prior_information @ mean)
        residuals = y - A @ x
    costs = 0.5 * (DOF + 1.0) * np.log1p(np.square(residuals / std) / DOF)
    return np.asarray(x, dtype=np.float64), information, A * (weights * residuals)[:, None], costs


@pytest.mark.parametrize("is_scale_given", [True, False])
def test_the_fit_is_its_numpy_twin(is_scale_given: bool) -> None:
    rng = np.random.default_rng(4)
    A = rng.normal(size=(301, 2))
    std = rng.uniform(0.01, 0.2, 301)
    y = A @ np.array([0.8, -0.1]) + 3.0 * std * rng.standard_t(2.0, 301)
    mean, prior_std = np.array([1.0, 0.0]), np.array([0.5, 0.1])
    fit = robust_fit(A, y, std, (mean, prior_std), is_scale_given=is_scale_given)
    x, information, scores, costs = twin(A, y, std, mean, prior_std, is_scale_given=is_scale_given)
    np.testing.assert_allclose(fit.x, x, rtol=1e-10)
    np.testing.assert_allclose(fit.information, information, rtol=1e-10)
    np.testing.assert_allclose(fit.scores, scores, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(fit.costs, costs, rtol=1e-10)


def test_without_rows_the_prior_is_left() -> None:
    mean, prior_std = np.array([1.0, 0.0]), np.array([0.5, 0.1])
    fit = robust_fit(np.zeros((0, 2)), np.zeros(0), np.zeros(0), (mean, prior_std))
    np.testing.assert_allclose(fit.x, mean)
    np.testing.assert_allclose(fit.information, np.diag(prior_std**-2.0))
