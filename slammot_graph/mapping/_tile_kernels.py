"""Kernels of the tiled grid."""

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray


@kernel
def bounds(
    origins: FloatArray, end_points: FloatArray, is_beam: BoolArray, is_hit: BoolArray, is_soft_hit: BoolArray
) -> tuple[float, float, float, float]:
    """Give the lowest x and y and the highest x and y of the laser's places (m, 2) and of the used end points."""
    x0 = x1 = origins[0, 0]
    y0 = y1 = origins[0, 1]
    for k in range(1, origins.shape[0]):
        x0 = min(x0, origins[k, 0])
        x1 = max(x1, origins[k, 0])
        y0 = min(y0, origins[k, 1])
        y1 = max(y1, origins[k, 1])
    for k in range(end_points.shape[0]):
        if is_beam[k] or is_hit[k] or is_soft_hit[k]:
            x0 = min(x0, end_points[k, 0])
            x1 = max(x1, end_points[k, 0])
            y0 = min(y0, end_points[k, 1])
            y1 = max(y1, end_points[k, 1])
    return x0, y0, x1, y1
