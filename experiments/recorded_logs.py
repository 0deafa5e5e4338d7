"""Recorded logs from one end to the other, with the defaults: the table `experiments/tables/recorded_logs.md`.

Run as ``python -m experiments.recorded_logs [--data DIR]``; the logs lie in $SLAMMOT_DATA, else in ../shared/data.
"""

import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rosbags.highlevel import AnyReader

from slammot_graph import Run, open_log
from slammot_graph.core import se2
from slammot_graph.core.results import RunResult
from slammot_graph.evaluation import evaluate_relations, read_relations

TABLE = Path(__file__).parent / "tables" / "recorded_logs.md"
METHODS = ("graph", "icp", "docpfo", "kiss-icp", "kiss-icp-odometry")
WALKERS = range(1, 7)
"""Ids of the labelled persons who walk; the others stand."""
LOGS = {
    "intel": ("freiburg/intel.clf.bz2", "freiburg/intel.relations", None),
    "aces": ("freiburg/aces.clf.bz2", "freiburg/aces.relations", None),
    "fr-clinic": ("freiburg/fr-clinic_robotlaser.clf.bz2", None, None),
    "wheelchair": ("bags/general_tracking_moving_1.bag", None, None),
    "wheelchair, mcap": ("bags/general_tracking_moving_1_mcap", None, None),
    "overtakes": ("bags/overtakes_sqlite3", None, "/ego_pose"),
}
HEAD = (
    "log",
    "method",
    "scans",
    "relations within 60 s, mean / median [m]",
    "all relations [m]",
    "rotation [degrees]",
    "failed matches",
    "closures",
    "ms a scan, median / p95",
    "CPU [s]",
)


@dataclass(frozen=True)
class Arguments:
    """Command line."""

    data: Path = Path(os.environ.get("SLAMMOT_DATA", "../shared/data"))
    output: Path = TABLE
    methods: tuple[str, ...] = METHODS
    logs: tuple[str, ...] = tuple(LOGS)


def relation_cells(result: RunResult, relations: Path | None) -> list[str]:
    """Translation error within 60 s (mean, median) and over all relations; rotation over all."""
    if relations is None:
        return ["-", "-", "-"]
    truth = read_relations(relations)
    near = evaluate_relations(result.stamps, result.T_map_base, truth, max_duration_s=60.0)
    every = evaluate_relations(result.stamps, result.T_map_base, truth)
    return [
        f"{near.translation_m.mean:.4f} / {near.translation_m.median:.4f}",
        f"{every.translation_m.mean:.4f} +- {every.translation_m.std:.4f}",
        f"{every.rotation_deg.mean:.3f}",
    ]


def person_shares(bag: Path, result: RunResult) -> str:
    """Tell how many person labels of the wheelchair bag have a moving point within 0.5 m.

    A label belongs to the last scan before it by recording time, and is given in the laser's frame.
    """
    scans = list(open_log(bag))
    by_stamp = {round(scan.stamp, 6): k for k, scan in enumerate(scans)}
    found: list[tuple[int, bool]] = []
    last = None
    with AnyReader([bag]) as reader:
        for connection, _, raw in reader.messages():
            if connection.msgtype.endswith("LaserScan"):
                scan_message: Any = reader.deserialize(raw, connection.msgtype)
                stamp = scan_message.header.stamp
                last = by_stamp.get(round(stamp.sec + 1e-9 * stamp.nanosec, 6), last)
            elif connection.topic == "/ground_truth_people_tracks" and last is not None:
                message: Any = reader.deserialize(raw, connection.msgtype)
                scan = scans[last]
                place = np.array([[message.pose.position.x, message.pose.position.y]])
                person = se2.transform(np.array(scan.laser.T_base_laser), place)[0]
                points = scan.points_base()[result.is_moving_online[last][: len(scan.ranges)]]
                near = bool(len(points)) and bool(np.hypot(*(points - person).T).min() < 0.5)
                found.append((message.id, near))
    walkers = [near for person_id, near in found if person_id in WALKERS]
    return (
        f"wheelchair: {sum(near for _, near in found)} of {len(found)} person labels have a moving point within "
        f"0.5 m; of those of persons who walk, {sum(walkers)} of {len(walkers)}."
    )


def main(arguments: Arguments) -> None:
    """Write the table."""
    rows, notes = [], []
    for name in arguments.logs:
        path, relations, odom_topic = LOGS[name]
        for method in arguments.methods:
            start = time.process_time()
            result = Run(open_log(arguments.data / path, odom_topic=odom_topic), method).complete()
            cpu_s = time.process_time() - start
            step = result.stage_ms["step"]
            rows.append(
                [
                    name,
                    method,
                    str(len(result.stamps)),
                    *relation_cells(result, arguments.data / relations if relations else None),
                    str(result.n_failed_matches),
                    str(sum(edge.kind == "closure" for edge in result.edges)),
                    f"{np.median(step):.2f} / {np.percentile(step, 95):.2f}",
                    f"{cpu_s:.1f}",
                ]
            )
            if name == "wheelchair" and method == "graph":
                notes.append(person_shares(arguments.data / path, result))
            print(" | ".join(rows[-1]), file=sys.stderr)
    lines = [
        "# Recorded logs",
        "",
        "`python -m experiments.recorded_logs` on two shared cores of an AMD EPYC.",
        "",
    ]
    lines += ["| " + " | ".join(HEAD) + " |", "|" + "---|" * len(HEAD)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    lines += ["", *notes]
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Arguments))
