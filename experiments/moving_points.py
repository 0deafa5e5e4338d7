"""Moving points in recorded logs with people injected: which filter finds them."""

import sys
from collections.abc import Callable

import numpy as np

from experiments import measures, recorded
from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, holm, median_interval, number, p_text, paired_p, write_tables
from slammot_graph.core.types import BoolArray
from slammot_graph.evaluation import (
    beam_speeds,
    distance_to_wall,
    evaluate_points,
    evaluate_strata,
    motion_strata,
    strata,
)
from slammot_graph.simulation import SimulatedLog

METHODS = ("docpfo", "graph-fixed", "graph-absolute", "graph")
COMPARED_METHODS = (("graph", "graph-fixed"), ("graph-fixed", "docpfo"), ("graph", "graph-absolute"))
LOGS = ("intel", "aces")
FULL_SEEDS, QUICK_SCANS = 20, 200
N_SCANS = 2500
N_PEOPLE = 6
LABELS = ("online", "final")
FIGURES = ("precision", "recall", "iou", "static_kept")
INF = float("inf")


def cell(log: str, reference: str, n_people: int, seed: int, method: str, n_scans: int) -> Scores:
    """Run one method over one log."""
    walkers = recorded.with_walkers(log, reference, n_people, seed, n_scans)
    result = measures.run_method(walkers, method)
    is_judged = result.is_valid & ~recorded.is_of_the_log(walkers, reference)
    scores: Scores = {
        "share": float(walkers.is_moving.mean()),
        "aside": float(1.0 - is_judged.sum() / result.is_valid.sum()),
        "step_ms": measures.step_ms(result),
        **measures.trajectory_scores(result, walkers.T_world_base),
    }
    for name, labels in (("online", result.is_moving_online), ("final", result.is_moving)):
        points = measures.point_scores(labels, walkers, is_judged)
        scores |= {f"{name} {figure}": value for figure, value in points.items()}
    masks = _masks(walkers, reference)
    by_stratum = evaluate_strata(result.is_moving, walkers.is_moving, masks, is_judged)
    all_points = evaluate_points(result.is_moving, walkers.is_moving, is_judged)
    scores["strata"] = {
        stratum: {
            "share_of_moving": found.n_moving / max(all_points.n_moving, 1),
            "precision": found.precision,
            "recall": found.recall,
            "iou": found.iou,
        }
        for stratum, found in by_stratum.items()
    }
    return scores


def _masks(log: SimulatedLog, reference: str) -> dict[str, BoolArray]:
    """Strata of the beams, by range, distance to the nearest wall, and what was hit."""
    ranges = np.where(np.isfinite(log.ranges), log.ranges, np.nan)
    points = np.stack([scan.points(T) for scan, T in zip(log, log.T_world_base, strict=True)])
    walls = distance_to_wall(points, recorded.read_reference(reference).grid)
    speeds = beam_speeds(log.object_id, np.hypot(*np.moveaxis(log.objects[:, :, 2:], 2, 0)))
    named = {
        "range": strata(ranges, (0.0, 2.0, 5.0, 10.0, INF)),
        "wall at": strata(walls, (0.0, 0.2, 0.5, 1.0, INF)),
        "person": motion_strata(speeds),
        "speed": strata(speeds, (0.1, 0.5, 1.0, INF), unit="m/s"),
    }
    return {f"{group} {name}": mask for group, masks in named.items() for name, mask in masks.items()}


def key(log: str, seed: int, method: str, n_scans: int) -> str:
    """Name of a cell."""
    return f"{log} {n_scans} {N_PEOPLE} {seed} {method}"


def experiment(options: Options) -> None:
    """All filtering methods on intel and aces with people who walk, cross and stand, injected."""
    seeds = options.seed_range(FULL_SEEDS, quick=1)
    logs = LOGS[:1] if options.quick else LOGS
    n_scans = QUICK_SCANS if options.quick else N_SCANS
    cells = {}
    for log in logs:
        path = str(options.recorded(f"{log}.clf.bz2"))
        reference = recorded.make_reference(log, options, n_scans)
        for seed in seeds:
            for method in METHODS:
                cells[key(log, seed, method, n_scans)] = {
                    "log": path,
                    "reference": reference,
                    "n_people": N_PEOPLE,
                    "seed": seed,
                    "method": method,
                    "n_scans": n_scans,
                }
    scores = run_cells("moving_points", cell, cells, options)

    def column(log: str, method: str, name: str) -> list[float]:
        return [scores[key(log, seed, method, n_scans)][name] for seed in seeds]

    def stratum(log: str, method: str, name: str, figure: str) -> float:
        found = [scores[key(log, seed, method, n_scans)]["strata"][name][figure] for seed in seeds]
        kept = [value for value in found if not np.isnan(value)]
        return float(np.median(kept)) if kept else float("nan")

    tables = []
    names = list(scores[key(logs[0], seeds[0], "graph", n_scans)]["strata"])
    for log in logs:
        tables += [_labels(log, column), _methods(log, column), _strata(log, names, stratum)]
    share = np.mean([column(log, "graph", "share") for log in logs])
    aside = ", ".join(
        f"{np.mean(column(log, 'graph', 'aside')):.2%} of the valid beams of {log}" for log in logs
    )
    notes = [
        f"The first {n_scans} scans of each log with {N_PEOPLE} people, {len(seeds)} paired seeds: median [95%"
        f" bootstrap interval]; people take {share:.1%} of the beams. A beam moves if it hit a person, also one who"
        " stands. The logs as recorded hold people of their own, whom nobody labelled: returns within"
        f" {recorded.NEAR_M:g} m of whoever moved {recorded.MIN_DISTANCE_M:g} m in the run over the log as recorded are"
        f" set aside for all methods ({aside})."
        " p: paired Wilcoxon, two-sided, Holm's correction within a log."
    ]
    write_tables(
        "moving_points", "Moving points in recorded logs with people injected", notes, tables, options
    )


def _labels(log: str, column: Callable[[str, str, str], list[float]]) -> Table:
    rows = [
        [
            f"{method}, {labels}",
            *(median_interval(column(log, method, f"{labels} {figure}")) for figure in FIGURES),
            median_interval(column(log, method, "ate_m")),
            median_interval(column(log, method, "step_ms"), 2),
        ]
        for method in METHODS
        for labels in LABELS
    ]
    columns = ["method, labels", "precision", "recall", "IoU", "static points kept", "ATE [m]", "ms/scan"]
    return Table(heading=f"{log}: all points", columns=columns, rows=rows)


def _methods(log: str, column: Callable[[str, str, str], list[float]]) -> Table:
    p_values = holm(
        {
            f"{a} {b} {labels}": paired_p(column(log, a, f"{labels} iou"), column(log, b, f"{labels} iou"))
            for a, b in COMPARED_METHODS
            for labels in LABELS
        }
    )
    rows = []
    for a, b in COMPARED_METHODS:
        for labels in LABELS:
            ahead = np.array(column(log, a, f"{labels} iou")) - np.array(column(log, b, f"{labels} iou"))
            rows.append(
                [
                    f"{a} ahead of {b}, {labels}",
                    median_interval(list(ahead)),
                    f"{np.count_nonzero(ahead > 0.0)} of {len(ahead)}",
                    p_text(p_values[f"{a} {b} {labels}"]),
                ]
            )
    return Table(heading=f"{log}: IoU, step by step", columns=["", "difference", "ahead in", "p"], rows=rows)


def _strata(log: str, names: list[str], stratum: Callable[[str, str, str, str], float]) -> Table:
    rows = [
        [
            name,
            f"{stratum(log, 'graph', name, 'share_of_moving'):.1%}",
            *(
                " / ".join(number(stratum(log, method, name, figure), 2) for figure in FIGURES[:3])
                for method in METHODS
            ),
        ]
        for name in names
    ]
    columns = ["stratum", "of the moving points", *METHODS]
    return Table(
        heading=f"{log}: strata, precision / recall / IoU of the final labels", columns=columns, rows=rows
    )


if __name__ == "__main__":
    sys.exit(main(experiment))
