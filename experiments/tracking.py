"""Tracks of simulated people against the truth, at the time and after the run, and what each part gives.

Stone Soup's GNN and JPDA follow the same clusters where the extra ``trackers`` is installed; the recorded logs are left
out where they are not there.
"""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from experiments import measures, recorded_tracks, stone_soup
from experiments.common import Options, Scores, main, run_cells, say
from experiments.tables import Table, median_interval, write_tables
from slammot_graph import Run, get_method
from slammot_graph.core.errors import InputError
from slammot_graph.evaluation import evaluate_run_tracks, read_objects
from slammot_graph.evaluation.objects import ObjectScores
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.simulation import SimulatedLog
from slammot_graph.tracking.factory import TrackerConfig
from slammot_graph.tracking.segment_config import SegmentTrackerConfig
from slammot_graph.tracking.tracker import KalmanTrackerConfig

SCENARIOS = ("one-walker", "two-walkers", "lab", "hall", "office", "corridor", "building")
ABLATED = ("two-walkers", "lab")
QUICK_SCENARIOS = ("one-walker",)
FIRST_SEED = 10
"""Constants were chosen on the seeds before it."""

FULL_SEEDS, ABLATED_SEEDS = 10, 5

_ALL = SegmentTrackerConfig()
TRACKERS: dict[str, TrackerConfig] = {
    "people": _ALL,
    "clusters": KalmanTrackerConfig(),
    "legs not joined": replace(_ALL, body_m=0.01),
    "births beside": replace(_ALL, apart_m=0.0),
    "twins kept": replace(_ALL, max_twin_s=1e6),
    "shown for 1 s": replace(_ALL, shown_s=1.0),
    "ends after 1 s": replace(_ALL, max_missed_s=1.0),
    "one gate in metres": replace(_ALL, max_jump_m=0.5),
    "who stands is lost": replace(_ALL, standing_speed_m_s=1e-9),
}
COMPARED = ("people", "clusters")
ONLINE_ONLY = stone_soup.TRACKERS if stone_soup.is_installed() else ()
JOINT_SCENARIOS = ("one-walker", "two-walkers", "lab", "hall")
"""Of the others Stone Soup takes hours."""
FIGURES = ("MOTA", "IDF1", "HOTA", "ids", "position_m", "velocity_m_s", "nees")
LABELS = ("online", "final")


def cell(scenario: str, seed: int, tracker: str) -> Scores:
    """Run `graph` with one tracker over one log."""
    log = measures.simulated(scenario, seed)
    config = get_method("graph").config
    assert isinstance(config, PipelineConfig)
    if tracker in stone_soup.TRACKERS:
        return _stone_soup_cell(log, replace(config, tracker=TRACKERS["clusters"]), tracker)
    result = Run(log, "graph", config=replace(config, tracker=TRACKERS[tracker])).complete()
    scores: Scores = {"objects_ms": float(np.median(result.stage_ms["objects"]))}
    truth = read_objects(log, result.is_valid)
    assert truth is not None
    for labels, rows, poses in (
        ("online", result.tracks_online, result.T_map_base_online),
        ("final", result.tracks, result.T_map_base),
    ):
        scores |= _figures(labels, evaluate_run_tracks(result.stamps, poses, rows, truth))
    return scores


def _figures(labels: str, one: ObjectScores) -> Scores:
    of = one.appearance
    figures = (
        *(of.mota, of.idf1, of.hota, one.ids_per_appearance),
        *(one.position_rmse_m, one.velocity_rmse_m_s, one.nees),
    )
    return {f"{labels} {name}": value for name, value in zip(FIGURES, figures, strict=True)}


def _stone_soup_cell(log: SimulatedLog, config: PipelineConfig, tracker: str) -> Scores:
    truth = read_objects(log, np.array([scan.is_valid(config.max_range_m) for scan in log]))
    assert truth is not None
    stamps, poses, rows = stone_soup.tracks_of(log, config, tracker)
    return _figures("online", evaluate_run_tracks(stamps, poses, rows, truth)) | {"objects_ms": math.nan}


def recorded_cell(log: str, path: str) -> Scores:
    """Run `graph` over a recorded log."""
    is_vehicle = log in recorded_tracks.VEHICLE_BAGS
    return (recorded_tracks.vehicle_scores if is_vehicle else recorded_tracks.walker_scores)(Path(path))


def recorded_tables(options: Options) -> list[Table]:
    """Tables of the recorded logs that are there."""
    cells = {}
    for log in (*recorded_tracks.VEHICLE_BAGS, "wheelchair"):
        is_vehicle = log in recorded_tracks.VEHICLE_BAGS
        name, collection = (f"{log}.bag", "datmo") if is_vehicle else (recorded_tracks.WALKER_BAG, "bags")
        try:
            cells[log] = {"log": log, "path": str(options.recorded(name, collection))}
        except InputError as error:
            say(f"{log} left out: {error}")
    scores = run_cells("tracking_recorded", recorded_cell, cells, options)
    tables = []
    if vehicles := [log for log in recorded_tracks.VEHICLE_BAGS if log in scores]:
        figures = ("share", "ids", "position_m", "spread_m", "pull_m", "false")
        rows = [
            [f"{log}, {labels}", *(f"{scores[log][f'{labels} {figure}']:.3g}" for figure in figures)]
            for log in vehicles
            for labels in LABELS
        ]
        columns = [
            *("log, tracks", "share of scans with one identity", "identities"),
            *("from its marker [m]", "less the marker's mean offset [m]", "of it towards the laser [m]"),
            "false tracks",
        ]
        tables.append(Table(heading="recorded: the other car", columns=columns, rows=rows))
    if "wheelchair" in scores:
        one = scores["wheelchair"]
        rows = [[labels, f"{one[f'{labels} near']:.0f} of {one['labels']:.0f}"] for labels in LABELS]
        columns = ["tracks", "labels of walking persons within 0.5 m of a track"]
        tables.append(Table(heading="recorded: wheelchair", columns=columns, rows=rows))
    return tables


def key(scenario: str, seed: int, tracker: str) -> str:
    """Name of a cell."""
    return f"{scenario} {seed} {tracker}"


def experiment(options: Options) -> None:
    """Tracks of all scenarios against the truth; each part of the tracker switched off."""
    seeds = range(FIRST_SEED, FIRST_SEED + len(options.seed_range(FULL_SEEDS)))
    few = seeds[:ABLATED_SEEDS]
    scenarios = QUICK_SCENARIOS if options.quick else SCENARIOS
    ablated = QUICK_SCENARIOS if options.quick else ABLATED
    wanted = [(scenario, tracker, seeds) for scenario in scenarios for tracker in COMPARED]
    wanted += [
        (scenario, tracker, seeds)
        for scenario in scenarios
        if scenario in JOINT_SCENARIOS
        for tracker in ONLINE_ONLY
    ]
    wanted += [
        (scenario, tracker, few) for scenario in ablated for tracker in TRACKERS if tracker not in COMPARED
    ]
    cells = {
        key(scenario, seed, tracker): {"scenario": scenario, "seed": seed, "tracker": tracker}
        for scenario, tracker, own in wanted
        for seed in own
    }
    scores = run_cells("tracking", cell, cells, options)

    def row(scenario: str, tracker: str, labels: str, own: range) -> list[str]:
        found = [scores[key(scenario, seed, tracker)] for seed in own]
        return [
            f"{tracker}, {labels}",
            *(median_interval([one[f"{labels} {figure}"] for one in found]) for figure in FIGURES),
            median_interval([one["objects_ms"] for one in found]),
        ]

    columns = [
        "tracker, tracks",
        *("MOTA", "IDF1", "HOTA", "ids an appearance", "position [m]", "velocity [m/s]", "NEES (2 is right)"),
        "ms/scan",
    ]
    tables = [
        Table(
            heading=scenario,
            columns=columns,
            rows=[
                *(row(scenario, tracker, labels, seeds) for tracker in COMPARED for labels in LABELS),
                *(
                    row(scenario, tracker, "online", seeds)
                    for tracker in ONLINE_ONLY
                    if scenario in JOINT_SCENARIOS
                ),
            ],
        )
        for scenario in scenarios
    ]
    tables += [
        Table(
            heading=f"{scenario}: what each part gives ({len(few)} seeds)",
            columns=columns,
            rows=[
                row(scenario, tracker, labels, few)
                for labels in LABELS
                for tracker in TRACKERS
                if tracker != "clusters"
            ],
        )
        for scenario in ablated
    ]
    if not options.quick:
        tables += recorded_tables(options)
    notes = [
        f"Seeds {seeds[0]} to {seeds[-1]}: median [95% bootstrap interval]; constants were chosen on seeds 0 to 9 of"
        " two-walkers, lab, office and corridor. A person counts where at least 3 valid beams hit him, a track follows"
        " him within 0.5 m; after 3 s out of sight he is a new appearance. IDF1, HOTA and identities are those of"
        " appearances."
    ]
    write_tables("tracking", "Tracks of people", notes, tables, options)


if __name__ == "__main__":
    sys.exit(main(experiment))
