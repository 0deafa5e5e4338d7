"""Recorded logs, their reference trajectories, and the same logs with people injected."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from experiments.common import Options, code_state, say
from slammot_graph import Run, open_log
from slammot_graph.core.results import GridMap
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.evaluation import Relations, read_relations
from slammot_graph.simulation import SimulatedLog, inject, inject_along

MIN_DISTANCE_M = 2.0
"""Who got this far from where he was first seen is a person."""

NEAR_M = 0.6
"""Returns this near to a tracked person's place are taken for his."""

BACKWARD_S = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """What a `graph` run over the log as recorded says.

    `people` (k, 3): scan and place [m] of objects that moved `MIN_DISTANCE_M`, who are in the log though nobody
    labelled them.
    """

    stamps: FloatArray
    T_map_base: FloatArray
    grid: GridMap
    people: FloatArray


def make_reference(name: str, options: Options, max_scans: int | None = None) -> str:
    """Run `graph` over a log as recorded, unless that was done by this very code; return the file's path.

    Parameters
    ----------
    name : str
        "intel" or "aces".
    options : Options
    max_scans : int, optional
        Only the log's first ones.
    """
    log = open_log(options.recorded(f"{name}.clf.bz2"))
    part = "whole" if max_scans is None else str(max_scans)
    path = options.folder("results") / f"reference-people-{name}-{part}-{code_state()}.npz"
    if path.exists():
        return str(path)
    say(f"{name}: making the reference trajectory with graph ({part})")
    run = Run(log, "graph")
    steps = iter(run)
    for n, _ in enumerate(steps, start=1):
        if n == max_scans:
            break
    steps.close()  # type: ignore[attr-defined]
    result = run.result()
    unfinished = path.with_suffix(".part")
    with unfinished.open("wb") as file:
        np.savez(
            file,
            stamps=result.stamps,
            T_map_base=result.T_map_base,
            p_occupied=result.grid.p_occupied,
            resolution_m=result.grid.resolution_m,
            origin=result.grid.origin,
            people=_displaced_tracks(result.tracks),
        )
    unfinished.rename(path)
    return str(path)


def _displaced_tracks(tracks: FloatArray) -> FloatArray:
    """(k, 3) scan and place of the tracks, as in `RunResult.tracks`, that got `MIN_DISTANCE_M` away from their start.

    A second before its first sight each is continued backward, since a track begins late.
    """
    found = []
    for number in np.unique(tracks[:, 1]):
        track = tracks[tracks[:, 1] == number]
        distance_m = np.hypot(*(track[:, 2:4] - track[0, 2:4]).T).max()
        if distance_m < MIN_DISTANCE_M:
            continue
        first = int(track[0, 9])
        n = max(1, int(len(track) * BACKWARD_S / max(track[-1, 0] - track[0, 0], BACKWARD_S)))
        for back in range(1, min(n, first) + 1):
            seconds = back * BACKWARD_S / n
            found.append([first - back, *(track[0, 2:4] - seconds * track[0, 4:6])])
        found += track[:, [9, 2, 3]].tolist()
    return np.array(found).reshape(-1, 3)


def is_of_the_log(log: SimulatedLog, reference: str) -> BoolArray:
    """(n, beams) returns that were recorded within `NEAR_M` of a person who is in the log itself."""
    people = read_reference(reference).people
    near = np.zeros(log.ranges.shape, dtype=np.bool_)
    for k, (scan, T) in enumerate(zip(log, log.T_world_base, strict=True)):
        places = people[people[:, 0] == k, 1:]
        if len(places):
            offset = scan.points(T)[:, None, :] - places[None]
            near[k] = (np.hypot(offset[..., 0], offset[..., 1]) < NEAR_M).any(axis=1)
    return near & ~log.is_moving


@lru_cache(maxsize=2)
def read_reference(path: str) -> Reference:
    """Read what `make_reference` wrote."""
    with np.load(path) as data:
        grid = GridMap(
            p_occupied=data["p_occupied"], resolution_m=float(data["resolution_m"]), origin=data["origin"]
        )
        return Reference(
            stamps=data["stamps"], T_map_base=data["T_map_base"], grid=grid, people=data["people"]
        )


@lru_cache(maxsize=1)
def with_walkers(log: str, reference: str, n_people: int, seed: int, max_scans: int) -> SimulatedLog:
    """A recorded log's first scans, with people who wander about; the last one asked for is kept."""
    T_map_base = read_reference(reference).T_map_base
    return inject(open_log(log), T_map_base, n_people=n_people, seed=seed, max_scans=max_scans)


@lru_cache(maxsize=1)
def with_company(log: str, reference: str, share: float, seed: int, max_scans: int) -> SimulatedLog:
    """A recorded log's first scans, with people who walk with the robot; the last one asked for is kept."""
    T_map_base = read_reference(reference).T_map_base
    return inject_along(open_log(log), T_map_base, share=share, seed=seed, max_scans=max_scans)


def relations_of(log: str) -> Relations:
    """Read the true relations beside a log."""
    path = Path(log)
    return read_relations(path.with_name(path.name.removesuffix(".clf.bz2") + ".relations"))
