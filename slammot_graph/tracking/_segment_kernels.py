"""Kernels of the segment tracker: legs as segments of a scan, and their tracks."""

import math

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking._kernels import OUTSIDE, _innovation

N_POINTS, X, Y, WIDTH, COV_XX, COV_XY, COV_YY, N_PROVEN = range(8)
"""Columns of a table of segments."""

BODY_SEEN, LEG_SEEN = range(2)
"""What was seen of an object: both legs or a trunk, or one leg."""


@kernel
def find_segments(
    points: FloatArray,
    packed_cov: FloatArray,
    cluster: IntArray,
    is_proven: BoolArray,
    laser_x: float,
    laser_y: float,
    angle_increment: float,
    gap: float,
    push: float,
    max_push: float,
    segment: IntArray,
    table: FloatArray,
) -> int:
    """Split the moving beams (`cluster` >= 0) into segments: neighbours in the scan and nearer than `gap` [m].

    Fills `segment` (n,), -1 for other beams, and `table` (n, 8); returns the number of segments. The near side of a
    round thing of width w lies ``push * w / 2`` before its centre in the mean (pi / 4 for a circle seen in whole).
    """
    n = points.shape[0]
    n_segments = 0
    last = -2
    for k in range(n):
        segment[k] = -1
        if cluster[k] < 0:
            continue
        range_m = math.hypot(points[k, 0] - laser_x, points[k, 1] - laser_y)
        apart = max(gap, 2.2 * range_m * abs(angle_increment))
        if not (
            last == k - 1
            and math.hypot(points[k, 0] - points[last, 0], points[k, 1] - points[last, 1]) <= apart
        ):
            table[n_segments] = 0.0
            n_segments += 1
        s = n_segments - 1
        segment[k] = s
        last = k
        table[s, N_POINTS] += 1.0
        table[s, X] += points[k, 0]
        table[s, Y] += points[k, 1]
        table[s, COV_XX] += packed_cov[k, 0]
        table[s, COV_XY] += packed_cov[k, 1]
        table[s, COV_YY] += packed_cov[k, 2]
        if is_proven[k]:
            table[s, N_PROVEN] += 1.0
    first = 0
    for s in range(n_segments):
        while segment[first] != s:
            first += 1
        end = first
        while end + 1 < n and segment[end + 1] == s:
            end += 1
        count = table[s, N_POINTS]
        for c in (X, Y, COV_XX, COV_XY, COV_YY):
            table[s, c] /= count
        dx = table[s, X] - laser_x
        dy = table[s, Y] - laser_y
        range_m = max(math.hypot(dx, dy), 1e-6)
        width = math.hypot(points[end, 0] - points[first, 0], points[end, 1] - points[first, 1])
        table[s, WIDTH] = width + range_m * abs(angle_increment)
        behind = min(push * 0.5 * table[s, WIDTH], max_push) / range_m
        table[s, X] += behind * dx
        table[s, Y] += behind * dy
        first = end
    return n_segments


@kernel
def _distance2(
    states: FloatArray, covs: FloatArray, table: FloatArray, t: int, s: int, variance: float
) -> tuple[float, float]:
    """Squared Mahalanobis distance of a segment to a track, and the log of the determinant of its covariance."""
    noise = np.empty((2, 2))
    noise[0, 0] = table[s, COV_XX] + variance
    noise[0, 1] = noise[1, 0] = table[s, COV_XY]
    noise[1, 1] = table[s, COV_YY] + variance
    u, var_u, w, var_w, _ = _innovation(states[t], covs[t], table[s, X : Y + 1], noise)
    return u * u / var_u + w * w / var_w, math.log(var_u * var_w)


@kernel
def assign(
    states: FloatArray,
    covs: FloatArray,
    level: IntArray,
    table: FloatArray,
    leg_variance: float,
    gate: float,
    max_jump: float,
    body: float,
    primary: IntArray,
    owner: IntArray,
) -> None:
    """Give each track its nearest segment and what belongs to the same body, level by level (0, 1, 2).

    Nearest is the least ``d2 + ln det S``: a track that does not know where its object is must not take what one that
    knows follows. Fills `primary` (n,) with a segment or -1 and `owner` (k,) with a
    track or -1: a segment within `body` [m] of a track's first one and in its gate is joined to it.
    """
    n = states.shape[0]
    k = table.shape[0]
    primary[:] = -1
    owner[:] = -1
    d2 = np.empty((n, k))
    cost = np.empty((n, k))
    for t in range(n):
        for s in range(k):
            dx = table[s, X] - states[t, 0]
            dy = table[s, Y] - states[t, 1]
            d2[t, s] = cost[t, s] = OUTSIDE
            if dx * dx + dy * dy > max_jump * max_jump:
                continue
            distance2, log_det = _distance2(states, covs, table, t, s, leg_variance)
            if distance2 <= gate:
                d2[t, s] = distance2
                cost[t, s] = distance2 + log_det
    for now in range(3):
        while True:
            least = OUTSIDE
            best_t = best_s = -1
            for t in range(n):
                if level[t] != now or primary[t] >= 0:
                    continue
                for s in range(k):
                    if owner[s] < 0 and cost[t, s] < least:
                        least = cost[t, s]
                        best_t = t
                        best_s = s
            if best_t < 0:
                break
            primary[best_t] = best_s
            owner[best_s] = best_t
        _join_bodies(table, d2, level, now, body, primary, owner)


@kernel
def _join_bodies(
    table: FloatArray,
    d2: FloatArray,
    level: IntArray,
    now: int,
    body: float,
    primary: IntArray,
    owner: IntArray,
) -> None:
    for s in range(table.shape[0]):
        if owner[s] >= 0:
            continue
        least = OUTSIDE
        for t in range(primary.shape[0]):
            p = primary[t]
            if p < 0 or level[t] != now or d2[t, s] >= least:
                continue
            dx = table[s, X] - table[p, X]
            dy = table[s, Y] - table[p, Y]
            if dx * dx + dy * dy <= body * body:
                least = d2[t, s]
                owner[s] = t


@kernel
def measure(
    table: FloatArray,
    owner: IntArray,
    leg_width: float,
    leg_variance: float,
    both_variance: float,
    centres: FloatArray,
    noise: FloatArray,
    n_joined: IntArray,
    sizes: FloatArray,
    kinds: IntArray,
) -> None:
    """Centre of each track's object from its segments: the middle of both legs, or what one leg or a trunk tells.

    Fills `centres` (n, 2), `noise` (n, 2, 2) and `n_joined` (n,), the number of segments, and
    `sizes` (n,) with the extent of what was seen [m], and `kinds` (n,) with `BODY_SEEN` or `LEG_SEEN`.
    """
    n = centres.shape[0]
    wide = np.zeros(n)
    sizes[:] = 0.0
    centres[:] = 0.0
    noise[:] = 0.0
    n_joined[:] = 0
    for s in range(table.shape[0]):
        t = owner[s]
        if t < 0:
            continue
        n_joined[t] += 1
        centres[t, 0] += table[s, X]
        centres[t, 1] += table[s, Y]
        noise[t, 0, 0] += table[s, COV_XX]
        noise[t, 0, 1] += table[s, COV_XY]
        noise[t, 1, 1] += table[s, COV_YY]
        wide[t] = max(wide[t], table[s, WIDTH])
        sizes[t] = max(sizes[t], table[s, WIDTH])
        for other in range(s):
            if owner[other] == t:
                apart = math.hypot(table[s, X] - table[other, X], table[s, Y] - table[other, Y])
                sizes[t] = max(sizes[t], apart + 0.5 * (table[s, WIDTH] + table[other, WIDTH]))
    for t in range(n):
        if n_joined[t] == 0:
            continue
        m = n_joined[t]
        kinds[t] = BODY_SEEN if m > 1 or wide[t] > leg_width else LEG_SEEN
        variance = both_variance if kinds[t] == BODY_SEEN else leg_variance
        centres[t] /= m
        noise[t] /= m
        noise[t, 1, 0] = noise[t, 0, 1]
        noise[t, 0, 0] += variance
        noise[t, 1, 1] += variance


@kernel
def drop_weak(
    table: FloatArray, owner: IntArray, min_points: int, primary: IntArray, n_joined: IntArray
) -> None:
    """Take back sightings of fewer than `min_points` points of which none is on free cells."""
    n_points = np.zeros(primary.shape[0])
    n_proven = np.zeros(primary.shape[0])
    for s in range(table.shape[0]):
        if owner[s] >= 0:
            n_points[owner[s]] += table[s, N_POINTS]
            n_proven[owner[s]] += table[s, N_PROVEN]
    for t in range(primary.shape[0]):
        if primary[t] >= 0 and n_proven[t] == 0.0 and n_points[t] < min_points:
            primary[t] = -1
            n_joined[t] = 0
    for s in range(table.shape[0]):
        if owner[s] >= 0 and primary[owner[s]] < 0:
            owner[s] = -1


@kernel
def note_sightings(
    primary: IntArray,
    owner: IntArray,
    table: FloatArray,
    dt: float,
    states: FloatArray,
    starts: FloatArray,
    n_confirm: int,
    min_distance: float,
    strong_points: float,
    body: float,
    is_hit: BoolArray,
    n_hits: IntArray,
    missed_s: FloatArray,
    unproven_s: FloatArray,
    has_displaced: BoolArray,
) -> None:
    """Keep the books of the tracks after a scan `dt` [s] later: fills `is_hit` (n,) and updates the others.

    A sighting with `strong_points` on free cells counts for two, if it is no wider than a `body` [m].
    """
    n_proven = np.zeros(primary.shape[0])
    n_strong = np.zeros(primary.shape[0])
    for s in range(table.shape[0]):
        if owner[s] >= 0:
            n_proven[owner[s]] += table[s, N_PROVEN]
            n_strong[owner[s]] += table[s, N_PROVEN] if table[s, WIDTH] <= body else 0.0
    for t in range(primary.shape[0]):
        is_hit[t] = primary[t] >= 0
        if not is_hit[t]:
            missed_s[t] += dt
            continue
        n_hits[t] += 2 if n_strong[t] >= strong_points else 1
        missed_s[t] = 0.0
        unproven_s[t] = 0.0 if n_proven[t] > 0.0 else unproven_s[t] + dt
        distance = math.hypot(states[t, 0] - starts[t, 0], states[t, 1] - starts[t, 1])
        if distance >= min_distance and n_hits[t] >= n_confirm:
            has_displaced[t] = True


@kernel
def beams_by_track(segment: IntArray, owner: IntArray, starts: IntArray, beams: IntArray) -> None:
    """Fill `beams` with those of track 0, of track 1 and so on: of track t from ``starts[t]`` to ``starts[t + 1]``."""
    starts[:] = 0
    for k in range(segment.shape[0]):
        if segment[k] >= 0 and owner[segment[k]] >= 0:
            starts[owner[segment[k]] + 1] += 1
    for t in range(starts.shape[0] - 1):
        starts[t + 1] += starts[t]
    filled = starts[:-1].copy()
    for k in range(segment.shape[0]):
        if segment[k] >= 0 and owner[segment[k]] >= 0:
            t = owner[segment[k]]
            beams[filled[t]] = k
            filled[t] += 1


@kernel
def find_twins(
    states: FloatArray,
    is_hit: BoolArray,
    dt: float,
    apart: float,
    body: float,
    twin: float,
    max_twin_s: float,
    n_alone: IntArray,
    twin_s: FloatArray,
    is_twin: BoolArray,
) -> None:
    """Mark in `is_twin` (n,) the tracks on the place of an older one, which comes first.

    A track is one within `body` [m] of another if it had fewer than 5 sightings `apart` [m] from all others (counted in
    `n_alone`), or has been within `twin` [m] for more than `max_twin_s` (in `twin_s`, which runs back where it is not).
    """
    n = states.shape[0]
    for j in range(n):
        nearest = np.inf
        shares = False
        is_twin[j] = False
        for i in range(n):
            if i == j:
                continue
            distance = math.hypot(states[i, 0] - states[j, 0], states[i, 1] - states[j, 1])
            nearest = min(nearest, distance)
            if i < j and distance < body and not is_twin[i]:
                shares = shares or distance < twin
                is_twin[j] = is_twin[j] or twin_s[j] > max_twin_s or n_alone[j] < 5
        if is_hit[j] and nearest > apart:
            n_alone[j] += 1
        twin_s[j] = max(twin_s[j] + (dt if shares else -dt), 0.0)


@kernel
def group_unowned(table: FloatArray, is_unowned: BoolArray, gap: float, group: IntArray) -> int:
    """Group the segments that no track owns by distance; fills `group` (k,), -1 for owned; returns their number."""
    n_groups = 0
    for s in range(table.shape[0]):
        group[s] = -1
    for s in range(table.shape[0]):
        if not is_unowned[s] or group[s] >= 0:
            continue
        group[s] = n_groups
        has_grown = True
        while has_grown:
            has_grown = False
            for a in range(table.shape[0]):
                if group[a] != n_groups:
                    continue
                for b in range(table.shape[0]):
                    if (
                        is_unowned[b]
                        and group[b] < 0
                        and math.hypot(table[a, X] - table[b, X], table[a, Y] - table[b, Y]) <= gap
                    ):
                        group[b] = n_groups
                        has_grown = True
        n_groups += 1
    return n_groups
