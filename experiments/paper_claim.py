"""The paper's claim: does the filter help scan-to-scan ICP, and where?"""

import sys
from itertools import product

import numpy as np

from experiments import measures
from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, bootstrap_median, holm, p_text, paired_p, write_tables

WALKERS, RATES_HZ, NOISES = (1, 2), (10.0, 5.0), (0.25, 3.0)
FULL_SEEDS = 20
METHODS = ("icp", "docpfo")
FIGURES = (
    ("ate_m", "ATE [m]"),
    ("rpe_m", "RPE over 1 m [m]"),
    ("ghosts_per_m2", "ghost cells/m^2"),
    ("lost_per_m2", "lost wall cells/m^2"),
)


def cell(scenario: str, walkers: int, rate_hz: float, noise: float, seed: int) -> Scores:
    """Run both methods over one log."""
    log = measures.simulated(scenario, seed, walkers, noise, rate_hz)
    clean = measures.without_people(scenario, seed, noise, rate_hz)
    scores: Scores = {"share": float(log.is_moving.mean())}
    for method in METHODS:
        result = measures.run_method(log, method)
        scores[method] = {
            **measures.trajectory_scores(result, log.T_world_base),
            **measures.point_scores(result.is_moving, log, result.is_valid),
            **measures.map_scores(result, log, clean),
        }
    return scores


def key(scenario: str, walkers: int, rate_hz: float, noise: float, seed: int) -> str:
    """Name of a cell."""
    return f"{scenario} {walkers} {rate_hz:g} {noise:g} {seed}"


def experiment(options: Options) -> None:
    """Docpfo against icp over walkers, motion per scan and odometry noise."""
    seeds = options.seed_range(FULL_SEEDS)
    names = ("one-walker",) if options.quick else ("one-walker", "two-walkers")
    grid = [(2, 10.0, 1.0), (2, 5.0, 1.0)] if options.quick else list(product(WALKERS, RATES_HZ, NOISES))
    cells = {
        key(name, *point, seed): dict(
            zip(("scenario", "walkers", "rate_hz", "noise", "seed"), (name, *point, seed), strict=True)
        )
        for name in names
        for point in grid
        for seed in seeds
    }
    scores = run_cells("paper_claim", cell, cells, options)
    tables = []
    for name in names:
        p_values = {}
        for point, (figure, _) in product(grid, FIGURES):
            pairs = [[scores[key(name, *point, s)][m][figure] for s in seeds] for m in METHODS]
            p_values[f"{point} {figure}"] = paired_p(*pairs)
        p_values = holm(p_values)
        rows = []
        for point in grid:
            row = [f"{point[0]}", f"{point[1]:g}", f"{point[2]:g}"]
            row.append(f"{np.median([scores[key(name, *point, s)]['share'] for s in seeds]):.1%}")
            row.append(f"{np.median([scores[key(name, *point, s)]['docpfo']['recall'] for s in seeds]):.2f}")
            for figure, _ in FIGURES:
                icp, docpfo = ([scores[key(name, *point, s)][m][figure] for s in seeds] for m in METHODS)
                row.append(_compared(docpfo, icp, p_values[f"{point} {figure}"]))
            rows.append(row)
        columns = [
            "walkers",
            "scans/s",
            "noise",
            "beams on people",
            "recall",
            *(title for _, title in FIGURES),
        ]
        how = "they stop for good after 60% of the drive" if name == "two-walkers" else "they wander"
        tables.append(Table(heading=f"{name} ({how})", columns=columns, rows=rows))
    notes = [
        f"The lab, one round at 0.5 m/s, {len(seeds)} paired seeds. Fewer scans a second mean more motion from one to"
        " the next; noise is the factor on the odometry's errors. Cells: median of docpfo / median of icp, the median"
        " difference with its 95% bootstrap interval (below zero: the filter helps), p of the paired Wilcoxon test,"
        " two-sided, with Holm's correction over the whole table; bold where p < 0.05."
    ]
    write_tables("paper_claim", "Does the paper's filter help its ICP?", notes, tables, options)


def _compared(docpfo: list[float], icp: list[float], p: float) -> str:
    difference, low, high = bootstrap_median([a - b for a, b in zip(docpfo, icp, strict=True)])
    text = f"{np.median(docpfo):.3f} / {np.median(icp):.3f}: {difference:+.3f} [{low:+.3f}, {high:+.3f}] p {p_text(p)}"
    return f"**{text}**" if p < 0.05 else text


if __name__ == "__main__":
    sys.exit(main(experiment))
