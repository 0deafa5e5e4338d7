"""A robot that follows its route."""

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import FloatArray


@kernel
def follow(
    route: FloatArray,
    dt: float,
    n_sub: int,
    n_max: int,
    max_speed: float,
    max_turn: float,
    max_accel: float,
    max_turn_accel: float,
    lookahead_m: float,
) -> FloatArray:
    """Head for a point ahead on the route, slower when it lies aside; a pose every `n_sub` steps."""
    poses = np.empty((n_max, 3))
    n_route = route.shape[0]
    step_m = np.hypot(route[1, 0] - route[0, 0], route[1, 1] - route[0, 1])
    n_ahead = max(1, int(lookahead_m / step_m))
    x, y = route[0, 0], route[0, 1]
    first = min(n_ahead, n_route - 1)
    theta = np.arctan2(route[first, 1] - y, route[first, 0] - x)
    speed, turn = 0.0, 0.0
    here = 0
    for k in range(n_max):
        poses[k, 0], poses[k, 1], poses[k, 2] = x, y, theta
        if here >= n_route - 1 and abs(speed) < 1e-9 and abs(turn) < 1e-9:
            return poses[: k + 1]
        for _ in range(n_sub):
            best = here
            best_distance = np.hypot(route[here, 0] - x, route[here, 1] - y)
            for j in range(here + 1, min(here + n_ahead, n_route)):
                distance = np.hypot(route[j, 0] - x, route[j, 1] - y)
                if distance < best_distance:
                    best, best_distance = j, distance
            here = best
            goal = min(here + n_ahead, n_route - 1)
            remaining = (n_route - 1 - here) * step_m
            if remaining < 0.08:
                here = n_route - 1
                want_speed, want_turn = 0.0, 0.0
            else:
                aside = np.arctan2(route[goal, 1] - y, route[goal, 0] - x) - theta
                aside = (aside + np.pi) % (2.0 * np.pi) - np.pi
                want_turn = min(max(2.5 * aside, -max_turn), max_turn)
                want_speed = max_speed * max(0.0, 1.0 - abs(aside) / 0.9)
                want_speed = min(want_speed, np.sqrt(2.0 * 0.7 * max_accel * max(0.0, remaining - 0.05)))
            speed += min(max(want_speed - speed, -max_accel * dt), max_accel * dt)
            turn += min(max(want_turn - turn, -max_turn_accel * dt), max_turn_accel * dt)
            middle = theta + 0.5 * turn * dt
            x += speed * np.cos(middle) * dt
            y += speed * np.sin(middle) * dt
            theta = (theta + turn * dt + np.pi) % (2.0 * np.pi) - np.pi
    return poses
