"""Kernel of deskewing: where the beams of a sweep start and end, seen from its stamp."""

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray


@kernel
def sweep_geometry(
    times: FloatArray,
    first_s: float,
    last_s: float,
    knots: FloatArray,
    ranges: FloatArray,
    origin: FloatArray,
    directions: FloatArray,
    points: FloatArray,
    origins: FloatArray,
    turned: FloatArray,
) -> None:
    """Fill end points, origins and directions (n, 2) of n beams, in the base frame at the stamp.

    `origin` (2,) and `directions` (n, 2) are those in the base frame of each beam's own time.
    """
    last = knots.shape[0] - 1
    per_s = last / max(last_s - first_s, 1e-9)
    for k in range(times.shape[0]):
        at = min(max((times[k] - first_s) * per_s, 0.0), float(last))
        i = min(int(at), last - 1)
        share = at - i
        x = knots[i, 0] + share * (knots[i + 1, 0] - knots[i, 0])
        y = knots[i, 1] + share * (knots[i + 1, 1] - knots[i, 1])
        theta = knots[i, 2] + share * (knots[i + 1, 2] - knots[i, 2])
        c = np.cos(theta)
        s = np.sin(theta)
        origins[k, 0] = x + c * origin[0] - s * origin[1]
        origins[k, 1] = y + s * origin[0] + c * origin[1]
        turned[k, 0] = c * directions[k, 0] - s * directions[k, 1]
        turned[k, 1] = s * directions[k, 0] + c * directions[k, 1]
        r = ranges[k] if np.isfinite(ranges[k]) else np.nan
        points[k, 0] = origins[k, 0] + r * turned[k, 0]
        points[k, 1] = origins[k, 1] + r * turned[k, 1]
