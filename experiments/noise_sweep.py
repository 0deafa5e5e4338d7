"""Odometry noise against the number of people: which method's trajectory is best where."""

import math
import sys
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from experiments import figures, measures
from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, median_interval, number, write_tables
from slammot_graph.evaluation import absolute_error

SCENARIO, QUICK_SCENARIO = "lab", "one-walker"
PEOPLE, NOISES = (0, 1, 3, 6, 12), (0.0, 0.5, 1.0, 2.0, 4.0)
QUICK_PEOPLE, QUICK_NOISES = (0, 6), (0.0, 2.0)
RATE_HZ = 5.0
FULL_SEEDS = 5
METHODS = ("graph", "odometry", "icp", "docpfo", "kiss-icp", "kiss-icp-odometry")
BASELINES = METHODS[1:]
COLORS = ("#7fb2e5", "#f0c75e", "#b9b9b9", "#f09a6b", "#8fcf9f", "#d59ac8")
"""A colour for each method, light enough for black text."""
N_DECIMALS = 4

Column = Callable[[float, int, str], list[float]]


def cell(scenario: str, people: int, noise: float, seed: int, method: str) -> Scores:
    """Run one method over one log."""
    log = measures.simulated(scenario, seed, people, noise, RATE_HZ)
    result = measures.run_method(log, method)
    return {"ate_m": absolute_error(result.T_map_base, log.T_world_base).translation_m.rmse}


def key(scenario: str, people: int, noise: float, seed: int, method: str) -> str:
    """Name of a cell."""
    return f"{scenario} {RATE_HZ:g} {people} {noise:g} {seed} {method}"


def ranking(medians: dict[str, float]) -> list[str]:
    """Methods from the least error to the greatest, those without one last, equal ones in the order given."""
    return sorted(medians, key=lambda method: (math.isnan(medians[method]), medians[method]))


def experiment(options: Options) -> None:
    """Who has the least ATE, by the odometry's noise and the number of people, with graph and its baselines."""
    seeds = options.seed_range(FULL_SEEDS)
    scenario = QUICK_SCENARIO if options.quick else SCENARIO
    people = QUICK_PEOPLE if options.quick else PEOPLE
    noises = QUICK_NOISES if options.quick else NOISES
    cells = {
        key(scenario, n, noise, seed, method): {
            "scenario": scenario,
            "people": n,
            "noise": noise,
            "seed": seed,
            "method": method,
        }
        for n, noise, seed, method in product(people, noises, seeds, METHODS)
    }
    scores = run_cells("noise_sweep", cell, cells, options)

    def column(noise: float, n: int, method: str) -> list[float]:
        return [scores[key(scenario, n, noise, seed, method)]["ate_m"] for seed in seeds]

    medians = {
        (noise, n): {method: float(np.median(column(noise, n, method))) for method in METHODS}
        for noise, n in product(noises, people)
    }
    draw(medians, noises, people, scenario, options)
    tables = [
        _winners(medians, noises, people),
        _against(medians, noises, people, column),
        *(_errors(method, noises, people, column) for method in METHODS),
    ]
    n_won = sum(ranking(found)[0] == "graph" for found in medians.values())
    notes = [
        f"Scenario {scenario}, {len(seeds)} paired seeds: ATE after planar alignment, root mean square, its median over"
        " the seeds. Noise is the factor on the odometry's errors: 0 is odometry that tells the truth, and"
        f" kiss-icp does not look at it. Methods: {', '.join(METHODS)}. graph has the least median in {n_won} of"
        f" {len(medians)} fields. The best baseline is chosen field by field after the fact, which favours it."
        " The figure: `figures/noise_sweep.png`."
    ]
    write_tables("noise_sweep", "Odometry noise against the number of people", notes, tables, options)


def draw(
    medians: dict[tuple[float, int], dict[str, float]],
    noises: Sequence[float],
    people: Sequence[int],
    scenario: str,
    options: Options,
) -> None:
    """Fields coloured by the method with the least ATE, with that of graph and of the best baseline."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    figure, ((axes,),) = figures.panels(1, 1, (max(1.5 * len(people) + 1.2, 5.0), 0.8 * len(noises) + 1.8))
    winners = [[METHODS.index(ranking(medians[noise, n])[0]) for n in people] for noise in noises]
    axes.imshow(
        winners,
        cmap=ListedColormap(COLORS),
        vmin=-0.5,
        vmax=len(METHODS) - 0.5,
        origin="lower",
        aspect="auto",
        interpolation="nearest",
    )
    for (row, noise), (place, n) in product(enumerate(noises), enumerate(people)):
        found = medians[noise, n]
        rival = best_baseline(found)
        text = f"graph {number(found['graph'], 3)}\n{rival} {number(found[rival], 3)}"
        axes.text(place, row, text, ha="center", va="center", fontsize=7)
    axes.set_xticks(range(len(people)), [f"{n}" for n in people])
    axes.set_yticks(range(len(noises)), [f"{noise:g}" for noise in noises])
    axes.set_xticks(np.arange(len(people) - 1) + 0.5, minor=True)
    axes.set_yticks(np.arange(len(noises) - 1) + 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=2.0)
    axes.tick_params(which="both", length=0.0)
    axes.set(xlabel="people", ylabel="factor on the odometry's errors")
    axes.set_title(f"{scenario}: least median ATE [m]; text: graph and best baseline", fontsize=9)
    figure.legend(
        handles=[Patch(color=color, label=method) for method, color in zip(METHODS, COLORS, strict=True)],
        loc="outside lower center",
        ncols=3,
        fontsize=8,
    )
    figures.save(figure, "noise_sweep", options)


def best_baseline(medians: dict[str, float]) -> str:
    """The baseline with the least error."""
    return ranking({method: medians[method] for method in BASELINES})[0]


def _field_table(
    heading: str, noises: Sequence[float], people: Sequence[int], text: Callable[[float, int], str]
) -> Table:
    """Rows by noise, columns by people."""
    rows = [[f"{noise:g}", *(text(noise, n) for n in people)] for noise in noises]
    columns = ["noise", *(f"{n} people" if n != 1 else "1 person" for n in people)]
    return Table(heading=heading, columns=columns, rows=rows)


def _winners(
    medians: dict[tuple[float, int], dict[str, float]], noises: Sequence[float], people: Sequence[int]
) -> Table:
    def text(noise: float, n: int) -> str:
        found = medians[noise, n]
        first, second = ranking(found)[:2]
        won = f"{first} {number(found[first], N_DECIMALS)}"
        won = f"**{won}**" if first == "graph" else won
        return f"{won} ({second} {number(found[second], N_DECIMALS)})"

    return _field_table("Least median ATE [m], and the next", noises, people, text)


def _against(
    medians: dict[tuple[float, int], dict[str, float]],
    noises: Sequence[float],
    people: Sequence[int],
    column: Column,
) -> Table:
    def text(noise: float, n: int) -> str:
        rival = best_baseline(medians[noise, n])
        ours, theirs = column(noise, n, "graph"), column(noise, n, rival)
        differences = [a - b for a, b in zip(ours, theirs, strict=True)]
        n_better = sum(difference < 0.0 for difference in differences)
        return f"{median_interval(differences, N_DECIMALS)}, {n_better} of {len(ours)} ({rival})"

    heading = (
        "ATE of graph less that of the best baseline [m], seed by seed: median [95% bootstrap interval],"
        " better in, (which one)"
    )
    return _field_table(heading, noises, people, text)


def _errors(method: str, noises: Sequence[float], people: Sequence[int], column: Column) -> Table:
    heading = f"{method}: median ATE [m] [95% bootstrap interval]"
    return _field_table(
        heading, noises, people, lambda noise, n: median_interval(column(noise, n, method), N_DECIMALS)
    )


if __name__ == "__main__":
    sys.exit(main(experiment))
