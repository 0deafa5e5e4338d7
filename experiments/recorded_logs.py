"""Recorded logs, their reference trajectories, and the same logs with people injected."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from experiments.common import Options, code_state, say
from slammot_graph import Run, open_log
from slammot_graph.evaluation import Relations, read_relations
from slammot_graph.result_types import GridMap
from slammot_graph.simulation import SimulatedLog, inject, inject_along
from slammot_graph.types import FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """What a `graph` run over the log as recorded says."""

    stamps: FloatArray
    T_map_base: FloatArray
    grid: GridMap


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
    path = options.folder("results") / f"reference-{name}-{part}-{code_state()}.npz"
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
        )
    unfinished.rename(path)
    return str(path)


@lru_cache(maxsize=2)
def read_reference(path: str) -> Reference:
    """Read what `make_reference` wrote."""
    with np.load(path) as data:
        grid = GridMap(
            p_occupied=data["p_occupied"], resolution_m=float(data["resolution_m"]), origin=data["origin"]
        )
        return Reference(stamps=data["stamps"], T_map_base=data["T_map_base"], grid=grid)


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
