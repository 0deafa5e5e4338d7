"""Odometry with faults: late, scaled, biased, slipping, jumping, dead, wrong in sign. What becomes of the run?"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import tyro

from experiments import measures
from experiments.common import Options, Scores, run_cells, say
from experiments.faults import FAULTS, NONE, Fault
from experiments.tables import Table, median_interval, number, write_tables
from slammot_graph.core import se2
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import absolute_error
from slammot_graph.evaluation.consistency import (
    average_nees,
    errors_to_anchor,
    nees,
    pose_errors,
)
from slammot_graph.simulation import SimulatedLog

SCENARIOS = ("lab", "office", "hall")
JUDGED, BASELINE = "graph", "kiss-icp-odometry"
METHODS = (JUDGED, BASELINE)
FULL_SEEDS, BASELINE_SEEDS, FIRST_SEED = 20, 5, 100
MAX_RATIO = 1.5
"""The error with a fault over that without is to stay within this."""

MAX_OFFSET_ERROR_S, MAX_SCALE_ERROR = 0.02, 0.02
MAX_SIGMAS = 5.0
"""A run that is wrong by more of its own standard deviations has to say so."""

SLIP_STDS = 5.0
"""An error of the odometry's increment that is larger by so many usual ones is a slip."""

QUICK_FAULTS = (NONE, "late by 0.25 s", "distance x 0.6", "jumps 1 m")


@dataclass(frozen=True, kw_only=True)
class FaultOptions(Options):
    """Options of this experiment.

    Attributes
    ----------
    scenarios : sequence of str
        In quick mode the first one only.
    """

    scenarios: tuple[str, ...] = SCENARIOS

    @property
    def more_words(self) -> tuple[str, ...]:
        """See `Options`."""
        return () if self.scenarios == SCENARIOS else ("--scenarios", *self.scenarios)


def cell(scenario: str, seed: int, fault: str, method: str) -> Scores:
    """Run one method over one log with one fault."""
    clean = measures.simulated(scenario, seed)
    log = FAULTS[fault].apply(clean)
    result = measures.run_method(log, method)
    error = absolute_error(result.T_map_base, log.T_world_base).translation_m
    scores: Scores = {"ate_m": error.rmse, "max_m": error.max}
    if method != JUDGED:
        return scores
    return {
        **scores,
        "n_tracks": len(np.unique(result.tracks[:, 1])),
        **_calibration(result.odometry, expected(clean, FAULTS[fault])),
        **_consistency(result, log.T_world_base),
        "n_contradictions": sum(event.kind == "contradiction" for event in result.events),
        "n_lost": sum(event.kind == "lost" for event in result.events),
        "n_failed": result.n_failed_matches,
        "n_by_odometry": result.odometry.n_by_odometry,
        "verdict": [finding.kind for finding in result.verdict],
    }


def expected(clean: SimulatedLog, fault: Fault) -> dict[str, float]:
    """Calibration that the log with the fault needs, from the truth: see `OdometryReport` for its numbers.

    The odometry's increments are regressed on the true ones, not the other way about, for it is they that have noise;
    slips, which a calibration does not mend, are left out.
    """
    told, true = (se2.between(T[:-1], T[1:]) for T in (clean.T_odom_base, clean.T_world_base))
    errors = np.abs((told - true)[:, [0, 2]])
    moves = np.abs(true).sum(axis=1) > 1e-6
    is_usual = moves & (errors < SLIP_STDS / 0.6745 * np.median(errors[moves], axis=0)).all(axis=1)
    told, true = told[is_usual], true[is_usual]
    distance = float(told[:, 0] @ true[:, 0] / (true[:, 0] @ true[:, 0]))
    columns = np.column_stack([true[:, 2], true[:, 0]])
    (heading, bias), *_ = np.linalg.lstsq(columns, told[:, 2], rcond=None)
    needed = 1.0 / float(heading)
    return {
        "clock_offset_s": fault.delay_s,
        "distance_scale": 1.0 / (distance * abs(fault.distance)),
        "heading_scale": needed / fault.heading,
        "heading_bias_rad_per_m": -needed
        * (float(bias) / distance + fault.bias_rad_per_m)
        / abs(fault.distance),
    }


def _calibration(report: OdometryReport, asked: Mapping[str, float]) -> Scores:
    scores: Scores = {}
    for name, value in asked.items():
        found = getattr(report, name)
        scores |= {name: found.value, f"{name} std": found.std, f"{name} expected": value}
    return {**scores, "direction_rad": report.direction_rad.value}


def _consistency(result: RunResult, T_world_base: FloatArray) -> Scores:
    """Mean NEES, and the largest error in own standard deviations and where it begins."""
    errors, is_matched = errors_to_anchor(result, T_world_base)
    T_map_world = se2.compose(result.T_map_base[0], se2.inverse(T_world_base[0]))
    in_map = pose_errors(result.T_map_base[1:], se2.compose(T_map_world[None, :], T_world_base[1:]))
    return {
        **_judged("relative", errors, result.cov_anchor_base[is_matched], np.flatnonzero(is_matched)),
        **_judged("map", in_map, result.cov_map[1:], np.arange(1, len(in_map) + 1)),
    }


def _judged(name: str, errors: FloatArray, cov: FloatArray, scans: np.ndarray) -> Scores:
    values = nees(errors, cov)
    is_finite = np.isfinite(values)
    values, scans = values[is_finite], scans[is_finite]
    wrong = scans[values > MAX_SIGMAS**2]
    return {
        f"{name} nees": float(values.mean()) if values.size else math.nan,
        f"{name} sigmas": float(np.sqrt(values.max())) if values.size else math.nan,
        f"{name} worst scan": int(scans[values.argmax()]) if values.size else -1,
        f"{name} first wrong scan": int(wrong[0]) if wrong.size else -1,
        f"{name} n wrong": int(wrong.size),
    }


def says_so(scores: Scores) -> bool:
    """Whether a run said that something was wrong: a finding, a contradiction or that it was lost."""
    return bool(scores["verdict"] or scores["n_contradictions"] or scores["n_lost"])


def is_silent(scores: Scores) -> bool:
    """Whether a run is wrong by more than `MAX_SIGMAS` of its standard deviations and says nothing."""
    return max(scores["relative sigmas"], scores["map sigmas"]) > MAX_SIGMAS and not says_so(scores)


def key(scenario: str, seed: int, fault: str, method: str) -> str:
    """Name of a cell."""
    return f"{scenario} {seed} {method} {fault}"


def experiment(options: FaultOptions) -> None:
    """Simulated robots with faults of their odometry, against the same robots without."""
    seeds = [FIRST_SEED + seed for seed in options.seed_range(FULL_SEEDS, quick=1)]
    seeds_of = {JUDGED: seeds, BASELINE: seeds[:BASELINE_SEEDS]}
    names = options.scenarios[:1] if options.quick else options.scenarios
    faults = QUICK_FAULTS if options.quick else tuple(FAULTS)
    cells = {
        key(name, seed, fault, method): {"scenario": name, "seed": seed, "fault": fault, "method": method}
        for name in names
        for seed in seeds
        for method in METHODS
        for fault in faults
        if seed in seeds_of[method]
    }
    scores = run_cells("odometry_faults", cell, cells, options)
    tables = []
    for name in names:
        of = {
            (fault, method): [scores[key(name, seed, fault, method)] for seed in seeds_of[method]]
            for fault in faults
            for method in METHODS
        }
        tables += [_errors(name, faults, of), _found(name, faults, of), _consistent(name, faults, of)]
    bounds = average_nees(np.zeros(1), dof=3, n_independent=len(seeds))
    notes = [
        f"{len(seeds)} paired seeds from {FIRST_SEED} on, of {BASELINE} the first {len(seeds_of[BASELINE])}. ATE:"
        f" median [95% bootstrap interval]; of `{JUDGED}` its ratio to the run of the same seed without the fault,"
        f" median and worst, and in how many runs it is within {MAX_RATIO:g} (bold: not in all).",
        "",
        "Calibration, for faults that are the same all along: median over the seeds of what the odometry needs by"
        " the truth, median of what was found, and the largest error of all runs"
        f" (bold: over {MAX_OFFSET_ERROR_S:g} s, or {MAX_SCALE_ERROR:.0%} of a scale).",
        "",
        f"Consistency of `{JUDGED}`: average NEES, consistent within {bounds.lower:.2f} to {bounds.upper:.2f} (bold:"
        " outside; in the map, outside by a factor of more than 1.5); the largest error of any scan in its own"
        f" standard deviations (square root of its NEES); in how many runs it is over {MAX_SIGMAS:g}, and how many of"
        " these say nothing: no finding in the verdict, no contradiction, not lost. Findings: in how many runs.",
    ]
    write_tables("odometry_faults", "Faults of the odometry", notes, tables, options)


Runs = Mapping[tuple[str, str], Sequence[Scores]]


def _errors(name: str, faults: Sequence[str], of: Runs) -> Table:
    rows = []
    for fault in faults:
        runs, clean = of[fault, JUDGED], of[NONE, JUDGED]
        ratios = [run["ate_m"] / without["ate_m"] for run, without in zip(runs, clean, strict=True)]
        n_within = sum(ratio <= MAX_RATIO for ratio in ratios)
        within = f"{n_within} of {len(ratios)}"
        rows.append(
            [
                fault,
                median_interval([run["ate_m"] for run in runs], 4),
                number(float(np.median(ratios)), 2),
                number(max(ratios), 2),
                within if n_within == len(ratios) else f"**{within}**",
                median_interval([run["ate_m"] for run in of[fault, BASELINE]], 4),
            ]
        )
    columns = ["fault", f"{JUDGED} [m]", "ratio", "worst", f"within {MAX_RATIO:g}", f"{BASELINE} [m]"]
    return Table(heading=f"{name}: ATE", columns=columns, rows=rows)


def _found(name: str, faults: Sequence[str], of: Runs) -> Table:
    rows = []
    for fault in faults:
        if not FAULTS[fault].is_steady:
            continue
        runs = of[fault, JUDGED]
        rows.append(
            [
                fault,
                _estimates(runs, "clock_offset_s", 3, MAX_OFFSET_ERROR_S),
                _estimates(runs, "distance_scale", 3, MAX_SCALE_ERROR, is_relative=True),
                _estimates(runs, "heading_scale", 3, MAX_SCALE_ERROR, is_relative=True),
                _estimates(runs, "heading_bias_rad_per_m", 3),
                number(float(np.degrees(np.median([abs(run["direction_rad"]) for run in runs]))), 1),
            ]
        )
    columns = [
        "fault",
        "clock offset [s]",
        "distance scale",
        "heading scale",
        "heading bias [rad/m]",
        "direction [degrees]",
    ]
    return Table(heading=f"{name}: calibration needed, found, largest error", columns=columns, rows=rows)


def _estimates(
    runs: Sequence[Scores],
    name: str,
    n_decimals: int,
    limit: float = math.inf,
    *,
    is_relative: bool = False,
) -> str:
    found, asked = (np.array([run[f"{name}{which}"] for run in runs]) for which in ("", " expected"))
    errors = np.abs(found - asked) / (np.abs(asked) if is_relative else 1.0)
    largest = f"{errors.max():.1%}" if is_relative else f"{errors.max():.{n_decimals}f}"
    largest = largest if errors.max() <= limit else f"**{largest}**"
    return f"{np.median(asked):.{n_decimals}f}, {np.median(found):.{n_decimals}f}, {largest}"


def _consistent(name: str, faults: Sequence[str], of: Runs) -> Table:
    rows = []
    for fault in faults:
        runs = of[fault, JUDGED]
        n_wrong = sum(max(run["relative sigmas"], run["map sigmas"]) > MAX_SIGMAS for run in runs)
        n_silent = sum(is_silent(run) for run in runs)
        kinds = [kind for run in runs for kind in run["verdict"]]
        told = {kind: kinds.count(kind) for kind in sorted(set(kinds))}
        rows.append(
            [
                fault,
                _anees([run["relative nees"] for run in runs], 1.0),
                _anees([run["map nees"] for run in runs], 1.5),
                number(max(run["relative sigmas"] for run in runs), 1),
                number(max(run["map sigmas"] for run in runs), 1),
                str(n_wrong),
                f"**{n_silent}**" if n_silent else "0",
                number(float(np.median([run["n_tracks"] for run in runs])), 0),
                ", ".join(f"{kind} {n}" for kind, n in told.items()) or "-",
            ]
        )
    columns = [
        "fault",
        "NEES relative",
        "NEES in the map",
        "largest error [std], relative",
        "in the map",
        f"runs over {MAX_SIGMAS:g}",
        "silent",
        "tracks",
        "findings",
    ]
    return Table(heading=f"{name}: consistency", columns=columns, rows=rows)


def _anees(values: Sequence[float], slack: float) -> str:
    bounds = average_nees(np.array(values), dof=3, n_independent=len(values))
    is_within = bounds.lower / slack <= bounds.anees <= bounds.upper * slack
    return number(bounds.anees, 2) if is_within else f"**{number(bounds.anees, 2)}**"


def main(argv: list[str] | None = None) -> int:
    """Run the experiment from the command line; mistakes become one line and exit code 2."""
    try:
        experiment(
            tyro.cli(
                FaultOptions,
                args=argv,
                description=experiment.__doc__,
                config=(tyro.conf.FlagCreatePairsOff,),
            )
        )
    except SlammotError as error:
        say(str(error))
        return 2
    except KeyboardInterrupt:
        say("interrupted; finished cells are kept, run the same command to go on")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
