"""Static worlds as line segments, each with a route for the robot."""

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from types import MappingProxyType

import numpy as np

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation.free_space import FreeSpace, free_space_of_segments

Segment = tuple[float, float, float, float]

_WALL_M = 0.12
"""Thickness of inner walls."""


@dataclass(frozen=True, kw_only=True, eq=False)
class World:
    """A static world.

    Attributes
    ----------
    name : str
    segments : (n, 4) array
        x1, y1, x2, y2 [m], world frame.
    route : (m, 2) array
        Waypoints of the robot's default drive [m]; closed if the last is the first.
    """

    name: str
    segments: FloatArray
    route: FloatArray

    @cached_property
    def free_space(self) -> FreeSpace:
        """Where people can walk: the space connected with the route."""
        return free_space_of_segments(self.segments, self.route[0])


def world_named(name: str) -> World:
    """Return the world of that name, built once; ConfigError lists the known ones."""
    if name not in WORLDS:
        raise ConfigError(f"unknown world {name!r}; known: {', '.join(WORLDS)}")
    return WORLDS[name]()


def _world(name: str, segments: Iterable[Segment], route: list[tuple[float, float]]) -> World:
    world = World(name=name, segments=np.array(list(segments), dtype=np.float64), route=np.array(route))
    world.segments.setflags(write=False)
    world.route.setflags(write=False)
    return world


def _box(x0: float, y0: float, x1: float, y1: float) -> list[Segment]:
    """Four sides of an axis-parallel box."""
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


def _polygon(points: list[tuple[float, float]]) -> list[Segment]:
    return [(*a, *b) for a, b in zip(points, points[1:] + points[:1], strict=True)]


def _turned_box(x: float, y: float, width: float, depth: float, angle_rad: float) -> list[Segment]:
    """A box about its centre, turned."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    corners = [(-width, -depth), (width, -depth), (width, depth), (-width, depth)]
    return _polygon([(x + 0.5 * (c * u - s * v), y + 0.5 * (s * u + c * v)) for u, v in corners])


def _round(x: float, y: float, radius: float, n_sides: int = 16) -> list[Segment]:
    angles = 2.0 * np.pi * np.arange(n_sides) / n_sides
    return _polygon([(x + radius * float(np.cos(a)), y + radius * float(np.sin(a))) for a in angles])


def _table(x: float, y: float, width: float, depth: float, leg: float = 0.05) -> list[Segment]:
    """Only the four legs are seen at the laser's height."""
    corners = [(x - width / 2, y - depth / 2), (x + width / 2, y - depth / 2)]
    corners += [(u, v + depth) for u, v in corners]
    return [side for u, v in corners for side in _box(u - leg / 2, v - leg / 2, u + leg / 2, v + leg / 2)]


def _wall_x(y: float, x0: float, x1: float, gaps: Iterable[tuple[float, float]] = ()) -> list[Segment]:
    """A thick wall along x centred on y, with gaps (from, to) for doors."""
    segments: list[Segment] = []
    for a, b in _between_gaps(x0, x1, gaps):
        segments += _box(a, y - _WALL_M / 2, b, y + _WALL_M / 2)
    return segments


def _wall_y(x: float, y0: float, y1: float, gaps: Iterable[tuple[float, float]] = ()) -> list[Segment]:
    """A thick wall along y centred on x, with gaps (from, to) for doors."""
    segments: list[Segment] = []
    for a, b in _between_gaps(y0, y1, gaps):
        segments += _box(x - _WALL_M / 2, a, x + _WALL_M / 2, b)
    return segments


def _between_gaps(start: float, end: float, gaps: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    parts, here = [], start
    for a, b in sorted(gaps):
        parts.append((here, a))
        here = b
    return [*parts, (here, end)]


def _lab() -> World:
    """The paper's laboratory: one room of 8 x 6 m with furniture."""
    segments = _polygon(
        [
            (0, 0),
            (5.6, 0),
            (5.6, -0.25),
            (6.6, -0.25),
            (6.6, 0),
            (8, 0),
            (8, 6),
            (4.4, 6),
            (4.4, 6.2),
            (3.2, 6.2),
            (3.2, 6),
            (0, 6),
        ]
    )
    segments += _box(0.4, 5.45, 2.4, 6.0)  # cupboard
    segments += _box(7.25, 1.4, 8.0, 3.0)  # desk
    segments += _box(2.6, 0.0, 4.4, 0.65)  # desk
    segments += _box(0.0, 2.1, 0.35, 3.7)  # shelf
    segments += _box(7.6, 5.6, 8.0, 6.0)  # column
    segments += _turned_box(6.1, 5.55, 0.55, 0.4, 0.35)  # crate
    segments += _turned_box(0.55, 0.5, 0.5, 0.5, 0.6)  # crate
    segments += _round(7.6, 0.45, 0.2)  # bin
    segments += _box(3.5, 2.65, 4.5, 3.35)  # bench in the middle
    segments += _turned_box(5.1, 3.1, 0.4, 0.35, 0.8)  # stool
    segments += _table(2.6, 3.05, 0.9, 0.6)
    route = [(1.6, 1.45), (6.3, 1.45), (6.4, 4.5), (1.5, 4.6), (1.3, 2.6), (1.6, 1.45), (3.4, 1.45)]
    return _world("lab", segments, [(float(x), float(y)) for x, y in route])


def _hall() -> World:
    """A hall of 20 x 15 m with pillars, square and round."""
    segments = _polygon(
        [
            (0, 0),
            (8, 0),
            (8, -1.2),
            (11, -1.2),
            (11, 0),
            (20, 0),
            (20, 5),
            (21, 5),
            (21, 7.5),
            (20, 7.5),
            (20, 15),
            (4, 15),
            (4, 14.2),
            (2.5, 14.2),
            (2.5, 15),
            (0, 15),
        ]
    )
    for x in (5.0, 10.0, 15.0):
        segments += _box(x - 0.3, 4.7, x + 0.3, 5.3)
        segments += _round(x, 10.0, 0.35)
    segments += _turned_box(7.5, 10.2, 1.8, 0.8, 0.3)  # kiosk
    segments += _box(0.0, 6.5, 0.6, 9.0)  # counter
    segments += _turned_box(17.6, 13.2, 1.6, 0.5, -0.6)  # bench
    segments += _turned_box(13.2, 7.8, 0.6, 0.6, 0.5)  # planter
    route = [(2.5, 2.5), (12.5, 2.3), (17.6, 2.8), (17.8, 9.5), (16.6, 11.8), (12.5, 12.5), (4.0, 12.3)]
    route += [(2.3, 10.0), (2.6, 7.4), (10.5, 7.4), (12.4, 5.0), (7.5, 2.4), (2.5, 2.5)]
    return _world("hall", segments, route)


def _corridor() -> World:
    """A bare corridor of 70 x 2.2 m; from its middle neither end is seen by a laser of 30 m."""
    length, width = 70.0, 2.2
    segments = _polygon(
        [
            (0, 0),
            (2.5, 0),
            (2.5, -0.2),
            (3.5, -0.2),
            (3.5, 0),
            (length - 3, 0),
            (length - 3, -0.2),
            (length - 2, -0.2),
            (length - 2, 0),
            (length, 0),
            (length, width),
            (1.6, width),
            (1.6, width + 0.2),
            (0.6, width + 0.2),
            (0.6, width),
            (0, width),
        ]
    )
    segments += _box(0.0, 0.0, 0.4, 0.9)  # cupboard
    segments += _box(length - 1.2, width - 0.35, length - 0.4, width)  # cupboard
    segments += _round(4.6, width - 0.2, 0.15)  # bin
    segments += _box(length - 5.0, 0.0, length - 4.4, 0.3)  # radiator
    middle = width / 2
    route = [(1.5, middle), (length - 2.2, middle - 0.1), (length - 2.4, middle + 0.15), (1.8, middle + 0.1)]
    return _world("corridor", segments, route)


def _rooms(
    x0: float,
    x1: float,
    y_corridor: float,
    y_back: float,
    n: int,
    rng: np.random.Generator,
    door_m: float = 1.1,
) -> tuple[list[Segment], list[tuple[float, float]]]:
    """A row of n furnished rooms with doors in the wall at `y_corridor`; also returns the doors' middles."""
    segments: list[Segment] = []
    edges = np.linspace(x0, x1, n + 1)
    side = 1.0 if y_back > y_corridor else -1.0
    depth = abs(y_back - y_corridor)
    gaps, doors = [], []
    for left, right in itertools.pairwise(edges):
        door = float(np.round(left + (right - left) * rng.choice([0.35, 0.5, 0.65]), 2))
        gaps.append((door - door_m / 2, door + door_m / 2))
        doors.append((door, y_corridor))
        # desks stand at the back, low things in the corners: the middle and the door stay free
        back = y_back - side * _WALL_M / 2

        def box(
            u0: float, v0: float, u1: float, v1: float, left: float = left, back: float = back
        ) -> Segment:
            """Corners from the room's back left corner, v towards the corridor."""
            v0, v1 = sorted((back - side * v0, back - side * v1))
            return (left + u0, v0, left + u1, v1)

        width = float(right - left)
        desk = float(rng.uniform(1.2, min(2.0, width - 1.6)))
        at = float(rng.uniform(0.3, width - desk - 0.3))
        segments += _box(*box(at, 0.0, at + desk, 0.75))
        if rng.random() < 0.7:
            u = float(rng.choice([0.06, width - 0.51]))
            v = float(rng.uniform(0.9, depth - 2.4))
            segments += _box(*box(u, v, u + 0.45, v + 0.9))
        if rng.random() < 0.6:
            u = at + desk / 2 + float(rng.uniform(-0.2, 0.2))
            x, low, _, high = box(u, 0.95, u, 1.35)
            segments += _turned_box(x, (low + high) / 2, 0.4, 0.4, float(rng.uniform(0, 1.5)))  # chair
        if rng.random() < 0.5:
            u = float(rng.choice([0.35, width - 0.35]))
            x, low, _, high = box(u, depth - 0.55, u, depth - 0.55)
            segments += _round(x, (low + high) / 2, 0.15, 10)  # bin
    segments += _wall_x(y_corridor, x0, x1, gaps)
    for x in edges[1:-1]:
        segments += _wall_y(float(x), min(y_corridor, y_back), max(y_corridor, y_back))
    return segments, doors


def _office() -> World:
    """A floor of ten rooms on both sides of a corridor of 26 x 2.2 m."""
    rng = np.random.default_rng(11)
    length, low, high, depth = 26.0, 5.0, 7.2, 5.0
    segments = _box(0.0, 0.0, length, high + depth)
    below, doors_below = _rooms(0.0, length, low, low - depth, 5, rng)
    above, doors_above = _rooms(0.0, length, high, high + depth, 5, rng)
    segments += below + above
    segments += _box(0.0, low + 0.06, 0.45, low + 0.9)  # cupboard at the corridor's end
    segments += _box(length - 0.3, high - 1.2, length, high - 0.06)
    segments += _box(19.4, high - 0.4, 20.2, high - 0.06)  # copier

    middle = (low + high) / 2 - 0.1

    def visit(door: tuple[float, float]) -> list[tuple[float, float]]:
        x, y = door
        side = 1.0 if y > middle else -1.0
        inside = [
            (x, y + side * 0.9),
            (x + 0.5, y + side * 1.6),
            (x, y + side * 2.0),
            (x - 0.5, y + side * 1.6),
        ]
        return [(x, middle), *inside, inside[0], (x, middle)]

    route = [(1.5, middle), *visit(doors_below[0]), *visit(doors_above[2]), *visit(doors_below[3])]
    route += [(24.5, middle), *visit(doors_above[4]), *visit(doors_above[1]), (1.5, middle)]
    return _world("office", segments, route)


def _building() -> World:
    """Two rings of corridors of 2.4 m with rooms, 54 x 38 m: the outer loop is 134 m long."""
    rng = np.random.default_rng(5)
    width, height, depth, corridor = 54.0, 38.0, 5.0, 2.4
    segments = _box(0.0, 0.0, width, height)
    x0, x1, y0, y1 = depth, width - depth, depth, height - depth  # outer side of the ring
    doors: dict[str, list[tuple[float, float]]] = {}
    for name, y, back in (("south", y0, 0.0), ("north", y1, height)):
        rooms, doors[name] = _rooms(x0, x1, y, back, 8, rng)
        segments += rooms
    # the ring's west and east sides: walls with recesses and store rooms that stay shut
    for x, out in ((x0, -1.0), (x1, 1.0)):
        recesses = [(float(y), float(y) + 1.0) for y in np.arange(y0 + 2.0, y1 - 2.0, rng.uniform(4.5, 5.5))]
        segments += [(x, a, x, b) for a, b in _between_gaps(0.0, height, recesses)]
        for a, b in recesses:
            segments += [(x, a, x + out * 0.25, a), (x + out * 0.25, a, x + out * 0.25, b)]
            segments += [(x + out * 0.25, b, x, b)]
    # two inner blocks, parted by the middle corridor, with rooms on the ring's south and north
    middle = width / 2
    blocks = ((x0 + corridor, middle - corridor / 2), (middle + corridor / 2, x1 - corridor))
    for k, (a, b) in enumerate(blocks):
        low, high = y0 + corridor, y1 - corridor
        rooms, doors[f"inner south {k}"] = _rooms(a, b, low, low + 5.0, 3, rng)
        segments += rooms
        rooms, doors[f"inner north {k}"] = _rooms(a, b, high, high - 5.0, 3, rng)
        segments += rooms
        segments += [(a, low, a, high), (b, low, b, high)]
        segments += [(a, low + 5.0, b, low + 5.0), (a, high - 5.0, b, high - 5.0)]
    c = corridor / 2
    # a few things that stand in the corridors, near the walls
    for x, y in ((12.0, y0 + 0.06), (31.0, y0 + 0.06), (40.0, y1 - 0.41), (18.5, y1 - 0.41)):
        segments += _box(x, y, x + float(rng.uniform(0.5, 1.2)), y + 0.35)
    for x, y in ((x0, 15.5), (x1 - 0.4, 22.0), (middle - c, 21.0), (middle + c - 0.35, 14.0)):
        segments += _box(x, y, x + 0.37, y + float(rng.uniform(0.5, 1.0)))

    west, east, south, north = x0 + c, x1 - c, y0 + c, y1 - c
    room_x, room_y = doors["north"][5]
    visit = [(room_x, north), (room_x, room_y + 1.0), (room_x + 0.5, room_y + 1.7), (room_x, room_y + 2.0)]
    visit += [(room_x - 0.5, room_y + 1.7), (room_x, room_y + 1.0), (room_x, north)]
    route = [
        (middle, south),
        (east, south),
        (east, north),
        *visit,
        (middle, north),
        (west, north),
        (west, south),
    ]
    route += [(middle, south), (middle, north), (west, north), (west, 20.0)]
    return _world("building", segments, route)


def _doors(a: float, b: float, at: float, out: float, rng: np.random.Generator) -> list[Segment]:
    """A wall along x from a to b at y = `at`, with shut doors 0.12 m behind it on the side `out`."""
    segments: list[Segment] = []
    here, door = a, a + float(rng.uniform(1.0, 3.0))
    step = float(rng.uniform(3.5, 5.5))
    while door + 1.0 < b:
        if rng.random() < 0.9:
            back, end = at + 0.12 * out, door + 0.95
            segments += [
                (here, at, door, at),
                (door, at, door, back),
                (door, back, end, back),
                (end, back, end, at),
            ]
            here = end
        door += step if rng.random() < 0.7 else float(rng.uniform(3.0, 9.0))
    return [*segments, (here, at, b, at)]


def _campus() -> World:
    """Corridors of 2.4 m around six blocks, 200 x 110 m: of the way along them only doors tell, and a few boxes."""
    rng = np.random.default_rng(3)
    xs, ys, half = (0.0, 62.0, 133.0, 200.0), (0.0, 52.0, 110.0), 1.2
    segments: list[Segment] = []

    def add_walls(x0: float, x1: float, y0: float, y1: float, out: float) -> None:
        for y, side in ((y0, out), (y1, -out)):
            segments.extend(_doors(x0, x1, y, side, rng))
        for x, side in ((x0, out), (x1, -out)):
            segments.extend((b, a, d, c) for a, b, c, d in _doors(y0, y1, x, side, rng))

    for (x0, x1), (y0, y1) in itertools.product(itertools.pairwise(xs), itertools.pairwise(ys)):
        add_walls(x0 + half, x1 - half, y0 + half, y1 - half, 1.0)
    add_walls(-half, xs[-1] + half, -half, ys[-1] + half, -1.0)
    for _ in range(20):
        x, y, side = float(rng.uniform(3.0, 195.0)), float(rng.choice(ys)), float(rng.choice((-1.0, 1.0)))
        segments += _box(
            x,
            y + side * (half - 0.15) - 0.15,
            x + float(rng.uniform(0.3, 1.2)),
            y + side * (half - 0.15) + 0.15,
        )
    corners = zip(map(int, "133001122110022331"), map(int, "002200112211001100"), strict=True)
    route = [(xs[i], ys[j]) for i, j in corners]
    return _world("campus", segments, route)


WORLDS: Mapping[str, Callable[[], World]] = MappingProxyType(
    {
        "lab": cache(_lab),
        "office": cache(_office),
        "corridor": cache(_corridor),
        "hall": cache(_hall),
        "building": cache(_building),
        "campus": cache(_campus),
    }
)
