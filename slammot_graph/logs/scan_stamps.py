"""The stamps of a log's scans, mended where they cannot serve as time: wrapped counters, other units, still clocks."""

from dataclasses import dataclass
from itertools import product
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

LONGEST_USUAL_STEP_S = 10.0
"""Where most scans are further apart, the stamps are no seconds, but the first of `UNITS` in which they are not."""

MIN_STEPS = 10
"""Fewer steps do not tell the unit."""

UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}


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
    in_seconds, unit = _in_seconds(unwrapped.stamps)
    warnings = []
    if unwrapped.n_wraps:
        times = "once" if unwrapped.n_wraps == 1 else f"{unwrapped.n_wraps} times"
        warnings.append(
            f"stamps wrap around {times} at 2^32 {unwrapped.unit} (a 32-bit counter); they are unwrapped"
        )
    if unit:
        warnings.append(f"stamps are {unit} by the time between scans; they are turned into seconds")
    known = in_seconds[np.isfinite(in_seconds)]
    if len(stamps) < 2 or len(known) == 1:
        return ScanStamps(stamps=in_seconds, warnings=tuple(warnings))
    steps_s = np.diff(known)
    if len(known) and (steps_s > 0.0).mean() >= MIN_RISING_SHARE:
        return ScanStamps(stamps=in_seconds, warnings=tuple(warnings))
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


def _in_seconds(stamps: FloatArray) -> tuple[FloatArray, str]:
    """Stamps (n,) [s], and the unit of `UNITS` that they were in; empty: they were seconds."""
    known = stamps[np.isfinite(stamps)]
    if len(known) <= MIN_STEPS:
        return stamps, ""
    usual = float(np.median(np.abs(np.diff(known))))
    if not usual > LONGEST_USUAL_STEP_S:
        return stamps, ""
    for unit, second in UNITS.items():
        if usual * second <= LONGEST_USUAL_STEP_S:
            return stamps * second, unit
    return stamps, ""


def unwrap(stamps: FloatArray) -> Unwrapped:
    """Undo the wraps of a 32-bit counter, signed or not, of seconds or parts of them; NaN may be among the stamps."""
    is_known = np.isfinite(stamps)
    known = stamps[is_known]
    if len(known) < 2:
        return Unwrapped(stamps, "", 0)
    steps_s = np.diff(known)
    usual_s = float(np.median(np.abs(steps_s)))
    for (unit, period_s), is_signed in product(COUNTERS.items(), (False, True)):
        near_s = min(max(ROUNDING * period_s, MAX_STEPS_AT_WRAP * usual_s), 0.25 * period_s)
        counted = known + 0.5 * period_s if is_signed else known
        if counted.min() < -near_s or counted.max() > period_s + near_s or usual_s > 0.05 * period_s:
            continue
        is_low, is_high = np.abs(counted) <= near_s, np.abs(counted - period_s) <= near_s
        is_down = is_high[:-1] & is_low[1:]
        # a counter below zero; of others it might be a pause
        is_up = is_low[:-1] & is_high[1:] & (unit == "s" and not is_signed)
        n_wraps = int(np.count_nonzero(is_down | is_up))
        if n_wraps:
            turns = np.cumsum(is_down.astype(np.int64) - is_up.astype(np.int64))
            whole = stamps.copy()
            whole[is_known] = known + period_s * np.concatenate([[0], turns])
            return Unwrapped(whole, unit, n_wraps)
    return Unwrapped(stamps, "", 0)
