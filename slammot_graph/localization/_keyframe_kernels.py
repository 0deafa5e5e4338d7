"""Kernel that picks keyframes of a saved map that differ."""

import math

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray, IntArray


@kernel
def pick_unlike(
    poses: FloatArray, order: IntArray, apart_m: float, apart_rad: float, picked: IntArray
) -> int:
    """Fill `picked` with the first rows, in an order, of poses (k, 3) of which none is like one before; how many.

    Two are alike that are nearer than `apart_m` and turned by less than `apart_rad`.
    """
    n = 0
    for k in order:
        if n == len(picked):
            break
        is_like = False
        for j in picked[:n]:
            x, y = poses[k, 0] - poses[j, 0], poses[k, 1] - poses[j, 1]
            turn = (poses[k, 2] - poses[j, 2] + math.pi) % (2.0 * math.pi) - math.pi
            if x**2 + y**2 < apart_m**2 and abs(turn) < apart_rad:
                is_like = True
                break
        if not is_like:
            picked[n] = k
            n += 1
    return n
