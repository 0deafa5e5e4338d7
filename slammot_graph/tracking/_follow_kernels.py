"""Kernels of all that the segment tracker does at a scan: find segments, predict, join, correct, begin and end tracks.

The tracks are columns of numbers with room for more; the first n entries of each are those that there are, the older
ones first.
"""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking._kernels import correct, predict
from slammot_graph.tracking._segment_kernels import (
    N_POINTS,
    N_PROVEN,
    X,
    Y,
    assign,
    beams_by_track,
    drop_weak,
    find_segments,
    find_twins,
    group_unowned,
    measure,
    note_sightings,
)
from slammot_graph.tracking._sight_kernels import EMPTY, PRESENT, find_standing, sight_at

ID, N_HITS, N_ALONE, SIGHT = range(4)
"""Rows of the whole numbers (4, n): identity, sightings, those with no other track near, what the laser sees there."""

MISSED_S, EMPTY_S, UNPROVEN_S, TWIN_S = range(4)
"""Rows of the times (4, n) [s]: since the last sighting; of it, seen through; of sightings since the last one that free
cells proved; on the place of an older track."""

HAS_DISPLACED, IS_SHOWN = range(2)
"""Rows of the flags (2, n)."""

PUSH = 0.25 * math.pi
"""The near side of a circle of width w lies ``PUSH * w / 2`` before its centre in the mean."""

(
    ACCELERATION_STD, LEG_VARIANCE, BODY_VARIANCE, START_SPEED_VARIANCE, GATE, MAX_JUMP, SEGMENT_GAP, STANDING_REACH,
    STANDING_GAP, STANDING_SPEED, LEG_WIDTH, BODY, APART, TWIN, MAX_TWIN_S, N_CONFIRM, SHOWN_S, MAX_EMPTY_S,
    MAX_UNPROVEN_S, MIN_UNPROVEN_POINTS, MAX_MISSED_S, MIN_DISTANCE,
) = range(22)  # fmt: skip
"""Entries of the limits (22,): the tracker's configuration as numbers."""

EXPECTED_S = 1.0
"""An object that has displaced is expected for so long after a sighting [s]."""


@kernel
def follow_scan(
    points: FloatArray,
    packed_cov: FloatArray,
    moving_cluster: IntArray,
    is_free: BoolArray,
    T_laser: FloatArray,
    angle_min: float,
    angle_increment: float,
    ranges: FloatArray,
    is_valid: BoolArray,
    is_no_return: BoolArray,
    dt: float,
    limits: FloatArray,
    n: int,
    next_id: int,
    states: FloatArray,
    covs: FloatArray,
    starts: FloatArray,
    whole: IntArray,
    times: FloatArray,
    flags: BoolArray,
    seen: FloatArray,
    beam_starts: IntArray,
    beams: IntArray,
    is_displaced: BoolArray,
) -> tuple[int, int, int]:
    """Find the segments of a scan (see `ScanView`), those of who stands included, and `follow` them."""
    n_beams = points.shape[0]
    cluster = moving_cluster
    is_proven = is_free
    standing = np.empty((n, 2))
    n_standing = 0
    for t in range(n):
        if flags[HAS_DISPLACED, t] and math.hypot(states[t, 2], states[t, 3]) < limits[STANDING_SPEED]:
            standing[n_standing, 0] = states[t, 0]
            standing[n_standing, 1] = states[t, 1]
            n_standing += 1
    if n_standing > 0:
        cluster = np.empty(n_beams, dtype=np.int64)
        find_standing(
            points, is_valid, moving_cluster, standing[:n_standing], limits[STANDING_REACH], limits[STANDING_GAP],
            cluster,
        )  # fmt: skip
        is_proven = np.empty(n_beams, dtype=np.bool_)
        for k in range(n_beams):
            is_proven[k] = is_free[k] or cluster[k] > moving_cluster[k]
    segment = np.empty(n_beams, dtype=np.int64)
    table = np.empty((n_beams, 8))
    n_segments = find_segments(
        points, packed_cov, cluster, is_proven, T_laser[0], T_laser[1], angle_increment, limits[SEGMENT_GAP], PUSH,
        limits[LEG_WIDTH], segment, table,
    )  # fmt: skip
    return follow(
        table[:n_segments], segment, True, T_laser, angle_min, angle_increment, ranges, is_valid, is_no_return, dt,
        limits, n, next_id, states, covs, starts, whole, times, flags, seen, beam_starts, beams, is_displaced,
    )  # fmt: skip


@kernel
def follow(
    table: FloatArray,
    segment: IntArray,
    has_view: bool,
    T_laser: FloatArray,
    angle_min: float,
    angle_increment: float,
    ranges: FloatArray,
    is_valid: BoolArray,
    is_no_return: BoolArray,
    dt: float,
    limits: FloatArray,
    n: int,
    next_id: int,
    states: FloatArray,
    covs: FloatArray,
    starts: FloatArray,
    whole: IntArray,
    times: FloatArray,
    flags: BoolArray,
    seen: FloatArray,
    beam_starts: IntArray,
    beams: IntArray,
    is_displaced: BoolArray,
) -> tuple[int, int, int]:
    """Predict the n tracks over `dt` [s], join, correct, begin and end them by the segments (k, 8) of a scan.

    Without a view (`has_view`) a track that was not sighted counts as seen through. Columns need room for k more. Fills
    `seen` with a row for each sighting: identity, x, y [m], xx, xy, yy [m^2], extent [m]; `beams` with those of track 0,
    1 and so on, those of track t from ``beam_starts[t]`` to ``beam_starts[t + 1]``; and `is_displaced`, the beams
    on objects that have displaced. Returns the numbers of tracks, of the next identity, and of sightings.
    """
    k = table.shape[0]
    primary = np.full(n, -1)
    owner = np.full(k, -1)
    if n > 0:
        predict(states[:n], covs[:n], dt, limits[ACCELERATION_STD])
    n_seen = 0
    if n > 0 and k > 0:
        n_seen = _join(table, limits, n, states, covs, whole, primary, owner, seen)
    is_hit = np.empty(n, dtype=np.bool_)
    note_sightings(
        primary, owner, table, dt, states[:n], starts[:n], int(limits[N_CONFIRM]), limits[MIN_DISTANCE], is_hit,
        whole[N_HITS][:n], times[MISSED_S][:n], times[UNPROVEN_S][:n], flags[HAS_DISPLACED][:n],
    )  # fmt: skip
    for t in range(n):
        whole[SIGHT, t] = PRESENT
        if is_hit[t]:
            times[EMPTY_S, t] = 0.0
            continue
        if has_view:
            sight_at(
                states[t : t + 1], T_laser, angle_min, angle_increment, ranges, is_valid, is_no_return,
                limits[LEG_WIDTH], whole[SIGHT][t : t + 1],
            )  # fmt: skip
        else:
            whole[SIGHT, t] = EMPTY
        if whole[SIGHT, t] == EMPTY:
            times[EMPTY_S, t] += dt
    is_ended = np.empty(n, dtype=np.bool_)
    find_twins(
        states[:n], is_hit, dt, limits[APART], limits[BODY], limits[TWIN], limits[MAX_TWIN_S], whole[N_ALONE][:n],
        times[TWIN_S][:n], is_ended,
    )  # fmt: skip
    for t in range(n):
        is_ended[t] = (
            is_ended[t]
            or times[EMPTY_S, t] > limits[MAX_EMPTY_S]
            or times[MISSED_S, t] > limits[MAX_MISSED_S]
            or times[UNPROVEN_S, t] > limits[MAX_UNPROVEN_S]
            or (whole[N_HITS, t] < limits[N_CONFIRM] and times[MISSED_S, t] > limits[SHOWN_S])
        )
    n_born = _begin(table, limits, n, next_id, is_ended, states, covs, starts, whole, times, flags, owner, seen[n_seen:])
    kept = _compact(n, n_born, is_ended, states, covs, starts, whole, times, flags, owner)
    beams_by_track(segment, owner, beam_starts[: kept + 1], beams)
    for b in range(segment.shape[0]):
        t = owner[segment[b]] if segment[b] >= 0 else -1
        is_displaced[b] = t >= 0 and flags[HAS_DISPLACED, t]
    for t in range(kept):
        flags[IS_SHOWN, t] = (
            whole[N_HITS, t] >= limits[N_CONFIRM]
            and times[MISSED_S, t] <= limits[SHOWN_S]
            and whole[SIGHT, t] != EMPTY
        )
    return kept, next_id + n_born, n_seen + n_born


@kernel
def _join(
    table: FloatArray,
    limits: FloatArray,
    n: int,
    states: FloatArray,
    covs: FloatArray,
    whole: IntArray,
    primary: IntArray,
    owner: IntArray,
    seen: FloatArray,
) -> int:
    """Join segments to the n tracks and correct them; fills the first rows of `seen` and returns their number."""
    level = np.empty(n, dtype=np.int64)
    for t in range(n):
        level[t] = 0 if whole[N_HITS, t] >= limits[N_CONFIRM] else 1
    assign(
        states[:n], covs[:n], level, table, limits[LEG_VARIANCE], limits[GATE], limits[MAX_JUMP], limits[BODY],
        primary, owner,
    )  # fmt: skip
    places, noise = np.empty((n, 2)), np.empty((n, 2, 2))
    n_joined, sizes = np.empty(n, dtype=np.int64), np.empty(n)
    measure(
        table, owner, limits[LEG_WIDTH], limits[LEG_VARIANCE], limits[BODY_VARIANCE], places, noise, n_joined, sizes
    )
    drop_weak(table, owner, int(limits[MIN_UNPROVEN_POINTS]), primary, n_joined)
    of = np.empty(n, dtype=np.int64)
    n_seen = 0
    for t in range(n):
        of[t] = t if n_joined[t] > 0 else -1
        if of[t] >= 0:
            _note(seen[n_seen], whole[ID, t], places[t], noise[t], sizes[t])
            n_seen += 1
    correct(states[:n], covs[:n], places, noise, of)
    return n_seen


@kernel
def _note(row: FloatArray, number: int, place: FloatArray, noise: FloatArray, size: float) -> None:
    row[0] = number
    row[1] = place[0]
    row[2] = place[1]
    row[3] = noise[0, 0]
    row[4] = noise[0, 1]
    row[5] = noise[1, 1]
    row[6] = size


@kernel
def _begin(
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
        measure(table, own, limits[LEG_WIDTH], limits[LEG_VARIANCE], limits[BODY_VARIANCE], place, noise, n_joined, size)
        t = n + n_born
        states[t] = 0.0
        covs[t] = 0.0
        whole[:, t] = 0
        times[:, t] = 0.0
        flags[:, t] = False
        for i in range(2):
            states[t, i] = starts[t, i] = place[0, i]
            covs[t, i + 2, i + 2] = limits[START_SPEED_VARIANCE]
            for j in range(2):
                covs[t, i, j] = noise[0, i, j]
        whole[ID, t] = next_id + n_born
        whole[N_HITS, t] = 1
        _note(seen[n_born], next_id + n_born, place[0], noise[0], size[0])
        for s in range(k):
            if own[s] == 0:
                owner[s] = t
        n_born += 1
    return n_born


@kernel
def _compact(
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
