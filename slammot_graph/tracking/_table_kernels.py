"""Kernels of the table of tracks: what its columns mean, how tracks begin and end in it, and how it is read."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking._kernels import carry_track
from slammot_graph.tracking._segment_kernels import N_POINTS, N_PROVEN, X, Y, group_unowned, measure

ID, N_HITS, N_ALONE, SIGHT, N_ON_FREE = range(5)
"""Rows of the whole numbers (5, n): identity, sightings (strong ones twice), those with no other track near, what the
laser sees there, sightings of which at least half the points were on free cells."""

MISSED_S, EMPTY_S, UNPROVEN_S, TWIN_S, NOISE, NOISE_OF_LEG = range(6)
"""Rows of the times (6, n) [s]: since the last sighting; of it, seen through; of sightings since the last one that free
cells proved; on the place of an older track; and, no times, the learnt factors on the variance of a track's sightings
of a body and of a leg."""

HAS_DISPLACED, IS_SHOWN = range(2)
"""Rows of the flags (2, n)."""

(
    ACCELERATION_STD, LEG_VARIANCE, BODY_VARIANCE, START_SPEED_VARIANCE, GATE, MAX_JUMP, SEGMENT_GAP, STANDING_REACH,
    STANDING_GAP, STANDING_SPEED, LEG_WIDTH, BODY, APART, TWIN, MAX_TWIN_S, N_CONFIRM, SHOWN_S, MAX_EMPTY_S,
    MAX_UNPROVEN_S, MIN_UNPROVEN_POINTS, MAX_MISSED_S, MIN_DISTANCE,
    STANDING_DISTANCE, MIN_ON_FREE, STRONG_POINTS, NEAR_VARIANCE, NOISE_GAIN,
) = range(27)  # fmt: skip
"""Entries of the limits (27,): the tracker's configuration as numbers."""

EXPECTED_S = 1.0
"""An object that has displaced is expected for so long after a sighting [s]."""


@kernel
def note(row: FloatArray, number: int, place: FloatArray, noise: FloatArray, size: float) -> None:
    row[0] = number
    row[1] = place[0]
    row[2] = place[1]
    row[3] = noise[0, 0]
    row[4] = noise[0, 1]
    row[5] = noise[1, 1]
    row[6] = size


@kernel
def begin(
    table: FloatArray,
    limits: FloatArray,
    n: int,
    next_id: int,
    is_ended: BoolArray,
    states: FloatArray,
    covs: FloatArray,
    starts: FloatArray,
    whole: IntArray,
    times: FloatArray,
    flags: BoolArray,
    owner: IntArray,
    seen: FloatArray,
) -> int:
    """Begin tracks with segments that belong to none and are not beside an object that is followed; their number."""
    k = table.shape[0]
    is_free = np.empty(k, dtype=np.bool_)
    is_any = False
    for s in range(k):
        is_free[s] = owner[s] < 0
        for t in range(n):
            if is_free[s] and not is_ended[t] and times[MISSED_S, t] == 0.0:
                away = math.hypot(table[s, X] - states[t, 0], table[s, Y] - states[t, 1])
                is_free[s] = away > limits[APART]
        is_any = is_any or is_free[s]
    if not is_any:
        return 0
    group = np.empty(k, dtype=np.int64)
    n_groups = group_unowned(table, is_free, limits[BODY], group)
    own, n_joined = np.empty(k, dtype=np.int64), np.empty(1, dtype=np.int64)
    place, noise, size = np.empty((1, 2)), np.empty((1, 2, 2)), np.empty(1)
    kind = np.empty(1, dtype=np.int64)
    n_born = 0
    for g in range(n_groups):
        n_points = n_proven = 0.0
        for s in range(k):
            own[s] = 0 if group[s] == g else -1
            if group[s] == g:
                n_points += table[s, N_POINTS]
                n_proven += table[s, N_PROVEN]
        if n_proven == 0.0 or n_points < 2.0:
            continue
        measure(
            table,
            own,
            limits[LEG_WIDTH],
            limits[LEG_VARIANCE],
            limits[BODY_VARIANCE],
            place,
            noise,
            n_joined,
            size,
            kind,
        )
        t = n + n_born
        states[t] = 0.0
        covs[t] = 0.0
        whole[:, t] = 0
        times[:, t] = 0.0
        flags[:, t] = False
        times[NOISE, t] = times[NOISE_OF_LEG, t] = 1.0
        for i in range(2):
            states[t, i] = starts[t, i] = place[0, i]
            covs[t, i + 2, i + 2] = limits[START_SPEED_VARIANCE]
            for j in range(2):
                covs[t, i, j] = noise[0, i, j]
        whole[ID, t] = next_id + n_born
        whole[N_HITS, t] = 2 if n_proven >= limits[STRONG_POINTS] and size[0] <= limits[BODY] else 1
        note(seen[n_born], next_id + n_born, place[0], noise[0], size[0])
        for s in range(k):
            if own[s] == 0:
                owner[s] = t
        n_born += 1
    return n_born


@kernel
def compact(
    n: int,
    n_born: int,
    is_ended: BoolArray,
    states: FloatArray,
    covs: FloatArray,
    starts: FloatArray,
    whole: IntArray,
    times: FloatArray,
    flags: BoolArray,
    owner: IntArray,
) -> int:
    """Close the gaps that ended tracks leave, also in `owner`; returns the number of tracks."""
    to = np.empty(n + n_born, dtype=np.int64)
    kept = 0
    for t in range(n + n_born):
        to[t] = -1
        if t < n and is_ended[t]:
            continue
        to[t] = kept
        if kept < t:
            states[kept] = states[t]
            covs[kept] = covs[t]
            starts[kept] = starts[t]
            whole[:, kept] = whole[:, t]
            times[:, kept] = times[:, t]
            flags[:, kept] = flags[:, t]
        kept += 1
    for s in range(owner.shape[0]):
        if owner[s] >= 0:
            owner[s] = to[owner[s]]
    return kept


@kernel
def expected_places(
    n: int, dt: float, states: FloatArray, times: FloatArray, flags: BoolArray, out: FloatArray
) -> int:
    """Fill `out` with where those of the n objects that have displaced and were seen of late are `dt` [s] later."""
    n_out = 0
    for t in range(n):
        if flags[HAS_DISPLACED, t] and times[MISSED_S, t] <= EXPECTED_S:
            out[n_out, 0] = states[t, 0] + dt * states[t, 2]
            out[n_out, 1] = states[t, 1] + dt * states[t, 3]
            n_out += 1
    return n_out


@kernel
def list_shown(
    n: int,
    states: FloatArray,
    covs: FloatArray,
    whole: IntArray,
    flags: BoolArray,
    beam_starts: IntArray,
    T_a_b: FloatArray,
    which: IntArray,
    motion: FloatArray,
    place_covs: FloatArray,
) -> None:
    """List the tracks that are to be shown in a frame a in which theirs lies at (3,).

    Fills `which` (m, 3) with identity and first and last place of their beams, `motion` (m, 4) with x, y, vx, vy, and
    `place_covs` (m, 2, 2).
    """
    m = 0
    for t in range(n):
        if not flags[IS_SHOWN, t]:
            continue
        which[m, 0] = whole[ID, t]
        which[m, 1] = beam_starts[t]
        which[m, 2] = beam_starts[t + 1]
        carry_track(states[t], covs[t], T_a_b, motion[m], place_covs[m])
        m += 1


@kernel
def measure_thickness(
    points: FloatArray, n: int, whole: IntArray, beam_starts: IntArray, beams: IntArray, seen: FloatArray
) -> None:
    """Fill the last column of `seen` (m, 8) with how far the points of each sighting lie off their line, rms [m].

    NaN with fewer than 5 points. The sightings are those of some of the n tracks.
    """
    for m in range(seen.shape[0]):
        seen[m, 7] = np.nan
        for t in range(n):
            if whole[ID, t] != seen[m, 0]:
                continue
            first = beam_starts[t]
            count = beam_starts[t + 1] - first
            if count < 5:
                break
            x = y = 0.0
            for b in range(first, first + count):
                x += points[beams[b], 0] / count
                y += points[beams[b], 1] / count
            xx = xy = yy = 0.0
            for b in range(first, first + count):
                dx = points[beams[b], 0] - x
                dy = points[beams[b], 1] - y
                xx += dx * dx / count
                xy += dx * dy / count
                yy += dy * dy / count
            least = 0.5 * (xx + yy) - math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
            seen[m, 7] = math.sqrt(max(least, 0.0))
            break
