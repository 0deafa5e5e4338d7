"""The paper's Fig. 1 and 3: map and trajectory, and the end points' ellipses on the map."""

import sys

from experiments import figures, measures
from experiments.common import Options, main
from experiments.paper import METHODS, NOISE, draw_map_panel, letters, shown, table
from slammot_graph.evaluation import absolute_error

SCENARIO, AT_SHARE = "lab", 0.4
REACH_M = 3.0


def experiment(options: Options) -> None:
    """Map and trajectory of the lab, and one scan's ellipses on it, for icp, docpfo and graph."""
    scenario = "one-walker" if options.quick else SCENARIO
    log = measures.simulated(scenario, 0, None, NOISE)
    figure, axes = figures.panels(2, len(METHODS), (4.0, 3.4))
    for column, method in enumerate(METHODS):
        run = shown(log, method, AT_SHARE)
        ate = absolute_error(run.result.T_map_base, log.T_world_base).translation_m.rmse
        draw_map_panel(axes[0][column], run, f"{method}: ATE {ate:.3f} m")
        T_map_base = run.result.T_map_base[run.step.scan.index]
        x, y = T_map_base[:2]
        view = (x - 1.2 * REACH_M, x + 1.2 * REACH_M, y - REACH_M, y + REACH_M)
        figures.draw_map(axes[1][column], run.result.grid, view)
        figures.draw_ellipses(axes[1][column], run.step, T_map_base)
        tested = "no test" if method == "icp" else "95% ellipses"
        axes[1][column].set_title(f"{method}: scan {run.step.scan.index}, {tested}", fontsize=9)
    letters(axes)
    axes[0][-1].legend(fontsize=7, loc="lower right")
    name = "paper_map_and_ellipses"
    figures.save(figure, name, options)
    caption = (
        "Columns: `icp`, `docpfo`, `graph`. a to c (the paper's Fig. 1): the finished map, the true path (green), the"
        " wheels' (ochre) and the estimate (blue, dashed). d to f (its Fig. 3): the end points of one scan with the 95%"
        " ellipses in which each method tests them: the constant R_r of `docpfo` makes them grow with the range until"
        " they reach a wall, those of `graph` are smaller than a cell. Red: called moving."
    )
    table(name, "Map, trajectory and ellipses (the paper's Fig. 1 and 3)", scenario, caption, options)


if __name__ == "__main__":
    sys.exit(main(experiment))
