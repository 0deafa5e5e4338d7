"""A large building with people in it: drift, closures and their precision and recall against the truth."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from unittest.mock import patch

import numpy as np

from experiments.common import say
from experiments.freiburg import (
    LoopOptions,
    WatchedRun,
    closure_errors,
    closures_of,
    command_line,
    count_events,
    is_wrong,
    largest,
    run_watched,
    write_report,
)
from experiments.tables import Table
from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import absolute_error
from slammot_graph.mapping.local_map import NO_NODE
from slammot_graph.simulation import Scenario, SimulatedLog, scenarios, simulate
from slammot_graph.simulation.worlds import World, world_named

NEAR_M, APART_M = 2.0, 8.0
METHODS = ("graph", "graph-noloop", "odometry")
CAMPUS = ((1.0, 0), (1.0, 1), (2.0, 2))
"""Factor on the odometry's errors, seed: one long drive through a campus."""

METHODS_OF_CAMPUS = ("graph", "graph-noloop")
"""The odometry alone is hundreds of metres off at the end, and so is its map."""

CELLS = ((2, 1.0, 0), (2, 1.0, 1), (2, 3.0, 0), (2, 3.0, 1), (3, 2.0, 0))
"""Laps, factor on the odometry's errors, seed."""

COLUMNS = (
    "laps, odometry noise, seed",
    "method",
    "path [m]",
    "ATE rmse [m]",
    "largest [m]",
    "at the end [m]",
    "closures",
    "right (precision)",
    "farthest from the truth [m]",
    "[degrees]",
    "recall",
    "lost",
    "CPU [s]",
    "loop closing",
    "longest step [CPU ms]",
)


def closed(name: str) -> World:
    """A world whose route ends where it began; the building's own one would lead the next lap through walls."""
    world = world_named(name)
    if name != "building" or np.allclose(world.route[0], world.route[-1]):
        return world
    corner = np.array([[world.route[-1, 0], world.route[0, 1]]])
    return replace(world, route=np.concatenate([world.route, corner, world.route[:1]]))


def recall(run: WatchedRun, T_world_nodes: FloatArray) -> tuple[int, int]:
    """Count local maps with at least one closure, of those that overlap an earlier one by the truth.

    Overlap: centres less than 2 m apart with more than 8 m of path between.
    """
    submaps = run.submaps
    if not submaps:
        return 0, 0
    centres = np.array(
        [T_world_nodes[[k.node for k in s.keyframes if k.node != NO_NODE], :2].mean(axis=0) for s in submaps]
    )
    path_m = np.array([s.path_m for s in submaps])
    closed = {edge.to_node for edge in closures_of(run.result)}
    n_found = n_possible = 0
    for k, submap in enumerate(submaps):
        near = np.hypot(*(centres[:k] - centres[k]).T) < NEAR_M
        if (near & (path_m[k] - path_m[:k] > APART_M)).any():
            n_possible += 1
            n_found += submap.anchor in closed
    return n_found, n_possible


def row(name: str, method: str, log: SimulatedLog, run: WatchedRun, n_scans: int) -> list[str]:
    """One run against the truth."""
    result = run.result
    truth = log.T_world_base[:n_scans]
    T_world_nodes = log.T_world_base[result.node_scans] if len(result.node_scans) else truth
    closures = closures_of(result)
    distance_m, angle_deg = closure_errors(closures, T_world_nodes)
    n_right = len(closures) - int(is_wrong(distance_m, angle_deg).sum())
    n_found, n_possible = recall(run, T_world_nodes)
    error = absolute_error(result.T_map_base, truth).translation_m
    start = se2.compose(truth[0], se2.inverse(result.T_map_base[0]))
    last = se2.between(truth[-1], se2.compose(start, result.T_map_base[-1]))
    closes = run.closer is not None
    return [
        name,
        method,
        f"{np.hypot(*np.diff(truth[:, :2], axis=0).T).sum():.0f}",
        f"{error.rmse:.3f}",
        f"{error.max:.3f}",
        f"{np.hypot(last[0], last[1]):.3f}",
        str(len(closures)) if closes else "-",
        f"{n_right} ({100 * n_right / len(closures):.0f}%)" if closures else "-",
        largest(distance_m),
        largest(angle_deg, 2),
        f"{n_found} of {n_possible} ({100 * n_found / max(n_possible, 1):.0f}%)" if closes else "-",
        str(count_events(result, "lost")),
        f"{run.cpu_s:.1f}",
        f"{100 * run.closing_cpu_s / run.cpu_s:.1f}%" if closes else "-",
        f"{run.longest_cpu_ms:.0f}",
    ]


def experiment(options: LoopOptions) -> None:
    """Loops of several hundred metres in a simulated building with people."""
    cells = (("lab", 1, 1.0, 0),) if options.quick else [("building", *cell) for cell in CELLS]
    rows = []
    for world, n_laps, noise_scale, seed in cells:
        with patch.object(scenarios, "world_named", closed):
            log = simulate(world, seed=seed, n_laps=n_laps, noise_scale=noise_scale, laser="lms200")
        rows += _rows(f"{n_laps} laps, x {noise_scale:g}, {seed}", log, METHODS)
    tables = [Table(heading="building", columns=COLUMNS, rows=rows)]
    if not options.quick:
        rows = []
        for noise_scale, seed in CAMPUS:
            log = simulate(
                Scenario(name="campus", world="campus", rate_hz=5.0, n_people=10),
                seed=seed,
                noise_scale=noise_scale,
            )
            rows += _rows(f"x {noise_scale:g}, {seed}", log, METHODS_OF_CAMPUS)
        tables.append(Table(heading="campus", columns=("odometry noise, seed", *COLUMNS[1:]), rows=rows))
    intro = (
        "The simulated building (54 x 38 m, ring corridor, middle corridor, rooms; 6 people; LMS200 at 10 Hz), driven"
        " round and round. ATE against the truth after planar alignment; `at the end`: error of the last pose with"
        " the first ones laid onto each other. A closure is right within 0.5 m and 5 degrees of the truth; one that"
        " tells nothing of the way along a corridor counts like the others. recall:"
        " local maps with at least one closure, of those whose centre lies within 2 m of an earlier one's with more"
        " than 8 m of path between. The campus: 1.4 km of corridors around six blocks of 200 x 110 m in which only"
        " doors and a few boxes tell of the way along; 10 people, LMS200 at 5 Hz."
    )
    write_report("large_building", options, "A large building with people", [intro], tables)


def _rows(name: str, log: SimulatedLog, methods: Sequence[str]) -> list[list[str]]:
    """Some methods over one log."""
    rows = []
    for method in methods:
        run = run_watched(log, method)
        rows.append(row(name, method, log, run, log.n_scans))
        say(f"large_building: {' | '.join(rows[-1])}")
        if method == "graph":
            _tell_wrong(run, log)
    return rows


def _tell_wrong(run: WatchedRun, log: SimulatedLog) -> None:
    closures = closures_of(run.result)
    distance_m, angle_deg = closure_errors(closures, log.T_world_base[run.result.node_scans])
    for k in np.flatnonzero(is_wrong(distance_m, angle_deg)):
        edge = closures[k]
        say(
            f"large_building:   wrong: {edge.from_node}-{edge.to_node}, {distance_m[k]:.2f} m, {angle_deg[k]:.1f} deg"
        )


if __name__ == "__main__":
    sys.exit(command_line(experiment, LoopOptions, None))
