"""`graph` on recorded logs with a reference, with the wheels and by the laser alone, at one frozen set of settings."""

import sys
from pathlib import Path

from experiments.common import Options, Scores, main, run_cells
from experiments.freiburg import PUBLISHED
from experiments.tables import Table, number, write_tables
from slammot_graph import Run, open_log
from slammot_graph.evaluation import absolute_error, evaluate_relations, read_relations

WITH_RELATIONS = ("intel", "aces", "fr079")
WITH_POSES = ("acapulco", "edmonton")
QUICK_LOGS, QUICK_SCANS = ("fr079",), 400
SOURCES = {"wheels": True, "laser alone": False}


def cell(log: str, relations: str | None, source: str, max_scans: int | None) -> Scores:
    """Run `graph` over (the first scans of) a log, with its odometry or without."""
    reader = open_log(Path(log), odometry=SOURCES[source])
    result = Run(reader, "graph", max_scans=max_scans).complete()
    if relations is None:
        translation = absolute_error(result.T_map_base, result.T_map_odom_base).translation_m
        return {"mean_m": translation.rmse, "worst_m": translation.max}
    true = read_relations(Path(relations))
    scores = evaluate_relations(result.stamps, result.T_map_base, true)
    near = evaluate_relations(result.stamps, result.T_map_base, true, max_duration_s=10.0)
    return {
        "mean_m": scores.translation_m.mean,
        "std_m": scores.translation_m.std,
        "mean_deg": scores.rotation_deg.mean,
        "near_m": near.translation_m.mean,
    }


def experiment(options: Options) -> None:
    """With and without wheels, all logs."""
    logs = QUICK_LOGS if options.quick else WITH_RELATIONS
    max_scans = QUICK_SCANS if options.quick else None
    cells = {
        f"{log} {source}": {
            "log": str(options.recorded(f"{log}.clf.bz2")),
            "relations": str(options.recorded(f"{log}.relations")),
            "source": source,
            "max_scans": max_scans,
        }
        for log in logs
        for source in SOURCES
    }
    with_poses = () if options.quick else WITH_POSES
    cells |= {
        f"{log} wheels": {
            "log": str(options.recorded(f"{log}-corrected.log.gz", "ple")),
            "relations": None,
            "source": "wheels",
            "max_scans": None,
        }
        for log in with_poses
    }
    scores = run_cells("any_robot", cell, cells, options)
    rows = []
    for log in logs:
        cartographer = PUBLISHED[log][0]
        for source in SOURCES:
            s = scores[f"{log} {source}"]
            rows.append(
                [
                    log,
                    source,
                    f"{number(s['mean_m'], 4)} +- {number(s['std_m'], 4)}",
                    number(s["mean_deg"], 3),
                    number(s["near_m"], 4),
                    f"{cartographer[1]}, {cartographer[2]}",
                ]
            )
    relations = Table(
        heading="True relations",
        columns=[
            "log",
            "by",
            "translation [m]",
            "rotation [degrees]",
            "within 10 s [m]",
            "Cartographer (published) [m], [degrees]",
        ],
        rows=rows,
    )
    tables = [relations]
    if with_poses:
        rows = [
            [log, *(number(scores[f"{log} wheels"][name], 3) for name in ("mean_m", "worst_m"))]
            for log in with_poses
        ]
        tables.append(
            Table(
                heading="Sparse scans in halls: against the corrected poses of the log's own file",
                columns=["log", "ATE [m]", "largest error [m]"],
                rows=rows,
            )
        )
    notes = [
        "`graph` with its default settings. Relations of Kuemmerle et al. 2009, mean +- standard deviation. By the"
        " laser alone: `--odometry off`. The corrected logs of acapulco and edmonton hold poses where others hold"
        " odometry: the run is given them as odometry, and should make them no worse."
    ]
    write_tables("any_robot", "Any robot: with the wheels, and without", notes, tables, options)


if __name__ == "__main__":
    sys.exit(main(experiment))
