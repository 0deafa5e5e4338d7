"""The noise of sightings against NumPy."""

import numpy as np
import pytest

from slammot_graph.tracking import _noise_kernels, _segment_kernels

SEEDS = range(5)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_track_learns_the_noise_of_its_measurements(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 4
    states, centres = rng.normal(0.0, 0.2, (n, 4)), rng.normal(0.0, 0.2, (n, 2))
    root = rng.normal(0.0, 0.1, (n, 4, 4))
    covs, noise = root @ root.transpose(0, 2, 1), np.tile(0.01 * np.eye(2), (n, 1, 1))
    of, factors = np.array([0, -1, 2, 3]), rng.uniform(0.2, 2.0, (2, n))
    kinds = np.array([0, 0, 1, rng.integers(2)])
    factor = factors[kinds, np.arange(n)]
    scaled, after = noise * factor[:, None, None], factors.copy()
    for t in (0, 2, 3):
        offset = centres[t] - states[t, :2]
        nis = offset @ np.linalg.solve(covs[t, :2, :2] + scaled[t], offset)
        learnt = factor[t] * np.exp(0.05 * (0.5 * min(nis, 10.0) - 1.0))
        after[kinds[t], t] = np.clip(learnt, *[(0.25, 20.0), (1.0, 5.0)][kinds[t]])
    scaled[1] = noise[1]
    _noise_kernels.learn_noise(states, covs, centres, of, kinds, 0.05, noise, factors)
    np.testing.assert_allclose(noise, scaled, rtol=1e-12)
    np.testing.assert_allclose(factors, after, rtol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_body_too_wide_or_beside_another_track_is_less_certain(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 6
    states, sizes, kinds = rng.normal(0.0, 0.9, (n, 4)), rng.uniform(0.1, 1.3, n), rng.integers(0, 2, n)
    noise = np.tile(0.01 * np.eye(2), (n, 1, 1))
    away = np.hypot(*(states[:, None, :2] - states[:, :2]).transpose(2, 0, 1)) + 9.0 * np.eye(n)
    more = (0.5 * np.clip(sizes - 0.5, 0.0, 0.4)) ** 2 + 0.004 * (away.min(axis=1) < 1.0)
    expected = noise + np.where(kinds == _segment_kernels.BODY_SEEN, more, 0.0)[:, None, None] * np.eye(2)
    _noise_kernels.blur_bodies(states, kinds, sizes, 0.5, 0.004, noise)
    np.testing.assert_allclose(noise, expected, rtol=1e-12)
