"""Kernel of the pairs of a match onto the local map: the map's point beside an end point."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray


@kernel
def partner(
    x: float,
    y: float,
    map_points: FloatArray,
    nearest: "np.ndarray",
    inv_cell: float,
    first: int,
    reach2: float,
) -> int:
    """Row of the map's point that belongs to an end point x, y [m]; -1 where none is within reach.

    `nearest` holds for each cell (wrapped, a power of two of them a side) the number of the latest point nearest to it;
    numbers below `first` have left the map, and rows wrap around as well.
    """
    mask = nearest.shape[0] - 1
    number = nearest[math.floor(y * inv_cell) & mask, math.floor(x * inv_cell) & mask]
    if number < first:
        return -1
    m = number & (map_points.shape[0] - 1)
    dx = x - map_points[m, 0]
    dy = y - map_points[m, 1]
    return -1 if dx * dx + dy * dy > reach2 else m
