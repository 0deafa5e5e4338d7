"""Furniture of a world, and the world after some of it was moved."""

from dataclasses import replace

import numpy as np

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.simulation.worlds import World

LEAST_M, MOST_M = 0.2, 2.5
"""Closed outlines whose sides are between these are furniture: walls are thinner, rooms larger."""

LEAST_WAY_M, MOST_WAY_M = 0.5, 1.5
"""How far a piece is moved."""

CLEAR_OF_ROUTE_M = 0.55
"""A piece does not come nearer to the robot's route than this, its middle line."""

N_TRIES = 400


def pieces_of(segments: FloatArray) -> list[IntArray]:
    """Rows of the segments (n, 4) of each piece of furniture: chains that close and are of its size."""
    pieces, first = [], 0
    for k in range(len(segments)):
        is_end = k + 1 == len(segments) or not np.allclose(segments[k, 2:], segments[k + 1, :2])
        if np.allclose(segments[k, 2:], segments[first, :2]):
            rows = np.arange(first, k + 1)
            sides = np.sort(np.ptp(segments[rows].reshape(-1, 2), axis=0))
            if sides[0] >= LEAST_M and sides[1] <= MOST_M:
                pieces.append(rows)
            first = k + 1
        elif is_end:
            first = k + 1
    return pieces


def with_moved_furniture(world: World, share: float, seed: int) -> tuple[World, BoolArray]:
    """Move a share of the furniture, by half a metre to one and a half, and turn it.

    A piece stays on its side of all walls, touches nothing, and leaves the robot's route free; one for which no such
    place is found stays, and another one is moved.

    Returns
    -------
    world : World
    is_moved : (n,) bool array
        Which of its segments.

    Raises
    ------
    ConfigError
        The share is not between 0 and 1.
    """
    if not 0.0 <= share <= 1.0:
        raise ConfigError(f"the share of furniture that is moved must be from 0 to 1, not {share:g}")
    rng = np.random.default_rng((seed, 7))
    segments, pieces = world.segments.copy(), pieces_of(world.segments)
    is_moved = np.zeros(len(segments), dtype=np.bool_)
    n_wanted, n_moved = round(share * len(pieces)), 0
    for k in rng.permutation(len(pieces)).tolist():
        if n_moved == n_wanted:
            break
        rows = pieces[k]
        others = np.delete(segments, rows, axis=0)
        moved = _elsewhere(segments[rows], others, world.route, rng)
        if moved is not None:
            segments[rows], is_moved[rows] = moved, True
            n_moved += 1
    segments.setflags(write=False)
    return replace(world, segments=segments), is_moved


def _elsewhere(
    piece: FloatArray, others: FloatArray, route: FloatArray, rng: np.random.Generator
) -> FloatArray | None:
    """A piece (k, 4) at another place; None where none is found."""
    middle = piece.reshape(-1, 2).mean(axis=0)
    for _ in range(N_TRIES):
        way_m, heading, turn = (
            rng.uniform(LEAST_WAY_M, MOST_WAY_M),
            rng.uniform(0, 2 * np.pi),
            rng.normal(0, 0.3),
        )
        to = middle + way_m * np.array([np.cos(heading), np.sin(heading)])
        c, s = np.cos(turn), np.sin(turn)
        moved = ((piece.reshape(-1, 2) - middle) @ np.array([[c, s], [-s, c]]) + to).reshape(-1, 4)
        radius_m = np.hypot(*(moved.reshape(-1, 2) - to).T).max()
        path = np.concatenate([moved, [[*middle, *to]]])
        if not _cross(path, others).any() and _apart(to, route) > CLEAR_OF_ROUTE_M + radius_m:
            return np.asarray(moved, dtype=np.float64)
    return None


def _cross(a: FloatArray, b: FloatArray) -> BoolArray:
    """(n, m) which segments (n, 4) and (m, 4) cross or touch."""

    def side(p: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
        u, v = q - p, r - p
        return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    a1, a2, b1, b2 = a[:, None, :2], a[:, None, 2:], b[None, :, :2], b[None, :, 2:]
    return np.asarray(
        (side(a1, a2, b1) * side(a1, a2, b2) <= 0.0) & (side(b1, b2, a1) * side(b1, b2, a2) <= 0.0)
    )


def _apart(point: FloatArray, route: FloatArray) -> float:
    """How far a point (2,) is from the lines between waypoints (m, 2) [m]."""
    a, d = route[:-1], np.diff(route, axis=0)
    share = np.clip(((point - a) * d).sum(axis=1) / (d**2).sum(axis=1), 0.0, 1.0)
    return float(np.hypot(*(a + share[:, None] * d - point).T).min())
