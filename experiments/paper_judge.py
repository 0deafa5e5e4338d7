"""The paper's methods against the wheels, on every scenario, on seeds that the search for their setting did not see."""

import sys
from collections.abc import Callable
from itertools import product

import numpy as np

from experiments import measures
from experiments.common import Options, Scores, main, run_cells
from experiments.paper_search import NOISES, RATE_HZ, SEARCH_SEEDS, SEARCHED_ON
from experiments.tables import Table, holm, median_interval, number, p_text, paired_p, write_tables
from slammot_graph.evaluation import absolute_error
from slammot_graph.simulation import SCENARIOS

METHODS = ("odometry", "icp", "docpfo")
FULL_SEEDS = 10
BOUNDS = {1.0: 1.2, 3.0: 1.0}
"""By the odometry's noise: ATE over that of the wheels that is not to be exceeded."""

Field = tuple[str, float]
"""Scenario, and the odometry's noise."""


def seeds_of(options: Options) -> tuple[int, ...]:
    """Odd seeds: the search has even ones."""
    assert all(seed % 2 == 0 for seed in SEARCH_SEEDS)
    return tuple(2 * k + 1 for k in options.seed_range(FULL_SEEDS))


def cell(scenario: str, noise: float, seed: int, method: str) -> Scores:
    """Run a method of the registry over one log."""
    log = measures.simulated(scenario, seed, None, noise, RATE_HZ)
    result = measures.run_method(log, method)
    return {"ate_m": absolute_error(result.T_map_base, log.T_world_base).translation_m.rmse}


def key(field: Field, seed: int, method: str) -> str:
    """Name of a cell."""
    scenario, noise = field
    return f"{scenario} {noise:g} {seed} {method}"


def experiment(options: Options) -> None:
    """Icp and docpfo against the wheels on every scenario, where the wheels are good and where they are bad."""
    seeds = seeds_of(options)
    scenarios = ("one-walker",) if options.quick else tuple(SCENARIOS)
    fields = list(product(scenarios, NOISES))
    cells = {
        key(field, seed, method): {"scenario": field[0], "noise": field[1], "seed": seed, "method": method}
        for field, seed, method in product(fields, seeds, METHODS)
    }
    scores = run_cells("paper_judge", cell, cells, options)

    def column(field: Field, method: str) -> list[float]:
        return [scores[key(field, seed, method)]["ate_m"] for seed in seeds]

    p_values = holm({f"{f}": paired_p(column(f, "docpfo"), column(f, "icp")) for f in fields})
    rows = [_row(field, column, p_values[f"{field}"]) for field in fields]
    columns = [
        "scenario",
        "noise",
        *("wheels" if method == "odometry" else method for method in METHODS),
        "icp / wheels",
        "docpfo / wheels",
        "bound",
        "seeds within it: icp, docpfo",
        "docpfo against icp, p",
    ]
    seen = ", ".join(name for name, _ in SEARCHED_ON)
    notes = [
        f"`icp` and `docpfo` of the registry, {RATE_HZ:g} scans a second, {len(seeds)} paired seeds"
        f" ({seeds[0]}, {seeds[1]}, ... {seeds[-1]}); `paper_search` chose their setting on seeds"
        f" {', '.join(map(str, SEARCH_SEEDS))} of {seen}, and saw no other scenario. Noise is the factor on the"
        " odometry's errors. Median ATE [m], and its ratio to that of the wheels seed by seed, median [95% bootstrap"
        f" interval]. Bound: {BOUNDS[1.0]:g} times the wheels where they are good, below the wheels where they need"
        " repair. p: docpfo against icp, paired Wilcoxon, two-sided, Holm's correction over the table."
    ]
    tables = [Table(heading="ATE [m] against the wheels", columns=columns, rows=rows)]
    write_tables("paper_judge", "The paper's methods against the wheels", notes, tables, options)


def _row(field: Field, column: Callable[[Field, str], list[float]], p: float) -> list[str]:
    wheels, icp, docpfo = (np.array(column(field, method)) for method in METHODS)
    bound = BOUNDS[field[1]]
    ratios = [icp / wheels, docpfo / wheels]
    n = len(wheels)
    return [
        field[0],
        f"{field[1]:g}",
        *(number(float(np.median(values))) for values in (wheels, icp, docpfo)),
        *(median_interval(ratio.tolist(), 2) for ratio in ratios),
        f"{bound:g}",
        ", ".join(str(int((ratio <= bound).sum())) for ratio in ratios) + f" of {n}",
        f"{p_text(p)} (better in {int((docpfo < icp).sum())} of {n})",
    ]


if __name__ == "__main__":
    sys.exit(main(experiment))
