"""Clocks that begin again within one bag, as when a simulation was restarted while it was recorded."""

import numpy as np

from slammot_graph.core.odometry_track import MAX_GAP_S
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.logs.scan_stamps import unwrap

N_AROUND = 5
"""So many stamps on either side tell whether a clock has gone back, or a stamp alone is wrong."""


def restarts(stamps: FloatArray) -> IntArray:
    """(m,) numbers of the stamps (n,) [s] in the order of recording from which on the clock has gone back for good.

    By more than odometry is interpolated over; a counter that wraps around does not count.
    """
    known = np.flatnonzero(np.isfinite(stamps))
    times = unwrap(stamps[known]).stamps
    found = []
    for k in (np.flatnonzero(np.diff(times) < -MAX_GAP_S) + 1).tolist():
        before, after = np.median(times[max(k - N_AROUND, 0) : k]), np.median(times[k : k + N_AROUND])
        if after < before - MAX_GAP_S and times[k : k + N_AROUND].max() < before:
            found.append(int(known[k]))
    return np.array(found, dtype=np.int64)


def told_restarts(scan_stamps: FloatArray, scan_bag_stamps: FloatArray, odometry_stamps: FloatArray) -> str:
    """Tell of a clock of scans and odometry that begins again while recording times go on; empty if it does not.

    Stamps of two such runs overlap: sorted by them, the odometry of one would come between that of the other.

    Parameters
    ----------
    scan_stamps, scan_bag_stamps : (n,) arrays
        Of one laser, in the order of recording, by the header and by the recorder [s].
    odometry_stamps : (m,) array
        By the header [s]; empty where there is no odometry.
    """
    of_scans = restarts(scan_stamps)
    if not len(of_scans) or len(restarts(scan_bag_stamps)):
        return ""
    if len(odometry_stamps) and len(restarts(odometry_stamps)) != len(of_scans):
        return ""
    back_s = max(scan_stamps[k - 1] - scan_stamps[k] for k in of_scans)
    times = "once" if len(of_scans) == 1 else f"{len(of_scans)} times"
    return (
        f"the clock of the headers begins again {times}, first at scan {of_scans[0]}, by up to {back_s:.4g} s, as that"
        f" of a simulation that was restarted: the bag holds {len(of_scans) + 1} runs, which follow each other by"
        " recording times; cut the bag to have one alone"
    )
