"""Stamps of scans and poses: the nearest one, and whether two sequences are of one log."""

import numpy as np

from slammot_graph.core.types import FloatArray, IntArray

STAMP_TOLERANCE_S = 1e-5
"""Stamps that differ by no more are the same: files hold six decimals or more, scans lie much farther apart."""


def nearest_stamps(stamps: FloatArray, wanted: FloatArray, tolerance_s: float) -> IntArray:
    """Find the nearest stamp of each wanted time.

    Parameters
    ----------
    stamps : (n,) array [s]
        In any order; of equal ones the first is found.
    wanted : (m,) array [s]
    tolerance_s : float

    Returns
    -------
    (m,) int array
        Indices into `stamps`; -1 where none lies within the tolerance.
    """
    if len(stamps) == 0:
        return np.full(len(wanted), -1, dtype=np.int64)
    order = np.argsort(stamps, kind="stable")
    ordered = stamps[order]
    right = np.searchsorted(ordered, np.minimum(wanted, ordered[-1])).clip(0, len(stamps) - 1)
    left_stamps = ordered[(right - 1).clip(0)]
    left = np.searchsorted(ordered, left_stamps)
    nearest = np.where(np.abs(ordered[right] - wanted) <= np.abs(left_stamps - wanted), right, left)
    is_near = np.abs(ordered[nearest] - wanted) <= tolerance_s
    return np.where(is_near, order[nearest], -1)


def have_same_times(a: FloatArray, b: FloatArray) -> bool:
    """Whether two runs (n,), (m,) [s] are of one log: their stamps agree over the length of the shorter one.

    Not so if one of them is empty.
    """
    n = min(len(a), len(b))
    return n > 0 and np.allclose(a[:n], b[:n], rtol=0.0, atol=STAMP_TOLERANCE_S)
