"""Lasers that sweep while the robot turns: with and without deskewing, against the same drive in snapshots."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments import measures
from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, median_interval, number, write_tables
from slammot_graph.core.results import RunResult
from slammot_graph.evaluation import absolute_error
from slammot_graph.evaluation.consistency import average_nees, errors_to_anchor, nees_and_coverage
from slammot_graph.simulation import Scenario, SimulatedLog, simulate
from slammot_graph.simulation.scenarios import scenario_named, turning

RATES_HZ = (5.0, 7.0, 10.0, 20.0, 40.0)
TURNS_RAD_S = (0.5, 1.5, 3.0)
WORLDS = ("office", "hall")
TARGET_HZ, TARGET_RAD_S = 7.0, 1.5
FULL_SEEDS, FEW_SEEDS, FIRST_SEED = 20, 3, 100
MAX_RATIO = 1.5
TWIN, DESKEWED, BENT, WITHOUT, KISS = (
    "snapshots",
    "deskewed",
    "no beam times",
    "deskewed, no odometry",
    "kiss-icp-odometry",
)
RUNS = (TWIN, DESKEWED, BENT, KISS)


def scenario(world: str, rate_hz: float, turn_rad_s: float) -> Scenario:
    """Give the drive through a world with nobody about, and with a laser that is made for the rate."""
    base = scenario_named("fast-turns")
    laser = "lowcost360" if rate_hz <= 15.0 else "lms200"
    return replace(base, world=world, laser=laser, rate_hz=rate_hz, n_people=0, drive=turning(turn_rad_s))


def cell(world: str, rate_hz: float, turn_rad_s: float, seed: int, run: str) -> Scores:
    """Run one method over one log."""
    log = simulate(scenario(world, rate_hz, turn_rad_s), seed=seed, sweep=0.0 if run == TWIN else 1.0)
    if run == BENT:
        log.time_increment_s = 0.0
    if run == WITHOUT:
        log = log.with_odometry(np.full_like(log.T_odom_base, np.nan))
    result = measures.run_method(log, KISS if run == KISS else "graph")
    return {
        "ate_m": absolute_error(result.T_map_base, log.T_world_base).translation_m.rmse,
        "n_tracks": len(np.unique(result.tracks[:, 1])) if len(result.tracks) else 0,
        "nees": float("nan") if run == KISS else _nees(result, log),
    }


def _nees(result: RunResult, log: SimulatedLog) -> float:
    errors, is_matched = errors_to_anchor(result, log.T_world_base)
    return nees_and_coverage(errors, result.cov_anchor_base[is_matched])[0]


def key(world: str, rate_hz: float, turn_rad_s: float, seed: int, run: str) -> str:
    """Name of a cell."""
    return f"{world} {rate_hz:g} Hz {turn_rad_s:g} rad/s {seed} {run}"


def experiment(options: Options) -> None:
    """Sweeping lasers on turning robots, against the same drives in snapshots."""
    seeds = [FIRST_SEED + seed for seed in options.seed_range(FULL_SEEDS, quick=1)]
    few = seeds[:FEW_SEEDS]
    targets = [(world, TARGET_HZ, TARGET_RAD_S) for world in WORLDS[: 1 if options.quick else None]]
    others = [("lab", rate, turn) for rate in RATES_HZ for turn in TURNS_RAD_S]
    others = others[:1] if options.quick else others
    wanted = [(place, seed, run) for place in targets for seed in seeds for run in (TWIN, DESKEWED)]
    wanted += [(place, seed, run) for place in targets for seed in few for run in (BENT, WITHOUT, KISS)]
    wanted += [(place, seed, run) for place in others for seed in few for run in RUNS]
    names = "world", "rate_hz", "turn_rad_s", "seed", "run"
    cells = {
        key(*place, seed, run): dict(zip(names, (*place, seed, run), strict=True))
        for place, seed, run in wanted
    }
    scores = run_cells("sweep", cell, cells, options)

    def of(place: tuple[str, float, float], run: str, n: Sequence[int]) -> list[Scores]:
        return [scores[key(*place, seed, run)] for seed in n if key(*place, seed, run) in scores]

    rows = []
    for place in targets:
        twins, deskewed = of(place, TWIN, seeds), of(place, DESKEWED, seeds)
        ratios = [a["ate_m"] / b["ate_m"] for a, b in zip(deskewed, twins, strict=True)]
        medians = [float(np.median([x["ate_m"] for x in runs])) for runs in (deskewed, twins)]
        row = [place[0], median_interval([x["ate_m"] for x in twins], 4)]
        row += [median_interval([x["ate_m"] for x in deskewed], 4), number(medians[0] / medians[1], 2)]
        row += [median_interval(ratios, 2), f"{sum(x <= MAX_RATIO for x in ratios)} of {len(ratios)}"]
        row += [_anees(twins), _anees(deskewed), str(sum(x["n_tracks"] for x in deskewed))]
        row += [
            median_interval([x["ate_m"] for x in of(place, run, few)], 4) for run in (BENT, WITHOUT, KISS)
        ]
        rows.append(row)
    columns = ["world", f"{TWIN} [m]", f"{DESKEWED} [m]", "of the medians", "ratio", f"within {MAX_RATIO:g}"]
    columns += [f"NEES {TWIN}", f"NEES {DESKEWED}", "tracks"]
    columns += [f"{BENT} [m]", f"{WITHOUT} [m]", f"{KISS} [m]"]
    heading = f"{TARGET_HZ:g} Hz, turns of up to {TARGET_RAD_S:g} rad/s"
    tables = [Table(heading=heading, columns=columns, rows=rows)]
    if others:
        rows = [
            [
                number(place[1], 0),
                number(place[2], 1),
                *(number(float(np.median([x["ate_m"] for x in of(place, run, few)])), 4) for run in RUNS),
                str(sum(x["n_tracks"] for x in of(place, DESKEWED, few))),
                str(sum(x["n_tracks"] for x in of(place, BENT, few))),
            ]
            for place in others
        ]
        columns = [
            "rate [Hz]",
            "turns up to [rad/s]",
            *(f"{run} [m]" for run in RUNS),
            "tracks",
            f"tracks, {BENT}",
        ]
        tables.append(Table(heading="lab", columns=columns, rows=rows))
    notes = [
        "Nobody is about: every track is one of nobody. Up to 15 Hz a laser of 360 beams over a whole turn, else one"
        " of 181 over half a turn; a sweep lasts from scan to scan."
        f" {len(seeds)} paired seeds from {FIRST_SEED} on; of what is beside the target and of `{BENT}`, `{WITHOUT}`"
        f" and `{KISS}` the first {len(few)}. ATE: median [95% bootstrap interval]; ratio to the run of the same seed"
        " in snapshots. NEES: of the poses relative to the anchor of their local map, average over the runs (bold:"
        " outside of its bounds).",
    ]
    write_tables("sweep", "Lasers that sweep", notes, tables, options)


def _anees(runs: Sequence[Scores]) -> str:
    values = np.array([run["nees"] for run in runs])
    bounds = average_nees(values, dof=3, n_independent=len(values))
    text = number(bounds.anees, 2)
    return text if bounds.lower <= bounds.anees <= bounds.upper else f"**{text}**"


if __name__ == "__main__":
    raise SystemExit(main(experiment))
