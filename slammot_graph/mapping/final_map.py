"""The map of a finished run: all scans at their final poses, one vote a place and time.

Scans that follow each other from one place are a *viewpoint*. They see the same, with the same errors, so that what
they say of a cell is no more certain for being said often: together they have at most `FinalMapConfig.n_votes` votes.
A minute of standing then has no more weight than driving by, while what has changed before a robot that stands comes
into the map.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Count, NotNegative, Positive
from slammot_graph.core.results import GridMap
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.mapping.occupancy_grid import GridConfig, NoReturnConfig
from slammot_graph.mapping.tiled_grid import TiledGrid

_RELIABLE_QUANTILE = 0.99
_MOST_RANGES = 200  # scans whose ranges are looked at for it
_LONGEST_STEP_M = 0.5  # between scans: beyond, the robot's path is not known


@dataclass(frozen=True, kw_only=True)
class FinalMapConfig(Checked):
    """How the scans of a run are weighted in its map.

    Attributes
    ----------
    viewpoint_m, viewpoint_rad, viewpoint_s : float
        A viewpoint ends where the robot has moved, turned, or let pass so much since its first scan.
    n_votes, n_hit_votes : float
        So many scans' worth of evidence a viewpoint has at most that a cell is free, and that it is occupied.
    n_scans : int
        So many of a viewpoint's scans, evenly spaced, are taken at most, and stand for the others.
    no_return : NoReturnConfig or None
        Beams without a return free the cells up to `reach_m`, but not farther than this laser has returned anything
        (a robust maximum); None: they free nothing, for lasers that lose glass, mirrors and black things.
    path_m : float
        Cells this near to the robot's path are free where nothing was seen to occupy them: the robot was there.
    """

    viewpoint_m: Positive = 0.3
    viewpoint_rad: Positive = 0.35
    viewpoint_s: Positive = 5.0
    n_votes: Positive = 4.0
    n_hit_votes: Positive = 2.0
    n_scans: Count = 3
    no_return: NoReturnConfig | None = field(default_factory=NoReturnConfig)
    path_m: NotNegative = 0.2


@dataclass(frozen=True, kw_only=True, eq=False)
class MapScan:
    """A scan for the map: its returns, and those that occupy.

    Attributes
    ----------
    scan : Scan
    is_valid, is_static : (n_beams,) bool arrays
    """

    scan: Scan
    is_valid: BoolArray
    is_static: BoolArray


def viewpoints(stamps: FloatArray, T_map_base: FloatArray, config: FinalMapConfig) -> IntArray:
    """First scans of the viewpoints of a run: (m,) rising indices into its stamps (n,) [s] and poses (n, 3)."""
    starts = list[int]()
    x0 = y0 = theta0 = t0 = math.nan
    for k, (t, (x, y, theta)) in enumerate(zip(stamps.tolist(), T_map_base.tolist(), strict=True)):
        turn = abs(math.remainder(theta - theta0, math.tau))
        is_same = (
            math.hypot(x - x0, y - y0) < config.viewpoint_m
            and turn < config.viewpoint_rad
            and abs(t - t0) < config.viewpoint_s
        )
        if not is_same:
            starts.append(k)
            x0, y0, theta0, t0 = x, y, theta, t
    return np.array(starts, dtype=np.int64)


def scan_weights(starts: IntArray, n: int, config: FinalMapConfig) -> Iterator[tuple[int, float, float]]:
    """Give the scans to take of n, with the weights of each, from the first scans of the viewpoints."""
    for first, end in pairwise([*starts.tolist(), n]):
        taken = np.unique(
            np.linspace(first, end - 1, min(end - first, config.n_scans)).round().astype(np.int64)
        )
        weight = min(float(end - first), config.n_votes) / len(taken)
        hit_weight = min(float(end - first), config.n_hit_votes) / len(taken)
        for k in taken.tolist():
            yield k, weight, hit_weight


def render_final_map(
    scan_at: Callable[[int], MapScan],
    stamps: FloatArray,
    T_map_base: FloatArray,
    *,
    grid: GridConfig,
    config: FinalMapConfig,
    lasers: IntArray | None = None,
) -> GridMap:
    """Render the map of n scans.

    Parameters
    ----------
    scan_at : callable
        Gives the scan of an index.
    stamps : (n,) array [s]
    T_map_base : (n, 3) array
        Final poses.
    grid : GridConfig
    config : FinalMapConfig
    lasers : (n,) int array, optional
        Which of several lasers took each scan: each has its own votes, for they see different things.

    Raises
    ------
    PartialMapError
        Not all that was seen fits into one map.
    """
    n = len(stamps)
    tiled = TiledGrid(grid)
    taken = list[tuple[int, float, float]]()
    numbers = np.zeros(n, dtype=np.int64) if lasers is None else lasers
    for number in np.unique(numbers).tolist():
        own = np.flatnonzero(numbers == number)
        starts = viewpoints(stamps[own], T_map_base[own], config)
        taken += [(int(own[k]), free, hit) for k, free, hit in scan_weights(starts, len(own), config)]
    taken.sort()
    reach = None
    if config.no_return is not None:
        looked_at = (
            np.unique(np.linspace(0, n - 1, min(n, _MOST_RANGES)).astype(np.int64)).tolist() if n else []
        )
        reach = reliable_ranges(map(scan_at, looked_at))
    under_robot = config.n_votes * tiled.window.l_pass
    for number, (k, weight, hit_weight) in enumerate(taken):
        item, T = scan_at(k), T_map_base[k]
        laser = item.scan.laser
        points, is_beam = item.scan.points(T), item.is_valid
        if reach is not None and config.no_return is not None:
            missing = item.scan.is_no_return(config.no_return.min_run, config.no_return.range_fraction)
            if missing.any():
                reach_m = min(config.no_return.reach_m, reach.get(laser, 0.0))
                far = item.scan.origins_base + reach_m * item.scan.directions_base
                points = np.where(missing[:, None], se2.transform(T, far), points)
                is_beam = is_beam | (missing & (reach_m > 0.0))
        origins = se2.transform(T, item.scan.origins_base)
        is_hit = item.is_valid if grid.occupy_with_moving else item.is_static
        tiled.update(number, origins, points, is_beam, is_hit, item.is_valid & ~is_hit, weight, hit_weight)
        tiled.add_evidence(number, T[:2], under_robot * weight)
    if n and config.path_m > 0.0:
        tiled.free_around(dense_path(T_map_base[:, :2], grid.resolution_m), config.path_m)
    return tiled.to_map()


def reliable_ranges(scans: Iterable[MapScan]) -> dict[LaserModel, float]:
    """Up to which range each laser has returned anything: a quantile of all its returns [m]."""
    found: dict[LaserModel, list[FloatArray]] = {}
    for item in scans:
        found.setdefault(item.scan.laser, []).append(item.scan.ranges[item.is_valid])
    joined = {laser: np.concatenate(ranges) for laser, ranges in found.items()}
    return {
        laser: float(np.quantile(ranges, _RELIABLE_QUANTILE)) if len(ranges) else 0.0
        for laser, ranges in joined.items()
    }


def dense_path(positions: FloatArray, spacing_m: float) -> FloatArray:
    """(m, 2) points along a path (n, 2) [m], at most so far apart; where it leaps nothing is put between."""
    steps = np.diff(positions, axis=0)
    lengths = np.hypot(*steps.T)
    n_between = np.where(lengths <= _LONGEST_STEP_M, lengths // spacing_m, 0.0).astype(np.int64)
    owner = np.repeat(np.arange(len(steps)), n_between)
    first = np.repeat(np.cumsum(n_between) - n_between, n_between)
    share = (np.arange(len(owner)) - first + 1) / (n_between[owner] + 1)
    return np.vstack([positions, positions[owner] + share[:, None] * steps[owner]])
