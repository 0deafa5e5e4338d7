"""The stamps of a log's scans, mended where they cannot serve as time: wrapped counters, clocks that stand still."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slammot_graph.core.types import FloatArray

ASSUMED_RATE_HZ = 10.0
"""Scans a second where the stamps do not tell."""

MIN_RISING_SHARE = 0.15
"""Where fewer steps between stamps than this go up, the stamps are no time."""

COUNTERS = {"s": 2.0**32, "ms": 2.0**32 * 1e-3, "us": 2.0**32 * 1e-6, "ns": 2.0**32 * 1e-9}
"""Units of 32-bit counters, and when they wrap around [s]."""

ROUNDING = 2e-6
"""Rounding of a stamp as text of six digits, as a share of it."""

MAX_STEPS_AT_WRAP = 10.0
"""A counter may skip so many usual steps where it wraps around."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanStamps:
    """Stamps of n scan records to be used [s], NaN where the record has none, and what was done to them.

    Attributes
    ----------
    stamps : (n,) array
    is_numbered : bool
        They are scan numbers over a rate.
    warnings : tuple of str
    """

    stamps: FloatArray
    is_numbered: bool = False
    warnings: tuple[str, ...] = ()


class Unwrapped(NamedTuple):
    """Stamps (n,) [s] of a counter that wrapped around, where (unit of `COUNTERS`, empty: nowhere) and how often."""

    stamps: FloatArray
    unit: str
    n_wraps: int


def mended(stamps: FloatArray) -> ScanStamps:
    """Make stamps (n,) in the file's order serve as time; those that do are given back as they are.

    Counters of 32 bits are unwrapped. Where the stamps do not rise at all, the numbers of the scans take their place.
    """
    unwrapped = unwrap(stamps)
    warnings = []
    if unwrapped.n_wraps:
        times = "once" if unwrapped.n_wraps == 1 else f"{unwrapped.n_wraps} times"
        warnings.append(
            f"stamps wrap around {times} at 2^32 {unwrapped.unit} (a 32-bit counter); they are unwrapped"
        )
    known = unwrapped.stamps[np.isfinite(unwrapped.stamps)]
    if len(stamps) < 2 or len(known) == 1:
        return ScanStamps(stamps=unwrapped.stamps, warnings=tuple(warnings))
    steps_s = np.diff(known)
    if len(known) and (steps_s > 0.0).mean() >= MIN_RISING_SHARE:
        return ScanStamps(stamps=unwrapped.stamps, warnings=tuple(warnings))
    if len(known) == 0:
        what = "no stamp is finite"
    elif np.ptp(known) == 0.0:
        what = f"all stamps are the same ({known[0]:g})"
    else:
        what = "the stamps do not rise"
    rate_hz, told_by = ASSUMED_RATE_HZ, "assumed"
    if len(known) > 2 and known[-1] > known[0] and (steps_s >= 0.0).all():
        rate_hz, told_by = (len(known) - 1) / float(known[-1] - known[0]), "by the first and the last stamp"
    warnings.append(f"{what}; scan numbers serve as time, at {rate_hz:.4g} scans a second ({told_by})")
    start = float(known[0]) if len(known) else 0.0
    numbered: FloatArray = start + np.arange(len(stamps)) / rate_hz
    return ScanStamps(stamps=numbered, is_numbered=True, warnings=tuple(warnings))


def unwrap(stamps: FloatArray) -> Unwrapped:
    """Undo the wraps of a 32-bit counter of seconds, milli-, micro- or nanoseconds; NaN may be among the stamps."""
    is_known = np.isfinite(stamps)
    known = stamps[is_known]
    if len(known) < 2:
        return Unwrapped(stamps, "", 0)
    steps_s = np.diff(known)
    usual_s = float(np.median(np.abs(steps_s)))
    for unit, period_s in COUNTERS.items():
        near_s = max(ROUNDING * period_s, MAX_STEPS_AT_WRAP * usual_s)
        if near_s > 0.25 * period_s or known.min() < -near_s or known.max() > period_s + near_s:
            continue
        is_low, is_high = np.abs(known) <= near_s, np.abs(known - period_s) <= near_s
        is_down = is_high[:-1] & is_low[1:]
        is_up = (
            is_low[:-1] & is_high[1:] & (unit == "s")
        )  # a counter below zero; of others it might be a pause
        n_wraps = int(np.count_nonzero(is_down | is_up))
        if n_wraps:
            turns = np.cumsum(is_down.astype(np.int64) - is_up.astype(np.int64))
            whole = stamps.copy()
            whole[is_known] = known + period_s * np.concatenate([[0], turns])
            return Unwrapped(whole, unit, n_wraps)
    return Unwrapped(stamps, "", 0)
