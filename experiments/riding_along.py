"""What comes up before the laser and rides along: a cover before half of the beams, the floor seen from a ramp."""

import sys
from collections.abc import Sequence

import numpy as np

from experiments import measures
from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, number, write_tables
from slammot_graph.core import se2
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation import SimulatedLog, simulate

WORLDS = ("hall", "lab", "office", "building")
FULL_SEEDS, FIRST_SEED = 3, 97
PLACES = (0.3, 0.5, 0.7)
"""Shares of the drive at which it begins."""

N_RISING, N_ON = 25, 20
"""Scans over which a ramp comes up, as many over which it goes, and those between."""

COVER_M, HEIGHT_M, NOISE_M = 1.2, 0.3, 0.02
COVER = "half covered"
PITCHES_DEG = {"ramps of 5 degrees": 5.0, "ramps of 9 degrees": 9.0}
KINDS = ("nothing", COVER, *PITCHES_DEG)
SOURCES = {"wheels": True, "laser alone": False}
MAX_SIGMAS = 3.0


def along(n_scans: int) -> FloatArray:
    """(n,) how much of it is there at each scan, 0 to 1."""
    there: FloatArray = np.zeros(n_scans)
    for share in PLACES:
        first = int(share * n_scans)
        corners = first + np.cumsum([0, N_RISING, N_ON, N_RISING])
        there = np.maximum(there, np.interp(np.arange(n_scans), corners, [0.0, 1.0, 1.0, 0.0]))
    return there


def ridden(log: SimulatedLog, kind: str) -> SimulatedLog:
    """The log with what rides along before its ranges; it is changed."""
    there = along(log.n_scans)[:, None]
    seen = np.full(log.ranges.shape, np.inf)
    if kind == COVER:
        seen[:, : log.laser.n_beams // 2] = np.where(there > 0.0, COVER_M, np.inf)
    elif kind in PITCHES_DEG:
        down = np.cos(log.laser.angles_base) * np.sin(np.radians(PITCHES_DEG[kind]) * there)
        seen = np.divide(HEIGHT_M, down, out=seen, where=down > 1e-3)
    seen += np.random.default_rng(0).normal(0.0, NOISE_M, seen.shape)
    log.ranges = np.fmin(log.ranges, seen)
    return log


def cell(world: str, seed: int, kind: str, source: str) -> Scores:
    """Run `graph` over one log."""
    log = ridden(simulate(world, seed=seed), kind)
    if not SOURCES[source]:
        log = log.with_odometry(np.full_like(log.T_odom_base, np.nan))
    return _scores(measures.run_method(log, "graph"), log.T_world_base)


def _scores(result: RunResult, T_world_base: FloatArray) -> Scores:
    """Errors with the first pose laid onto the true one: at the end the map is to be where it was begun."""
    T_world_map = se2.compose(T_world_base[0], se2.inverse(result.T_map_base[0]))
    offsets = (se2.compose(T_world_map[None, :], result.T_map_base) - T_world_base)[:, :2]
    error_m = np.hypot(*offsets.T)
    std_m = np.sqrt(result.cov_map[:, 0, 0] + result.cov_map[:, 1, 1])
    worst = int(error_m.argmax())
    return {
        "rmse_m": float(np.sqrt(np.mean(error_m**2))),
        "max_m": float(error_m[worst]),
        "std_m": float(std_m[worst]),
        "verdict": [finding.kind for finding in result.verdict],
    }


def key(world: str, seed: int, kind: str, source: str) -> str:
    """Name of a cell."""
    return f"{world} {seed} {kind} {source}"


def experiment(options: Options) -> None:
    """What rides along with the robot, with wheels and by the laser alone."""
    seeds = [FIRST_SEED + seed for seed in options.seed_range(FULL_SEEDS, quick=1)]
    worlds = WORLDS[1:2] if options.quick else WORLDS
    kinds = KINDS[:2] if options.quick else KINDS
    names = "world", "seed", "kind", "source"
    wanted = [
        (world, seed, kind, source)
        for world in worlds
        for seed in seeds
        for kind in kinds
        for source in SOURCES
    ]
    cells = {key(*values): dict(zip(names, values, strict=True)) for values in wanted}
    scores = run_cells("riding_along", cell, cells, options)
    tables = []
    for source in SOURCES:
        rows = [
            [world, kind, *_figures([scores[key(world, seed, kind, source)] for seed in seeds])]
            for world in worlds
            for kind in kinds
        ]
        columns = [
            "world",
            "what",
            "error [m]",
            "largest [m]",
            "stated there [m]",
            f"over {MAX_SIGMAS:g} std",
        ]
        tables.append(Table(heading=source, columns=[*columns, "findings"], rows=rows))
    notes = [
        f"`graph` on simulated drives, seeds {', '.join(map(str, seeds))}, one figure each: error of the positions,"
        " root mean square, the first pose laid onto the true one; the largest, and the standard deviation stated"
        f" at that scan; in how many runs the largest is over {MAX_SIGMAS:g} of these. Three times a drive, at"
        f" {', '.join(f'{share:.0%}' for share in PLACES)} of it: half of the beams end {COVER_M:g} m away, over"
        f" {N_ON + 2 * N_RISING} scans; or the floor, {HEIGHT_M:g} m below the laser, comes up as the robot"
        f" pitches by 5 or 9 degrees ({N_RISING} scans up, {N_ON} on, {N_RISING} down). Findings of the verdict: in"
        " how many runs.",
    ]
    write_tables("riding_along", "What rides along with the robot", notes, tables, options)


def _figures(runs: Sequence[Scores]) -> list[str]:
    kinds = [kind for run in runs for kind in set(run["verdict"])]
    n_over = sum(run["max_m"] > MAX_SIGMAS * run["std_m"] for run in runs)
    return [
        *(", ".join(number(run[name], 3) for run in runs) for name in ("rmse_m", "max_m", "std_m")),
        f"{n_over} of {len(runs)}",
        ", ".join(f"{kind} {kinds.count(kind)}" for kind in sorted(set(kinds))) or "-",
    ]


if __name__ == "__main__":
    sys.exit(main(experiment))
