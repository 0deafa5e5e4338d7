"""A match in which the velocity during the sweep is open too."""

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.registration import _solve_kernels
from slammot_graph.registration._sweep_kernels import accumulate_sweep
from tests.registration.keyframes import circle, local_map_of
from tests.rooms import LASER, take_scan

T = np.array([0.1, -0.05, 0.3])


@pytest.mark.parametrize("n_origins", [1, LASER.n_beams])
def test_normal_equations_are_those_of_the_pose_at_each_time(
    rng: np.random.Generator, n_origins: int
) -> None:
    """Points of one time move with their pose: their part of the sum is that of `accumulate`, times 1, t and t^2."""
    local_map = local_map_of(circle(6), rng)
    local_map.normals[rng.choice(local_map.end, local_map.end // 5)] = 0.0
    scan = take_scan(T, noise=rng.normal(0.0, 0.03, LASER.n_beams))
    points, is_used = scan.points_base(), scan.is_valid()
    lasers = LASER.origin_base + rng.normal(0.0, 0.2, (n_origins, 2))
    values = np.array([-0.05, 0.0, 0.1])
    times = values[rng.integers(0, 3, LASER.n_beams)]
    field = local_map.points, local_map.normals, local_map.nearest, local_map.inv_cell, local_map.first
    h, g = np.empty((6, 6)), np.empty(6)
    sum_w = accumulate_sweep(*field, points, is_used, lasers, times, T, 0.16, 0.01, 0.2, h, g)
    expected_h, expected_g, expected_w = np.zeros((6, 6)), np.zeros(6), 0.0
    for t in values:
        part, rhs, stats = np.empty((3, 3)), np.empty(3), np.empty(4)
        _solve_kernels.accumulate(
            *field, points, is_used & (times == t), lasers, T, 0.16, 0.01, 0.2, part, rhs, stats
        )
        powers: FloatArray = np.array([[1.0, t], [t, t * t]])
        expected_h += np.kron(powers, part)
        expected_g += np.kron([1.0, t], rhs)
        expected_w += 0.0 if not stats[1] else float(np.trace(part[:2, :2]))
    assert np.count_nonzero(expected_g) == 6
    np.testing.assert_allclose(h, expected_h, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(g, expected_g, rtol=1e-9, atol=1e-9)
    assert 0.0 < sum_w <= expected_w + 1e-9
    assert not np.allclose(se2.rotation(T[2]), np.eye(2))
