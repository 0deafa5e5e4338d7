"""Recorded logs from one end to the other, with the defaults."""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader

from experiments.common import Options, Scores, data_folder, main, run_cells, say
from experiments.tables import Table, number, write_tables
from slammot_graph import Run, open_log
from slammot_graph.core import se2
from slammot_graph.core.errors import InputError, SlammotError
from slammot_graph.core.results import RunResult
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import evaluate_relations, read_relations
from slammot_graph.study.measures import completed

METHODS = ("graph", "icp", "docpfo", "kiss-icp", "kiss-icp-odometry")
WALKERS = range(1, 7)
"""Ids of the labelled persons who walk; the others stand."""
LOGS: dict[str, tuple[str, str | None, str | None]] = {
    "intel": ("freiburg/intel.clf.bz2", "freiburg/intel.relations", None),
    "aces": ("freiburg/aces.clf.bz2", "freiburg/aces.relations", None),
    "fr-clinic": ("freiburg/fr-clinic_robotlaser.clf.bz2", None, None),
    "wheelchair": ("bags/general_tracking_moving_1.bag", None, None),
    "wheelchair, mcap": ("bags/general_tracking_moving_1_mcap", None, None),
    "overtakes": ("bags/overtakes_sqlite3", None, "/ego_pose"),
}
COLUMNS = (
    "log",
    "method",
    "scans",
    "relations within 60 s, mean / median [m]",
    "all relations [m]",
    "rotation [degrees]",
    "end off the odometry's / stated [m]",
    "failed matches",
    "closures",
    "ms a scan, median / p95",
    "CPU [s]",
)


QUICK_LOGS, QUICK_METHODS = ("overtakes",), ("graph", "icp")


def cell(log: str, relations: str | None, odom_topic: str | None, method: str, has_persons: bool) -> Scores:
    """Run a method over a log."""
    start = time.process_time()
    run = Run(open_log(Path(log), odom_topic=odom_topic), method)
    try:
        result = completed(run)
    except SlammotError as error:  # such as a map that leaps out of memory
        result = run.result()
        say(f"{log}, {method}: ended after {len(result.stamps)} scans: {error}")
    cpu_s = time.process_time() - start
    step = result.stage_ms["step"]
    scores: Scores = {
        "n_scans": len(result.stamps),
        "is_complete": run.is_complete,
        "n_failed": result.n_failed_matches,
        "n_closures": sum(edge.kind == "closure" for edge in result.edges),
        "step_ms": float(np.median(step)),
        "step_95_ms": float(np.percentile(step, 95)),
        "cpu_s": cpu_s,
        "end_m": float(np.hypot(*(result.T_map_base[-1] - result.T_map_odom_base[-1])[:2])),
        "end_std_m": float(np.sqrt(np.trace(result.cov_map[-1, :2, :2]))),
    }
    if relations is not None:
        truth = read_relations(Path(relations))
        near = evaluate_relations(result.stamps, result.T_map_base, truth, max_duration_s=60.0)
        every = evaluate_relations(result.stamps, result.T_map_base, truth)
        scores |= {
            "near_m": near.translation_m.mean,
            "near_median_m": near.translation_m.median,
            "all_m": every.translation_m.mean,
            "all_std_m": every.translation_m.std,
            "all_deg": every.rotation_deg.mean,
        }
    return scores | (person_scores(Path(log), result) if has_persons else {})


def person_labels(bag: Path, scans: Sequence[Scan]) -> list[tuple[int, int, FloatArray]]:
    """Person labels of the wheelchair bag: number of the scan, of the person, and place (2,) in the base frame [m].

    A label belongs to the last scan before it by recording time, and is given in the laser's frame.
    """
    by_stamp = {round(scan.stamp, 6): k for k, scan in enumerate(scans)}
    labels: list[tuple[int, int, FloatArray]] = []
    last = None
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            if connection.msgtype.endswith("LaserScan"):
                scan_message: Any = reader.deserialize(raw, connection.msgtype)
                stamp = scan_message.header.stamp
                last = by_stamp.get(round(stamp.sec + 1e-9 * stamp.nanosec, 6), last)
            elif connection.topic == "/ground_truth_people_tracks" and last is not None:
                label: Any = reader.deserialize(raw, connection.msgtype)
                place = np.array([[label.pose.position.x, label.pose.position.y]])
                in_base = se2.transform(np.array(scans[last].laser.T_base_laser), place)[0]
                labels.append((last, label.id, in_base))
    return labels


def person_scores(bag: Path, result: RunResult) -> Scores:
    """Count the person labels of the wheelchair bag that have a moving point within 0.5 m."""
    scans = list(open_log(bag))
    found: list[tuple[int, bool]] = []
    for k, person_id, person in person_labels(bag, scans):
        points = scans[k].points_base()[result.is_moving_online[k][: len(scans[k].ranges)]]
        near = bool(len(points)) and bool(np.hypot(*(points - person).T).min() < 0.5)
        found.append((person_id, near))
    walkers = [near for person_id, near in found if person_id in WALKERS]
    return {
        "persons": len(found),
        "persons_found": sum(near for _, near in found),
        "walkers": len(walkers),
        "walkers_found": sum(walkers),
    }


def experiment(options: Options) -> None:
    """Recorded logs from one end to the other, with the defaults."""
    logs = QUICK_LOGS if options.quick else tuple(LOGS)
    methods = QUICK_METHODS if options.quick else METHODS
    folder = data_folder(options.data)
    for name in logs:
        if not (folder / LOGS[name][0]).exists():
            raise InputError(
                f"{folder / LOGS[name][0]}: no such recorded log; set SLAMMOT_DATA or --data to the folder of them"
            )
    cells = {
        f"{name} {method}": {
            "log": str(folder / LOGS[name][0]),
            "relations": None if LOGS[name][1] is None else str(folder / str(LOGS[name][1])),
            "odom_topic": LOGS[name][2],
            "method": method,
            "has_persons": (name, method) == ("wheelchair", "graph"),
        }
        for name in logs
        for method in methods
    }
    scores = run_cells("recorded_logs", cell, cells, options)
    rows = [[name, method, *_figures(scores[f"{name} {method}"])] for name in logs for method in methods]
    notes = [
        "Milliseconds are wall time of a step, with all processes running; the CPU is that of the whole run. The end of"
        " the path against that of the odometry, and the standard deviation stated there: only where the odometry is"
        " good does it say how far the method is off."
    ]
    if "wheelchair graph" in scores:
        s = scores["wheelchair graph"]
        notes += [
            "",
            f"wheelchair: {s['persons_found']} of {s['persons']} person labels have a moving point within 0.5 m; of"
            f" those of persons who walk, {s['walkers_found']} of {s['walkers']}.",
        ]
    tables = [Table(heading="With the defaults", columns=COLUMNS, rows=rows)]
    write_tables("recorded_logs", "Recorded logs", notes, tables, options)


def _figures(scores: Scores) -> list[str]:
    relations = ["-", "-", "-"]
    if "all_m" in scores:
        relations = [
            f"{number(scores['near_m'], 4)} / {number(scores['near_median_m'], 4)}",
            f"{number(scores['all_m'], 4)} +- {number(scores['all_std_m'], 4)}",
            number(scores["all_deg"]),
        ]
    return [
        str(scores["n_scans"]) if scores["is_complete"] else f"{scores['n_scans']}, then ended",
        *relations,
        f"{number(scores['end_m'], 2)} / {number(scores['end_std_m'], 2)}",
        str(scores["n_failed"]),
        str(scores["n_closures"]),
        f"{number(scores['step_ms'], 2)} / {number(scores['step_95_ms'], 2)}",
        number(scores["cpu_s"], 1),
    ]


if __name__ == "__main__":
    sys.exit(main(experiment))
