"""The kernels against plain NumPy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry import _motion_kernels as kernels

seeds = st.integers(0, 2**32 - 1)


def poses_of(seed: int) -> FloatArray:
    return np.random.default_rng(seed).uniform([-9.0, -9.0, -7.0], [9.0, 9.0, 7.0], (2, 3))


def covariance(rng: np.random.Generator, scale: float = 1.0) -> FloatArray:
    root = scale * rng.normal(0.0, [0.1, 0.1, 0.05], (6, 3))
    return np.asarray(root.T @ root + 1e-6 * np.eye(3))


@given(seeds)
def test_a_relative_pose(seed: int) -> None:
    a, b = poses_of(seed)
    out = np.empty(3)
    kernels.relative(a, b, out)
    apart = out - se2.between(a, b)
    apart[2] = math.remainder(apart[2], 2.0 * math.pi)
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)
    assert -math.pi <= out[2] <= math.pi


@given(seeds, st.floats(0.1, 5.0), st.floats(0.05, 30.0))
def test_the_error_of_a_prediction(seed: int, lever_m: float, cap_m: float) -> None:
    a, b = poses_of(seed)
    x, y, turn = se2.between(a, b)
    expected = min(x**2 + y**2 + (lever_m * turn) ** 2, cap_m**2)
    np.testing.assert_allclose(kernels.prediction_error2(a, b, lever_m, cap_m), expected, rtol=1e-6)


@given(seeds)
def test_the_error_over_its_variance(seed: int) -> None:
    rng, (a, b) = np.random.default_rng(seed), poses_of(seed)
    cov_a, cov_b = covariance(rng), covariance(rng)
    expected = np.mean(se2.between(a, b) ** 2 / np.diag(cov_a + cov_b))
    np.testing.assert_allclose(kernels.normalised_error2(a, cov_a, b, cov_b), expected, rtol=1e-6)


def test_the_error_over_its_variance_is_one_where_that_is_right() -> None:
    rng, cov = np.random.default_rng(0), np.diag([0.02, 0.01, 0.03]) ** 2
    found = rng.multivariate_normal(np.zeros(3), 2.0 * cov, 4000)
    errors = [kernels.normalised_error2(np.zeros(3), cov, x, cov) for x in found]
    np.testing.assert_allclose(np.mean(errors), 1.0, atol=0.04)


class Case:
    """An innovation, and the covariances of the prediction (the motion is part of it), the match and the motion."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.motion = covariance(rng)
        self.predicted = self.motion + covariance(rng, 0.5)
        self.match = covariance(rng, 0.2)
        self.direction = rng.normal(0.0, [0.1, 0.1, 0.05])
        self.dof = float(rng.uniform(1.0, 9.0))

    def by_kernel(self, innovation: FloatArray) -> float:
        return kernels.heavy_tail_scale(innovation, self.predicted, self.match, self.motion, self.dof)

    def steps(self, innovation: FloatArray, n: int) -> list[float]:
        """Scales of n steps of expectation and maximisation, by the moments of the motion's error."""
        Q, scales, dof = self.motion, [1.0], self.dof
        rest = self.predicted - Q + self.match
        for _ in range(n):
            sQ = scales[-1] * Q
            gain = sQ @ np.linalg.inv(rest + sQ)
            mean, cov = gain @ innovation, sQ - gain @ sQ
            expected = np.trace(np.linalg.solve(Q, np.outer(mean, mean) + cov))
            scales.append((dof + expected) / (dof + 3.0))
        return scales


@given(seeds, st.floats(0.0, 20.0))
def test_the_scale_of_a_heavy_tail_is_that_of_its_steps(seed: int, size: float) -> None:
    case = Case(seed)
    scales = np.array(case.steps(size * case.direction, 12))
    changes = np.abs(np.diff(scales)) / scales[:-1]
    last = int(np.argmax(changes < 0.01)) + 1 if (changes < 0.01).any() else 12
    expected = max(scales[last], 1.0)
    np.testing.assert_allclose(case.by_kernel(size * case.direction), expected, rtol=0.011)


@given(seeds, st.floats(0.0, 20.0))
def test_the_scale_of_a_heavy_tail_is_not_above_where_the_steps_lead(seed: int, size: float) -> None:
    case = Case(seed)
    end = max(case.steps(size * case.direction, 3000)[-1], 1.0)
    found = case.by_kernel(size * case.direction)
    assert 1.0 <= found < 1.02 * end


@given(seeds)
def test_the_further_off_the_match_the_larger_the_scale(seed: int) -> None:
    case = Case(seed)
    scales = [case.by_kernel(size * case.direction) for size in np.linspace(0.0, 40.0, 30)]
    assert scales[0] == 1.0
    assert (np.diff(scales) > -0.02 * np.array(scales[:-1])).all()


@pytest.mark.parametrize("n_sigma", [0.0, 1.0, 2.0, 4.0, 10.0, 100.0])
def test_where_all_error_is_the_motions_the_scale_has_a_closed_form(n_sigma: float) -> None:
    motion, tiny, dof = np.diag([0.02, 0.01, 0.03]) ** 2, 1e-12 * np.eye(3), 4.0
    innovation = n_sigma * np.array([0.02, 0.0, 0.0])
    scale = kernels.heavy_tail_scale(innovation, motion + tiny, tiny, motion, dof)
    np.testing.assert_allclose(scale, max((dof + n_sigma**2) / (dof + 3.0), 1.0), rtol=1e-3)


@given(seeds)
def test_what_the_match_does_not_know_stretches_nothing(seed: int) -> None:
    case = Case(seed)
    case.match = 1e6 * np.eye(3)
    assert case.by_kernel(10.0 * case.direction) == 1.0


def test_a_motion_without_a_covariance_is_left_alone() -> None:
    zero = np.zeros((3, 3))
    assert kernels.heavy_tail_scale(np.ones(3), np.eye(3), np.eye(3), zero, 4.0) == 1.0


@pytest.mark.parametrize("is_open", [False, True])
@given(seeds, st.floats(0.02, 1.0), st.sampled_from([0.0, 0.03, 0.3]))
def test_a_velocity_is_filtered_with_axes_of_its_own(
    is_open: bool, seed: int, step_s: float, gain: float
) -> None:
    rng = np.random.default_rng(seed)
    increment, velocity = rng.normal(0.0, 0.1, (2, 3))
    cov = covariance(rng)
    var, cross, var_change = rng.uniform(0.01, 0.2, (3, 3))
    least = np.full(3, 1e-3)
    cov[0, 0] += 2.0 * is_open
    noise = cov / step_s**2 if is_open else np.diag(np.diag(cov)) / step_s**2
    innovation = increment / step_s - velocity
    alone = 1.0 / np.diag(np.linalg.inv(noise))
    change2 = np.minimum(innovation**2 - alone - var, 25.0 * var_change)
    new_change = np.maximum(var_change + gain * (change2 - var_change), least)
    predicted = var + new_change
    K = np.diag(predicted) @ np.linalg.inv(np.diag(predicted) + noise)
    expected = (
        velocity + K @ innovation,
        np.diag((np.eye(3) - K) @ np.diag(predicted)),
        (1.0 - np.diag(K)) * (cross + step_s * predicted),
        new_change,
    )
    kernels.learn_velocity(increment, cov, step_s, gain, least, velocity, var, cross, var_change)
    for found, right in zip((velocity, var, cross, var_change), expected, strict=True):
        np.testing.assert_allclose(found, right, rtol=1e-6)


@pytest.mark.parametrize("yaw", [0.0, 0.2, 0.5])
def test_a_corridor_leaves_no_more_open_than_the_way_along_it(yaw: float) -> None:
    """A robot that turns in a bare corridor, which it drives down at an angle."""
    along = np.array([np.cos(yaw), -np.sin(yaw), 0.002])
    cov = np.diag(np.square([0.005, 0.005, 0.002])) + 1e6 * np.outer(along, along)
    velocity, var = np.zeros(3), np.full(3, 0.01)
    cross, var_change, least = np.zeros(3), np.full(3, 0.01), np.full(3, 1e-3)
    turn = np.array([0.0, 0.0, 0.1])
    for _ in range(20):
        kernels.learn_velocity(turn, cov, 0.2, 0.15, least, velocity, var, cross, var_change)
    assert velocity[2] == pytest.approx(0.5, abs=0.02)
    assert var[2] < 0.001
    if yaw == 0.0:  # else the axes share what is told across
        assert var[1] < 0.001
        assert var[0] > 0.02  # of the way along nothing is learnt


@given(seeds, st.sampled_from([0.0, 0.15]))
def test_two_velocities_learn_as_each_does(seed: int, gain: float) -> None:
    rng = np.random.default_rng(seed)
    increment, cov, least, errors2 = rng.normal(0.0, 0.1, 3), covariance(rng), np.full(3, 1e-3), np.ones(2)
    steps_s = (0.1, 0.2)
    tables = [rng.uniform(0.01, 0.2, (4, 3)) for _ in steps_s]
    expected = [table.copy() for table in tables]
    kernels.learn_velocities(
        increment, cov, steps_s, gain, 2.0, 0.5, 0.02, least, tables[0], tables[1], errors2
    )
    for k, (step_s, table) in enumerate(zip(steps_s, expected, strict=True)):
        error2 = kernels.prediction_error2(step_s * table[0], increment, 2.0, 0.5)
        assert errors2[k] == (1.0 + 0.02 * (error2 - 1.0) if gain else 1.0)
        kernels.learn_velocity(increment, cov, step_s, gain, least, *table)
        np.testing.assert_array_equal(tables[k], table)
