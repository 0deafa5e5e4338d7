"""What the paper's three figures share: runs of its lab, panel by panel for icp, docpfo and graph."""

from dataclasses import dataclass

import numpy as np

from experiments import figures, measures
from experiments.common import Options, Scores, run_cells
from experiments.tables import Table, median_interval, write_tables
from slammot_graph import Run
from slammot_graph.core import se2
from slammot_graph.core.results import RunResult, StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import absolute_error
from slammot_graph.simulation import SimulatedLog

METHODS = ("icp", "docpfo", "graph")
FULL_SEEDS = 20
COLUMNS = (
    ("ate_m", "ATE [m]", 4),
    ("iou", "point IoU", 3),
    ("walker_rmse_m", "walkers' position RMSE [m]", 3),
    ("walkers_found", "walkers' positions found", 3),
    ("ghosts_per_m2", "ghost cells/m^2", 3),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown:
    """A run to draw: its result, one step of it, and the truth in its map."""

    result: RunResult
    step: StepResult
    T_map_base_true: FloatArray
    T_map_world: FloatArray


def cell(scenario: str, seed: int, method: str) -> Scores:
    """Run one method over one log."""
    log = measures.simulated(scenario, seed)
    result = measures.run_method(log, method)
    return {
        **measures.trajectory_scores(result, log.T_world_base),
        **measures.point_scores(result.is_moving, log, result.is_valid),
        **measures.map_scores(result, log, measures.without_people(scenario, seed)),
        **measures.walker_scores(result, log),
    }


def table(name: str, title: str, scenario: str, options: Options) -> None:
    """Scores of the three methods over the seeds."""
    seeds = options.seed_range(FULL_SEEDS)
    cells = {
        f"{scenario} {seed} {method}": {"scenario": scenario, "seed": seed, "method": method}
        for seed in seeds
        for method in METHODS
    }
    scores = run_cells(name, cell, cells, options)
    rows = [
        [
            method,
            *(
                median_interval([scores[f"{scenario} {seed} {method}"][key] for seed in seeds], digits)
                for key, _, digits in COLUMNS
            ),
        ]
        for method in METHODS
    ]
    notes = [
        f"Scenario {scenario}, {len(seeds)} seeds: median [95% bootstrap interval]. The figure shows seed 0:"
        f" `figures/{name}.png`. A walker's position counts as found if a track is within 0.5 m."
    ]
    columns = ["method", *(heading for _, heading, _ in COLUMNS)]
    write_tables(name, title, notes, [Table(heading=scenario, columns=columns, rows=rows)], options)


def shown(log: SimulatedLog, method: str, at_share: float) -> Shown:
    """Run a method and keep the step at that share of the log."""
    run = Run(log, method)
    wanted = int(at_share * (log.n_scans - 1))
    kept = [step for step in run if step.scan.index == wanted]
    result = run.result()
    T_map_world = se2.inverse(absolute_error(result.T_map_base, log.T_world_base).T_world_map)
    return Shown(
        result=result,
        step=kept[0],
        T_map_base_true=se2.compose(T_map_world[None, :], log.T_world_base),
        T_map_world=T_map_world,
    )


def draw_map_panel(axes, run: Shown, title: str) -> None:  # type: ignore[no-untyped-def]
    """Map, true and estimated trajectory, odometry."""
    view = figures.view_of(_extent(run))
    figures.draw_map(axes, run.result.grid, view)
    figures.draw_path(axes, run.result.T_map_odom_base, "odometry")
    figures.draw_path(axes, run.T_map_base_true, "truth")
    figures.draw_path(axes, run.result.T_map_base, "estimate", dashed=True)
    axes.set_title(title, fontsize=9)


def draw_walker_panel(axes, run: Shown, log: SimulatedLog, title: str) -> None:  # type: ignore[no-untyped-def]
    """Where tracks were, and where the people were who were seen."""
    figures.draw_map(axes, run.result.grid, figures.view_of(_extent(run)))
    truth = measures.true_positions(log, run.T_map_world)
    axes.plot(*truth.positions.T, ".", color=figures.COLORS["truth"], markersize=3, label="people, truth")
    axes.plot(
        *run.result.tracks[:, 2:4].T,
        ".",
        color=figures.COLORS["moving"],
        markersize=2,
        label="people, detected",
    )
    axes.set_title(title, fontsize=9)


def _extent(run: Shown) -> FloatArray:
    grid = run.result.grid
    rows, cols = np.nonzero(np.nan_to_num(grid.p_occupied) > 0.8)
    cells = grid.origin + grid.resolution_m * np.column_stack([cols, rows])
    low, high = np.percentile(cells, [0.5, 99.5], axis=0)
    return np.vstack([low, high, run.result.T_map_base[:, :2]])


def walkers_experiment(name: str, title: str, scenario: str, options: Options) -> None:
    """Maps and walkers of one scenario: figure and table."""
    log = measures.simulated(scenario, 0)
    figure, axes = figures.panels(2, len(METHODS), (4.0, 3.4))
    for column, method in enumerate(METHODS):
        run = shown(log, method, 0.5)
        ate = absolute_error(run.result.T_map_base, log.T_world_base).translation_m.rmse
        draw_map_panel(axes[0][column], run, f"{method}: ATE {ate:.3f} m")
        draw_walker_panel(axes[1][column], run, log, f"{method}: walkers")
    for row in axes:
        row[-1].legend(fontsize=7, loc="lower right")
    figures.save(figure, name, options)
    table(name, title, scenario, options)
