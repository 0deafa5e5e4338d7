import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import chi2

from slammot_graph import Run
from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.linalg import mahalanobis2
from slammot_graph.evaluation import average_nees, ellipse_coverage, nees, pose_errors, run_consistency
from slammot_graph.evaluation.consistency import chi2_quantile
from slammot_graph.simulation import simulate

COV = np.array([[0.04, 0.01, 0.0], [0.01, 0.02, -0.002], [0.0, -0.002, 0.001]])


def test_quantiles_agree_with_scipy() -> None:
    for dof in (1, 2, 3, 150, 300):
        for probability in (0.025, 0.5, 0.95, 0.975):
            assert chi2_quantile(probability, dof) == pytest.approx(chi2.ppf(probability, dof))


@pytest.mark.parametrize(("n", "lower", "upper"), [(50, 2.36, 3.72), (100, 2.54, 3.50)])
def test_bounds_of_three_degrees_of_freedom(n: int, lower: float, upper: float) -> None:
    average = average_nees(np.full(n, 3.0), dof=3)
    assert (average.lower, average.upper) == pytest.approx((lower, upper), abs=0.005)
    assert average.is_consistent
    correlated = average_nees(np.full((n, 7), 3.0), dof=3, n_independent=n)
    assert (correlated.n, correlated.lower) == (7 * n, average.lower)


def test_nees_of_honest_and_of_optimistic_covariances(rng: np.random.Generator) -> None:
    errors = rng.multivariate_normal(np.zeros(3), COV, 4000)
    cov = np.broadcast_to(COV, (4000, 3, 3))
    samples = nees(errors, cov)
    np.testing.assert_allclose(samples[:5], [e @ np.linalg.inv(COV) @ e for e in errors[:5]])
    assert average_nees(samples, dof=3).is_consistent
    assert not average_nees(nees(errors, 0.8 * cov), dof=3).is_consistent
    coverage = ellipse_coverage(errors[:, :2], cov[:, :2, :2])
    assert coverage.lower < 0.95 < coverage.upper
    assert ellipse_coverage(errors[:, :2], 0.5 * cov[:, :2, :2]).upper < 0.9


def test_pose_errors_are_right_perturbations(rng: np.random.Generator) -> None:
    estimate = rng.normal(size=(10, 3))
    perturbation = rng.normal(size=(10, 3)) * 0.1
    truth = se2.compose(estimate, se2.exp(perturbation))
    np.testing.assert_allclose(pose_errors(estimate, truth), perturbation, atol=1e-9)


def test_covariances_that_are_none_are_left_out() -> None:
    cov = np.stack([np.eye(2), np.zeros((2, 2)), np.full((2, 2), math.nan), np.diag([1.0, -1.0])])
    errors = np.ones((4, 2))
    np.testing.assert_array_equal(nees(errors, cov), [2.0, math.nan, math.nan, math.nan])
    assert average_nees(nees(errors, cov), dof=2).n == 1
    assert ellipse_coverage(errors, cov).n == 1


def test_nothing_is_nan() -> None:
    average = average_nees(np.zeros(0), dof=3)
    assert average.n == 0 and math.isnan(average.anees) and not average.is_consistent
    coverage = ellipse_coverage(np.zeros((0, 2)), np.zeros((0, 2, 2)))
    assert coverage.n == 0 and math.isnan(coverage.share) and math.isnan(coverage.upper)


def test_shapes_must_agree() -> None:
    with pytest.raises(InputError, match="do not fit"):
        nees(np.zeros((2, 3)), np.zeros((2, 2, 2)))


def test_a_run_is_judged_by_the_truth_that_its_log_knows() -> None:
    log = simulate("two-walkers", seed=3)
    run = Run(log, "graph")
    steps = list(run)
    found = run_consistency(run.result())
    anchored = [step for step in steps if step.anchor_scan not in (-1, step.scan.index)]
    values = [
        mahalanobis2(
            se2.log(
                se2.between(
                    step.T_anchor_base,
                    se2.between(log.T_world_base[step.anchor_scan], log.T_world_base[step.scan.index]),
                )
            ),
            step.cov_anchor_base,
        )
        for step in anchored
    ]
    assert found.relative_nees == pytest.approx(np.mean(values), rel=1e-6)
    assert found.relative_covered == pytest.approx(np.mean(np.array(values) < 7.8147), abs=1e-3)
    assert 0.5 < found.relative_nees < 8.0
    assert 0.0 < found.nis_mean < 6.0
    assert 0.0 <= found.map_covered <= 1.0
    recorded = dataclasses.replace(run.result(), T_world_base=None)
    assert math.isnan(run_consistency(recorded).relative_nees)
    assert run_consistency(recorded).nis_mean == found.nis_mean
