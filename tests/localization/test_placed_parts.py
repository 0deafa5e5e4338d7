"""Poses of a run that looks for its place in a saved map."""

import numpy as np

from slammot_graph.core import se2
from slammot_graph.localization.placed_parts import PlacedParts

UNKNOWN, T_MAP_LOCAL = 1e6 * np.eye(3), np.array([3.0, -1.0, 0.5])


def test_a_part_is_placed_once_it_is_found_and_those_before_stay() -> None:
    rng = np.random.default_rng(0)
    local = rng.normal(size=(9, 3))
    parts = PlacedParts()
    for k in range(4):
        parts.append(local[k], UNKNOWN)
    parts.begin()
    for k in range(4, 8):
        parts.append(local[k], UNKNOWN)
    found, covs = rng.normal(size=(3, 3)), np.stack([np.diag([k, 2.0, 3.0]) for k in range(1, 4)])
    covs[:, 0, 2] = covs[:, 2, 0] = 0.5
    parts.place(T_MAP_LOCAL, found, covs)  # of the scan at which it was lost nothing is known
    parts.append(local[8], np.eye(3))
    T_map_base, cov_map = parts.trajectory()
    assert len(parts) == 9
    assert not parts.is_placed
    np.testing.assert_array_equal(T_map_base[:4], local[:4])
    np.testing.assert_allclose(T_map_base[[4, 8]], se2.compose(T_MAP_LOCAL[None], local[[4, 8]]))
    np.testing.assert_allclose(T_map_base[5:8], found, atol=1e-12)
    np.testing.assert_array_equal(cov_map[:5], [UNKNOWN] * 5)
    np.testing.assert_array_equal(cov_map[5:8], covs)
    np.testing.assert_array_equal(cov_map[8], np.eye(3))


def test_poses_of_parts_before_are_not_taken_for_those_of_the_latest() -> None:
    parts = PlacedParts()
    for k in range(3):
        parts.append(np.full(3, 0.1 * k), UNKNOWN)
    parts.begin()
    parts.append(np.zeros(3), UNKNOWN)
    parts.place(T_MAP_LOCAL, np.arange(12.0).reshape(4, 3) / 10.0, np.stack([np.eye(3)] * 4))
    T_map_base, cov_map = parts.trajectory()
    np.testing.assert_allclose(T_map_base[3], [0.9, 1.0, 1.1])
    np.testing.assert_array_equal(T_map_base[:3, 0], [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(cov_map[:3], [UNKNOWN] * 3)
