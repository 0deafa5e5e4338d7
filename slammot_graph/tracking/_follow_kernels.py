"""Kernels of all that the segment tracker does at a scan: find segments, predict, join, correct, begin and end tracks.

The tracks are columns of numbers with room for more; the first n entries of each are those that there are, the older
ones first.
"""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking._kernels import correct, predict
from slammot_graph.tracking._noise_kernels import blur_bodies, learn_noise
from slammot_graph.tracking._segment_kernels import (
    N_POINTS,
    N_PROVEN,
    assign,
    beams_by_track,
    drop_weak,
    find_segments,
    find_twins,
    measure,
    note_sightings,
)
from slammot_graph.tracking._sight_kernels import EMPTY, PRESENT, find_standing, sight_at
from slammot_graph.tracking._table_kernels import (
    ACCELERATION_STD,
    APART,
    BODY,
    BODY_VARIANCE,
    EMPTY_S,
    GATE,
    HAS_DISPLACED,
    ID,
    IS_SHOWN,
    LEG_VARIANCE,
    LEG_WIDTH,
    MAX_EMPTY_S,
    MAX_JUMP,
    MAX_MISSED_S,
    MAX_TWIN_S,
    MAX_UNPROVEN_S,
    MIN_DISTANCE,
    MIN_ON_FREE,
    MIN_UNPROVEN_POINTS,
    MISSED_S,
    N_ALONE,
    N_CONFIRM,
    N_HITS,
    N_ON_FREE,
    NEAR_VARIANCE,
    NOISE,
    NOISE_GAIN,
    SEGMENT_GAP,
    SHOWN_S,
    SIGHT,
    STANDING_DISTANCE,
    STANDING_GAP,
    STANDING_REACH,
    STANDING_SPEED,
    STRONG_POINTS,
    TWIN,
    TWIN_S,
    UNPROVEN_S,
    begin,
    compact,
    measure_thickness,
    note,
)

PUSH = 0.25 * math.pi
"""The near side of a circle of width w lies ``PUSH * w / 2`` before its centre in the mean."""


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
    no_return: float,
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
    on_objects: BoolArray,
) -> tuple[int, int, int, int]:
    """Find the segments of a scan (see `ScanView`), those of who stands included, and `follow` them."""
    n_beams = points.shape[0]
    cluster = moving_cluster
    is_proven = is_free
    standing = np.empty((n, 2))
    n_standing = 0
    for t in range(n):
        away = math.hypot(states[t, 0] - starts[t, 0], states[t, 1] - starts[t, 1])
        has_walked = flags[HAS_DISPLACED, t] or (
            whole[N_HITS, t] >= limits[N_CONFIRM]
            and (away >= limits[STANDING_DISTANCE] or whole[N_ON_FREE, t] >= limits[MIN_ON_FREE])
        )
        if has_walked and math.hypot(states[t, 2], states[t, 3]) < limits[STANDING_SPEED]:
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
    done = follow(
        table[:n_segments], segment, True, T_laser, angle_min, angle_increment, ranges, is_valid, no_return, dt,
        limits, n, next_id, states, covs, starts, whole, times, flags, seen, beam_starts, beams, on_objects,
    )  # fmt: skip
    measure_thickness(points, done[0], whole, beam_starts, beams, seen[: done[2]])
    return done


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
    no_return: float,
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
    on_objects: BoolArray,
) -> tuple[int, int, int, int]:
    """Predict the n tracks over `dt` [s], join, correct, begin and end them by the segments (k, 8) of a scan.

    Without a view (`has_view`) a track that was not sighted counts as seen through. Columns need room for k more. Fills
    `seen` with a row for each sighting: identity, x, y [m], xx, xy, yy [m^2], extent [m]; `beams` with those of track
    0, 1 and so on, those of track t from ``beam_starts[t]`` to ``beam_starts[t + 1]``; and `on_objects` (2, n) with the
    beams on objects that have displaced, and on those that have or stood on free cells for long. Returns the number of
    tracks, the next identity, the numbers of sightings and of tracks
    that are to be shown.
    """
    k = table.shape[0]
    primary = np.full(n, -1)
    owner = np.full(k, -1)
    if n > 0:
        predict(states[:n], covs[:n], dt, limits[ACCELERATION_STD])
    n_seen = 0
    if n > 0 and k > 0:
        n_seen = _join(table, limits, n, states, covs, whole, times, primary, owner, seen)
    is_hit = np.empty(n, dtype=np.bool_)
    note_sightings(
        primary, owner, table, dt, states[:n], starts[:n], int(limits[N_CONFIRM]), limits[MIN_DISTANCE],
        limits[STRONG_POINTS], limits[BODY], is_hit,
        whole[N_HITS][:n], times[MISSED_S][:n], times[UNPROVEN_S][:n], flags[HAS_DISPLACED][:n],
    )  # fmt: skip
    for t in range(n):
        whole[SIGHT, t] = PRESENT
        if is_hit[t]:
            times[EMPTY_S, t] = 0.0
            continue
        if has_view:
            sight_at(
                states[t : t + 1], T_laser, angle_min, angle_increment, ranges, is_valid, no_return,
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
    _count_on_free(table, owner, whole[N_ON_FREE][:n])
    n_born = begin(
        table, limits, n, next_id, is_ended, states, covs, starts, whole, times, flags, owner, seen[n_seen:]
    )
    kept = compact(n, n_born, is_ended, states, covs, starts, whole, times, flags, owner)
    beams_by_track(segment, owner, beam_starts[: kept + 1], beams)
    for b in range(segment.shape[0]):
        t = owner[segment[b]] if segment[b] >= 0 else -1
        on_objects[0, b] = t >= 0 and flags[HAS_DISPLACED, t]
        on_objects[1, b] = on_objects[0, b] or (t >= 0 and whole[N_ON_FREE, t] >= limits[MIN_ON_FREE])
    n_shown = 0
    for t in range(kept):
        flags[IS_SHOWN, t] = (
            whole[N_HITS, t] >= limits[N_CONFIRM]
            and times[MISSED_S, t] <= limits[SHOWN_S]
            and whole[SIGHT, t] != EMPTY
        )
        n_shown += flags[IS_SHOWN, t]
    return kept, next_id + n_born, n_seen + n_born, n_shown


@kernel
def _count_on_free(table: FloatArray, owner: IntArray, n_on_free: IntArray) -> None:
    """Count in `n_on_free` (n,) the sightings of which at least half the points were on free cells."""
    free = np.zeros(n_on_free.shape[0])
    for s in range(table.shape[0]):
        if owner[s] >= 0:
            free[owner[s]] += table[s, N_PROVEN] - 0.5 * table[s, N_POINTS]
    for t in range(n_on_free.shape[0]):
        is_seen = False
        for s in range(table.shape[0]):
            is_seen = is_seen or owner[s] == t
        if is_seen and free[t] >= 0.0:
            n_on_free[t] += 1


@kernel
def _join(
    table: FloatArray,
    limits: FloatArray,
    n: int,
    states: FloatArray,
    covs: FloatArray,
    whole: IntArray,
    times: FloatArray,
    primary: IntArray,
    owner: IntArray,
    seen: FloatArray,
) -> int:
    """Join segments to the n tracks and correct them; fills the first rows of `seen` and returns their number."""
    level = np.empty(n, dtype=np.int64)
    for t in range(n):
        is_followed = times[MISSED_S, t] <= limits[SHOWN_S]
        level[t] = 2 if whole[N_HITS, t] < limits[N_CONFIRM] else 0 if is_followed else 1
    assign(
        states[:n], covs[:n], level, table, limits[LEG_VARIANCE], limits[GATE], limits[MAX_JUMP], limits[BODY],
        primary, owner,
    )  # fmt: skip
    places, noise = np.empty((n, 2)), np.empty((n, 2, 2))
    n_joined, sizes, kinds = np.empty(n, dtype=np.int64), np.empty(n), np.empty(n, dtype=np.int64)
    measure(
        table,
        owner,
        limits[LEG_WIDTH],
        limits[LEG_VARIANCE],
        limits[BODY_VARIANCE],
        places,
        noise,
        n_joined,
        sizes,
        kinds,
    )
    drop_weak(table, owner, int(limits[MIN_UNPROVEN_POINTS]), primary, n_joined)
    blur_bodies(states[:n], kinds, sizes, limits[BODY], limits[NEAR_VARIANCE], noise)
    of = np.empty(n, dtype=np.int64)
    n_seen = 0
    for t in range(n):
        of[t] = t if n_joined[t] > 0 else -1
        if of[t] >= 0:
            note(seen[n_seen], whole[ID, t], places[t], noise[t], sizes[t])
            n_seen += 1
    factors = times[NOISE : NOISE + 2, :n]
    learn_noise(states[:n], covs[:n], places, of, kinds, limits[NOISE_GAIN], noise, factors)
    correct(states[:n], covs[:n], places, noise, of)
    return n_seen
