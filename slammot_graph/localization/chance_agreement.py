"""Is a match that failed one of a robot that is elsewhere, or has only the view changed?

On a slope the laser sees the ground, which moves along with the robot; hedges look different from scan to scan. Most of
such a scan agrees with no pose, but what does agree lies where the prediction says. Of a robot that was kidnapped
hardly more agrees there than at any other pose, and then by chance.
"""

from collections.abc import Callable

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray

N_OTHERS = 60
"""Other poses that are tried: one of a robot that is elsewhere stands out among them in one scan of so many."""
NEAREST_M, FARTHEST_M = 0.7, 3.0
"""How far they lie away; nearer ones agree as well as the true pose does."""


def stands_out(agreement_at: Callable[[FloatArray], float], T_predicted: FloatArray) -> bool:
    """Tell whether more of a scan agrees at the predicted pose than at each of many other poses.

    Parameters
    ----------
    agreement_at : callable
        Gives the share of the scan that agrees at a pose (3,).
    T_predicted : (3,) array
        Same frame.
    """
    agreement = agreement_at(T_predicted)
    return agreement > 0.0 and all(
        agreement > agreement_at(T) for T in se2.compose(T_predicted[None, :], _OTHERS)
    )


def _spread_poses(n: int) -> FloatArray:
    """(n, 3) poses around the origin, evenly spread over a ring and over all headings."""
    k = np.arange(n)
    radius = np.sqrt(np.linspace(NEAREST_M**2, FARTHEST_M**2, n))
    golden = np.pi * (3.0 - np.sqrt(5.0))  # no two of so many multiples come close to each other
    heading = se2.wrap_angle(2.0 * np.pi * np.sqrt(2.0) * k)
    return np.column_stack([radius * np.cos(golden * k), radius * np.sin(golden * k), heading])


_OTHERS = _spread_poses(N_OTHERS)
