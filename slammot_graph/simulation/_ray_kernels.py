"""Rays from a laser to segments and circles."""

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray, IntArray


@kernel
def cast(
    T_world_laser: FloatArray,
    angle_min: float,
    increment: float,
    range_max: float,
    segments: FloatArray,
    circles: FloatArray,
    ranges: FloatArray,
    hits: IntArray,
) -> None:
    """Fill `ranges` (infinite) and `hits`: each shape only meets the beams of its own bounding angle."""
    n_beams = ranges.shape[1]
    beam_cos = np.cos(angle_min + increment * np.arange(n_beams))
    beam_sin = np.sin(angle_min + increment * np.arange(n_beams))
    turn = 2.0 * np.pi
    for i in range(T_world_laser.shape[0]):
        ox, oy = T_world_laser[i, 0], T_world_laser[i, 1]
        c, s = np.cos(T_world_laser[i, 2]), np.sin(T_world_laser[i, 2])
        for k in range(segments.shape[0]):
            # end points in the laser's frame
            dx, dy = segments[k, 0] - ox, segments[k, 1] - oy
            ax, ay = c * dx + s * dy, -s * dx + c * dy
            dx, dy = segments[k, 2] - ox, segments[k, 3] - oy
            bx, by = c * dx + s * dy, -s * dx + c * dy
            wx, wy = bx - ax, by - ay
            length2 = wx * wx + wy * wy
            if length2 == 0.0:
                continue
            t = min(1.0, max(0.0, -(ax * wx + ay * wy) / length2))
            near2 = (ax + t * wx) ** 2 + (ay + t * wy) ** 2
            if near2 > range_max * range_max:
                continue
            # any beam may meet a segment that the laser is on; one beam alone is cheaper asked than its bounds
            if n_beams == 1 or near2 < 1e-12 * length2:
                low, span = angle_min, turn
            else:
                a_angle, b_angle = np.arctan2(ay, ax), np.arctan2(by, bx)
                span = (b_angle - a_angle + np.pi) % turn - np.pi
                low = a_angle if span >= 0.0 else b_angle
                span = abs(span)
            cross_a = ax * wy - ay * wx
            start = (low - angle_min) % turn
            for wrap in range(2):
                first = max(0, int(np.ceil((start - wrap * turn) / increment)) - 1)
                last = min(n_beams - 1, int(np.floor((start - wrap * turn + span) / increment)) + 1)
                for j in range(first, last + 1):
                    cross = beam_cos[j] * wy - beam_sin[j] * wx
                    if cross == 0.0:
                        continue
                    distance = cross_a / cross
                    if distance < 0.0 or distance > range_max or distance >= ranges[i, j]:
                        continue
                    share = (ax * beam_sin[j] - ay * beam_cos[j]) / cross
                    if -1e-9 <= share <= 1.0 + 1e-9:
                        ranges[i, j] = distance
                        hits[i, j] = -1
        for k in range(circles.shape[1]):
            if np.isnan(circles[i, k, 0]):
                continue
            dx, dy, radius = circles[i, k, 0] - ox, circles[i, k, 1] - oy, circles[i, k, 2]
            ax, ay = c * dx + s * dy, -s * dx + c * dy
            centre2 = ax * ax + ay * ay
            if centre2 > (range_max + radius) ** 2:
                continue
            if n_beams == 1 or centre2 <= radius * radius:
                low, span = angle_min, turn
            else:
                half = np.arcsin(radius / np.sqrt(centre2))
                low, span = np.arctan2(ay, ax) - half, 2.0 * half
            start = (low - angle_min) % turn
            for wrap in range(2):
                first = max(0, int(np.ceil((start - wrap * turn) / increment)) - 1)
                last = min(n_beams - 1, int(np.floor((start - wrap * turn + span) / increment)) + 1)
                for j in range(first, last + 1):
                    along = ax * beam_cos[j] + ay * beam_sin[j]
                    aside = ax * beam_sin[j] - ay * beam_cos[j]
                    half2 = radius * radius - aside * aside
                    if half2 < 0.0:
                        continue
                    distance = along - np.sqrt(half2)
                    if distance < 0.0:
                        distance = along + np.sqrt(half2)
                    if 0.0 <= distance <= range_max and distance < ranges[i, j]:
                        ranges[i, j] = distance
                        hits[i, j] = k
