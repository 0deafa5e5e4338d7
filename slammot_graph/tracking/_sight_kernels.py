"""Kernels of what the laser sees at a place: someone who stands, something before it, nothing."""

import math

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray

PRESENT, OCCLUDED, OUT_OF_VIEW, EMPTY = range(4)
"""What the laser sees at a place: something there; something before it; it does not look there; it sees through."""


@kernel
def find_standing(
    points: FloatArray,
    is_valid: BoolArray,
    cluster: IntArray,
    places: FloatArray,
    reach: float,
    gap: float,
    out: IntArray,
) -> bool:
    """Add to the moving beams those of whoever stands at a place (k, 2): small things that stand by themselves.

    Neighbouring beams within `reach` [m] of a place count if nothing beside them is nearer than `gap` [m]: else it is a
    part of something larger; nor do they where beams of something moving are as near. Fills `out` (n,) with `cluster`
    and higher numbers; tells whether there are any.
    """
    n = points.shape[0]
    number = 0
    for k in range(n):
        out[k] = cluster[k]
        number = max(number, cluster[k] + 1)
    is_any = False
    for p in range(places.shape[0]):
        is_moving = False
        for k in range(n):
            is_moving = is_moving or (
                cluster[k] >= 0
                and math.hypot(points[k, 0] - places[p, 0], points[k, 1] - places[p, 1]) <= reach
            )
        if is_moving:
            continue
        first = -1
        for k in range(n + 1):
            is_near = (
                k < n
                and is_valid[k]
                and cluster[k] < 0
                and math.hypot(points[k, 0] - places[p, 0], points[k, 1] - places[p, 1]) <= reach
            )
            goes_on = (
                is_near
                and first >= 0
                and math.hypot(points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1]) <= gap
            )
            if first >= 0 and not goes_on:
                if not _is_attached(points, is_valid, first, k - 1, gap):
                    for m in range(first, k):
                        out[m] = number
                    is_any = True
                first = -1
            if is_near and first < 0:
                first = k
        number += 1
    return is_any


@kernel
def _is_attached(points: FloatArray, is_valid: BoolArray, first: int, last: int, gap: float) -> bool:
    """Whether the beam before or after some neighbouring ones ends within `gap` [m] of them."""
    for a, b in ((first, first - 1), (last, last + 1)):
        if (
            0 <= b < points.shape[0]
            and is_valid[b]
            and math.hypot(points[a, 0] - points[b, 0], points[a, 1] - points[b, 1]) <= gap
        ):
            return True
    return False


@kernel
def sight_at(
    states: FloatArray,
    T_laser: FloatArray,
    angle_min: float,
    angle_increment: float,
    ranges: FloatArray,
    is_valid: BoolArray,
    no_return: float,
    radius: float,
    sight: IntArray,
) -> None:
    """Fill `sight` (n,) with what a laser at the pose `T_laser` sees at the places of tracks (n, 4).

    A place is EMPTY if all beams towards it pass it by `radius` [m] or never return (a range from
    `no_return` [m] on), and OCCLUDED if more than half end
    before it.
    """
    n_beams = ranges.shape[0]
    for t in range(states.shape[0]):
        dx = states[t, 0] - T_laser[0]
        dy = states[t, 1] - T_laser[1]
        distance = math.hypot(dx, dy)
        turn = math.copysign(2.0 * math.pi, angle_increment)
        angle = math.atan2(dy, dx) - T_laser[2] - angle_min
        angle -= turn * math.floor(angle / turn)
        half = math.atan2(radius, max(distance, radius)) / abs(angle_increment)
        at = angle / angle_increment
        low = math.ceil(at - half)
        high = math.floor(at + half)
        if low > high:
            low = high = math.floor(at + 0.5)
        n_asked = n_past = n_before = 0
        is_cut = low < 0 or high >= n_beams
        for m in range(max(low, 0), min(high, n_beams - 1) + 1):
            if not is_valid[m]:
                if ranges[m] >= no_return:
                    n_asked += 1
                    n_past += 1
                continue
            n_asked += 1
            if ranges[m] > distance + radius:
                n_past += 1
            elif ranges[m] < distance - radius:
                n_before += 1
        if n_asked == 0 or is_cut:
            sight[t] = OUT_OF_VIEW
        elif n_past == n_asked:
            sight[t] = EMPTY
        elif 2 * n_before > n_asked:
            sight[t] = OCCLUDED
        else:
            sight[t] = PRESENT
