"""Keyframes that differ are picked as NumPy does it."""

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.localization._keyframe_kernels import pick_unlike

APART_M, APART_RAD = 0.3, 0.4


def picked_by_numpy(poses: FloatArray, order: IntArray, n: int) -> list[int]:
    chosen, left = list[int](), order
    while len(left) and len(chosen) < n:
        chosen.append(int(left[0]))
        x, y, theta = (poses[left] - poses[left[0]]).T
        is_like = (x**2 + y**2 < APART_M**2) & (np.abs(se2.wrap_angle(theta)) < APART_RAD)
        is_like[0] = True
        left = left[~is_like]
    return chosen


@pytest.mark.parametrize("n", [1, 20, 500])
@pytest.mark.parametrize("seed", range(3))
def test_they_are_those_of_numpy(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(0.0, 2.0, (200, 2)), rng.uniform(-np.pi, np.pi, 200)])
    order, picked = rng.permutation(200), np.empty(n, dtype=np.int64)
    n_picked = pick_unlike(poses, order, APART_M, APART_RAD, picked)
    expected = picked_by_numpy(poses, order, n)
    assert picked[:n_picked].tolist() == expected
    assert n_picked == len(expected) < 200
