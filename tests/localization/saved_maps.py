"""Runs through simulated worlds, one after the other: the later ones start from the map of the first."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np

from slammot_graph import MapStart, Run, SavedMap
from slammot_graph.core import se2
from slammot_graph.core.results import RunResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation import SimulatedLog
from tests.driven import driven
from tests.loop_closure.ring import ring_log
from tests.rooms import box


class Later:
    """A log from a scan on, as if it began there."""

    def __init__(self, log: SimulatedLog, first: int) -> None:
        self.log, self.first = log, first

    def __iter__(self) -> Iterator[Scan]:
        for scan in self.log:
            if scan.index >= self.first:
                yield replace(scan, index=scan.index - self.first)


@cache
def ring_map() -> SavedMap:
    saved = Run(ring_log(1)).complete().saved_map
    assert saved is not None
    return SavedMap.from_bytes(saved.to_bytes())


@cache
def second_ring(first: int, *, localize: bool, guess: tuple[float, float, float] | None = None) -> RunResult:
    """Another drive round the ring, from a scan on, in the map of the first."""
    pose = None if guess is None else np.array(guess)
    start = MapStart(saved=ring_map(), localize=localize, initial_pose=pose)
    return Run(Later(ring_log(2), first), start=start).complete()


def true_in_map(first: int) -> FloatArray:
    """(n, 3) true poses of the second drive in the frame of the first one's map."""
    return se2.between(ring_log(1).T_world_base[0], ring_log(2).T_world_base[first:])


def hotel(n_rooms: int) -> FloatArray:
    """Walls (k, 4) of equal rooms along a corridor, with equal doors and beds, 5 m apart."""
    walls = []
    for k in range(n_rooms):
        x = 5.0 * k
        walls += [
            [x, 2.0, x, 7.0],
            [x, 7.0, x + 5.0, 7.0],
            [x, 2.0, x + 2.0, 2.0],
            [x + 3.0, 2.0, x + 5.0, 2.0],
            *box(x + 3.4, 4.5, x + 5.0, 6.6),
            *box(x, 5.6, x + 0.7, 7.0),
        ]
    end = 5.0 * n_rooms
    walls += [[end, 0.0, end, 7.0], [0.0, 0.0, 0.0, 2.0], [0.0, 0.0, end, 0.0]]
    return np.array(walls)


@cache
def hotel_log(rooms: tuple[int, ...], seed: int, n_rooms: int = 6) -> SimulatedLog:
    """A drive from room to room; it begins inside the first of them."""
    route: list[tuple[float, float]] = []
    for k in rooms:
        x = 5.0 * k + 2.5
        route += [(x, 1.0), (x, 3.0), (x - 1.0, 4.5), (x + 0.2, 3.6), (x, 2.8), (x, 1.0)]
    return driven("hotel", hotel(n_rooms), np.array(route[1:]), seed, noise_scale=1.0)
