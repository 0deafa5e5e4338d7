"""When each beam of a sweeping laser was sent out, by what a log says of it, where that can be right."""

import math
from dataclasses import dataclass

import numpy as np

from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import FloatArray

MAX_SWEEP = 1.05
"""A sweep that lasts longer than so many times from scan to scan cannot be: the next one would begin before its end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SweepTimes:
    """Times (n_beams,) of the beams since the stamp [s], None where they are sent out at once, and warnings."""

    beam_times: FloatArray | None = None
    warnings: tuple[str, ...] = ()


def sweep_times(time_increment_s: float, stamps: FloatArray, laser: LaserModel, told_by: str) -> SweepTimes:
    """Judge the time between beams that a log gives, and make beam times of it.

    Zero means a snapshot: cameras, simulators and old drivers say so. A negative, infinite or too long one cannot be
    right, but tells of a laser that sweeps: its beams are spread over the part of a turn that they cover.

    Parameters
    ----------
    time_increment_s : float
    stamps : (n,) array
        Of the scans [s]; NaN may be among them.
    laser : LaserModel
    told_by : str
        What gives it, for messages.
    """
    if time_increment_s == 0.0 or laser.n_beams < 2:
        return SweepTimes()
    beams = np.arange(laser.n_beams, dtype=np.float64)
    steps_s = np.diff(stamps)
    steps_s = steps_s[steps_s > 0.0]
    period_s = float(np.median(steps_s)) if len(steps_s) else math.inf
    sweep_s = time_increment_s * (laser.n_beams - 1)
    if 0.0 < sweep_s <= MAX_SWEEP * period_s and math.isfinite(sweep_s):
        return SweepTimes(beam_times=time_increment_s * beams)
    if not math.isfinite(time_increment_s):
        what = "is not finite"
    elif time_increment_s < 0.0:
        what = f"is negative ({time_increment_s:g} s)"
    else:
        what = f"makes a sweep of {sweep_s:.3g} s, longer than the {period_s:.3g} s from scan to scan"
    if not math.isfinite(period_s):
        return SweepTimes(
            warnings=(
                f"{told_by} {what}; the beams count as sent out at once: correct the driver or the log",
            )
        )
    turn_share = min(laser.field_of_view_rad / (2.0 * math.pi), 1.0)
    guessed_s = period_s * turn_share / (laser.n_beams - 1)
    return SweepTimes(
        beam_times=guessed_s * beams,
        warnings=(
            f"{told_by} {what}; {guessed_s:.3g} s between beams is used instead, as of a laser that turns once a scan:"
            " correct the driver or the log",
        ),
    )
