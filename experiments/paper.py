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
NOISE = 3.0
"""Factor on the odometry's errors: at this the wheels need repair, as the paper's do."""
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
    log = measures.simulated(scenario, seed, None, NOISE)
    result = measures.run_method(log, method)
    return {
        **measures.trajectory_scores(result, log.T_world_base),
        **measures.point_scores(result.is_moving, log, result.is_valid),
        **measures.map_scores(result, log, measures.without_people(scenario, seed, NOISE)),
        **measures.walker_scores(result, log),
    }


def table(name: str, title: str, scenario: str, caption: str, options: Options) -> None:
    """Scores of the wheels and of the three methods over the seeds; the caption says what the figure shows."""
    seeds = options.seed_range(FULL_SEEDS)
    cells = {
        f"{scenario} {seed} {method}": {"scenario": scenario, "seed": seed, "method": method}
        for seed in seeds
        for method in ("odometry", *METHODS)
    }
    scores = run_cells(name, cell, cells, options)
    rows = [
        [
            "wheels" if method == "odometry" else method,
            *(
                median_interval([scores[f"{scenario} {seed} {method}"][key] for seed in seeds], digits)
                for key, _, digits in COLUMNS
            ),
        ]
        for method in ("odometry", *METHODS)
    ]
    notes = [
        f"Scenario {scenario}, odometry noise x {NOISE:g}, {len(seeds)} seeds: median [95% bootstrap interval]. A"
        " walker's position counts as found if a track is within 0.5 m.",
        "",
        f"The figure, `figures/{name}.png`, shows seed 0. {caption}",
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


def draw_time_panel(axes, run: Shown, log: SimulatedLog, title: str) -> None:  # type: ignore[no-untyped-def]
    """Where the people were who were seen, and where tracks were, over time: x filled, y open."""
    truth = measures.true_positions(log, run.T_map_world)
    stamps = log.stamps[truth.frames] - log.stamps[0]
    tracks = run.result.tracks
    for axis, (name, filled) in enumerate((("x", "full"), ("y", "none"))):
        style = {"fillstyle": filled, "markeredgewidth": 0.4}
        axes.plot(
            stamps,
            truth.positions[:, axis],
            "o",
            color=figures.COLORS["truth"],
            markersize=3,
            label=f"people, truth, {name}",
            **style,
        )
        axes.plot(
            tracks[:, 0] - log.stamps[0],
            tracks[:, 2 + axis],
            "s",
            color=figures.COLORS["moving"],
            markersize=2,
            label=f"people, detected, {name}",
            **style,
        )
    axes.tick_params(labelsize=7)
    axes.set_title(title, fontsize=9)
    axes.set_xlabel("time [s]", fontsize=8)


def letters(axes) -> None:  # type: ignore[no-untyped-def]
    """Name the panels a, b, c, ... row by row."""
    for number, panel in enumerate(panel for row in axes for panel in row):
        panel.set_title(f"{chr(ord('a') + number)}  {panel.get_title()}", fontsize=9)


def _extent(run: Shown) -> FloatArray:
    grid = run.result.grid
    rows, cols = np.nonzero(np.nan_to_num(grid.p_occupied) > 0.8)
    cells = grid.origin + grid.resolution_m * np.column_stack([cols, rows])
    low, high = np.percentile(cells, [0.5, 99.5], axis=0)
    return np.vstack([low, high, run.result.T_map_base[:, :2]])


CAPTION = (
    "Columns: `icp`, `docpfo`, `graph`. a to c: the finished map, the true path (green), the wheels' (ochre) and the"
    " estimate (blue, dashed): ICP takes the wheels' error away, and what walkers leave of themselves in the map"
    " are the black specks in the room. d to f: where people were who were seen (green) and where each method"
    " detected them (red), on the same maps; `icp` looks for nobody. g to i: the same over time, x filled and y open"
)


def walkers_experiment(name: str, title: str, scenario: str, caption: str, options: Options) -> None:
    """Maps and walkers of one scenario: figure and table."""
    log = measures.simulated(scenario, 0, None, NOISE)
    figure, axes = figures.panels(3, len(METHODS), (4.0, 3.3))
    for column, method in enumerate(METHODS):
        run = shown(log, method, 0.5)
        ate = absolute_error(run.result.T_map_base, log.T_world_base).translation_m.rmse
        draw_map_panel(axes[0][column], run, f"{method}: ATE {ate:.3f} m")
        draw_walker_panel(axes[1][column], run, log, f"{method}: walkers")
        draw_time_panel(axes[2][column], run, log, f"{method}: walkers over time")
    letters(axes)
    axes[2][0].set_ylabel("x, y in the map [m]", fontsize=8)
    for row in axes:
        row[-1].legend(fontsize=6, loc="lower right")
    figures.save(figure, name, options)
    table(name, title, scenario, f"{CAPTION}{caption}", options)
