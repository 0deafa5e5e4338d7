import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.registration._pair_kernels import partner

CELL_M = 0.1


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.5))
def test_the_partner_of_an_end_point_is_that_of_its_cell_if_it_is_near(seed: int, reach_m: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.0, 1.0, (8, 2))
    nearest = rng.integers(0, 16, (32, 32))
    x, y = rng.uniform(-1.5, 1.5, 2)
    first = int(rng.integers(0, 10))
    number = nearest[math.floor(y / CELL_M) % 32, math.floor(x / CELL_M) % 32]
    row = number % 8
    is_near = math.dist((x, y), points[row]) <= reach_m
    expected = row if number >= first and is_near else -1
    assert partner(x, y, points, nearest, 1.0 / CELL_M, first, reach_m**2) == expected
