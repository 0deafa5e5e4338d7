"""Where a match may start from beside the prediction, and which of the poses found from there leads."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization.config import ScanToMapConfig

N_SEARCHED = 60
"""Returns that a search of many starts looks at; the best start is then matched with all."""

MOST = 0.5
"""Fewer of the returns than most make no pose, however it leads."""


def turned_starts(
    T_local_base: FloatArray, step_rad: float, beyond_rad: float, reach_rad: float
) -> list[FloatArray]:
    """Poses (3,) turned either way, in steps, by more than one angle and up to another."""
    steps = range(int(beyond_rad / step_rad) + 1, int(reach_rad / step_rad) + 1)
    turns = [sign * k * step_rad for k in steps for sign in (1.0, -1.0)]
    return [se2.compose(T_local_base, np.array([0.0, 0.0, turn])) for turn in turns]


def shifted_starts(
    T_local_base: FloatArray, step_m: float, reach_m: float, step_rad: float
) -> Iterator[FloatArray]:
    """Poses (3,) on a grid of so many metres within reach, each in all headings."""
    n = int(reach_m / step_m)
    for i in range(-n, n + 1):
        for j in range(-n, n + 1):
            if math.hypot(i, j) <= n:
                T = se2.compose(T_local_base, np.array([i * step_m, j * step_m, 0.0]))
                yield from (T, *turned_starts(T, step_rad, 0.0, math.pi))


def some_of(is_valid: BoolArray) -> BoolArray:
    """(n,) about `N_SEARCHED` of the valid returns (n,), evenly."""
    some = np.zeros_like(is_valid)
    k = np.flatnonzero(is_valid)
    some[k[:: max(len(k) // N_SEARCHED, 1)]] = True
    return some


def leads(
    best: tuple[float, FloatArray],
    found: Sequence[tuple[float, FloatArray]],
    agreement: float,
    usual_agreement: float,
    config: ScanToMapConfig,
) -> bool:
    """Tell whether a pose is agreed by about as much as usual, and by far more than the start and all others.

    Parameters
    ----------
    best, found : share of the returns that agree, and pose (3,)
        The best and all.
    agreement, usual_agreement : float
        Of the start, and of the scans before.
    config : ScanToMapConfig
    """
    if best[0] < max(MOST, config.usual_share * usual_agreement):
        return False
    offsets = se2.between(best[1], np.array([T for _, T in found]))
    is_other = np.hypot(offsets[:, 0], offsets[:, 1]) > config.adrift_m
    is_other |= np.abs(offsets[:, 2]) > config.turn_step_rad
    rivals = [share for (share, _), other in zip(found, is_other.tolist(), strict=True) if other]
    return best[0] >= config.astray_lead * max([agreement, *rivals])
