"""Every method on every scenario: trajectory, points, map and time."""

import sys
from collections.abc import Sequence

from experiments import measures
from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, holm, median_interval, p_text, paired_p, write_tables
from slammot_graph.methods import METHODS
from slammot_graph.simulation import SCENARIOS

FULL_SEEDS = {"one-walker": 20, "two-walkers": 20, "lab": 20}
LARGE_SEEDS = 3
"""Of the other scenarios, whose logs are long."""
QUICK_SCENARIOS = ("one-walker", "two-walkers")
RATES_HZ = {"corridor": 5.0, "building": 5.0}
"""Scans per second where the scenario's own 10 would make the log very long."""
COLUMNS = (
    ("ate_m", "ATE [m]", 4),
    ("rpe_m", "RPE over 1 m [m]", 4),
    ("iou", "point IoU", 3),
    ("precision", "precision", 3),
    ("recall", "recall", 3),
    ("ghosts_per_m2", "ghost cells/m^2", 3),
    ("lost_per_m2", "lost wall cells/m^2", 3),
    ("step_ms", "ms/scan", 2),
)


def cell(scenario: str, seed: int, method: str) -> Scores:
    """Run one method over one log."""
    rate_hz = RATES_HZ.get(scenario)
    log = measures.simulated(scenario, seed, rate_hz=rate_hz)
    clean = measures.without_people(scenario, seed, rate_hz=rate_hz)
    result = measures.run_method(log, method)
    return {
        **measures.trajectory_scores(result, log.T_world_base),
        **measures.point_scores(result.is_moving, log, result.is_valid),
        **measures.map_scores(result, log, clean),
        "step_ms": measures.step_ms(result),
        "n_scans": log.n_scans,
    }


def key(scenario: str, seed: int, method: str) -> str:
    """Name of a cell."""
    rate = f" at {RATES_HZ[scenario]:g} Hz" if scenario in RATES_HZ else ""
    return f"{scenario}{rate} {seed} {method}"


def experiment(options: Options) -> None:
    """Every method of the registry and both kiss-icp baselines on every scenario."""
    scenarios = QUICK_SCENARIOS if options.quick else tuple(SCENARIOS)
    seeds = {name: options.seed_range(FULL_SEEDS.get(name, LARGE_SEEDS)) for name in scenarios}
    cells = {
        key(scenario, seed, method): {"scenario": scenario, "seed": seed, "method": method}
        for seed in range(max(map(len, seeds.values())))
        for scenario in scenarios
        if seed in seeds[scenario]
        for method in METHODS
    }
    scores = run_cells("ablation", cell, cells, options)

    def column(scenario: str, method: str, name: str) -> list[float]:
        return [scores[key(scenario, seed, method)][name] for seed in seeds[scenario]]

    tables = []
    for scenario in scenarios:
        rivals = [method for method in METHODS if method != "graph"]
        ours = column(scenario, "graph", "ate_m")
        p_values = holm({m: paired_p(ours, column(scenario, m, "ate_m")) for m in rivals})
        rows = [
            [
                method,
                *(median_interval(column(scenario, method, name), digits) for name, _, digits in COLUMNS),
                _verdict(ours, column(scenario, method, "ate_m"), p_values.get(method)),
            ]
            for method in METHODS
        ]
        n_scans = column(scenario, "graph", "n_scans")
        rate_hz = RATES_HZ.get(scenario, SCENARIOS[scenario].rate_hz)
        heading = (
            f"{scenario}: {SCENARIOS[scenario].n_people} people, {min(n_scans)} to {max(n_scans)} scans,"
            f" {rate_hz:g} a second, {len(n_scans)} seeds"
        )
        columns = ["method", *(title for _, title, _ in COLUMNS), "ATE of graph against it, p"]
        tables.append(Table(heading=heading, columns=columns, rows=rows))
    tables.append(_paper_table(column, scenarios))
    notes = [
        "All methods on all scenarios, paired seeds, fewer where logs are long: median [95% bootstrap interval]. p:"
        " paired Wilcoxon, two-sided, with Holm's correction over the methods of a scenario. ATE after planar alignment"
        " and RPE by evo, root mean square. The map is compared with that of the same drive without people at true"
        " poses. Milliseconds are wall time under the load of all processes; for kiss-icp `register_frame` alone."
    ]
    write_tables("ablation", "Ablation: all methods on all scenarios", notes, tables, options)


def _verdict(ours: Sequence[float], theirs: Sequence[float], p: float | None) -> str:
    if p is None:
        return ""
    n_better = sum(a < b for a, b in zip(ours, theirs, strict=True))
    return f"{p_text(p)} (better in {n_better} of {len(ours)})"


def _paper_table(column, scenarios: Sequence[str]) -> Table:  # type: ignore[no-untyped-def]
    """The paper's claim: docpfo against icp with one and two walkers."""
    names = [s for s in ("one-walker", "two-walkers") if s in scenarios]
    measured = (
        ("ate_m", "ATE [m]", 4),
        ("rpe_m", "RPE over 1 m [m]", 4),
        ("ghosts_per_m2", "ghost cells/m^2", 3),
    )
    p_values = holm(
        {
            f"{s} {m}": paired_p(column(s, "docpfo", m), column(s, "icp", m))
            for s in names
            for m, _, _ in measured
        }
    )
    rows = [
        [
            f"{s}, {title}",
            median_interval(column(s, "docpfo", m), digits),
            median_interval(column(s, "icp", m), digits),
            p_text(p_values[f"{s} {m}"]),
        ]
        for s in names
        for m, title, digits in measured
    ]
    return Table(
        heading="The paper's claim: docpfo against icp", columns=["", "docpfo", "icp", "p"], rows=rows
    )


if __name__ == "__main__":
    sys.exit(main(experiment))
