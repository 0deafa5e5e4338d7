"""What a cell of a study computes: one method over one log, scored by all that the log knows the truth of."""

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from slammot_graph.baselines.kiss_icp import KissIcpConfig
from slammot_graph.core import se2
from slammot_graph.core.config import from_plain, to_plain
from slammot_graph.core.errors import InputError, SlammotError
from slammot_graph.core.results import GridMap, RunResult
from slammot_graph.core.stamps import have_same_times
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import (
    TrueObjects,
    absolute_error,
    evaluate_map,
    evaluate_points,
    evaluate_relations,
    evaluate_run_tracks,
    evaluate_truth,
    read_relations,
    relative_error,
)
from slammot_graph.logs import open_log
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid
from slammot_graph.methods import Config
from slammot_graph.pipeline_config import PipelineConfig
from slammot_graph.run import Run
from slammot_graph.run_folder.tum import read_trajectory
from slammot_graph.simulation import SimulatedLog, inject, simulate

RPE_DELTA_M = 1.0
TRACK_POSE = slice(0, 9)


@lru_cache(maxsize=64)
def config_of(text: str) -> Config:
    """Turn what `config_text` gave back into a configuration."""
    values = json.loads(text)
    kind = values.pop("kind")
    if kind == KissIcpConfig.__name__:
        return from_plain(values, KissIcpConfig())
    return from_plain(values, PipelineConfig())


def config_text(config: Config) -> str:
    """Strict JSON of a configuration, with its kind; the same settings give the same text."""
    return json.dumps({"kind": type(config).__name__, **to_plain(config)}, sort_keys=True, allow_nan=False)


def simulated_cell(scenario: str, seed: int, config: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Run a configuration over a simulated log, and score everything.

    Parameters
    ----------
    scenario : str
    seed : int
    config : str
        From `config_text`.
    options : mapping
        Of `simulate`: `n_people`, `noise_scale`, `rate_hz`, `n_laps`, `laser`, `sweep`.
    """
    key = (scenario, seed, tuple(sorted(options.items())))
    log = _simulated(key)
    result = completed(Run(log, config=config_of(config)))
    return {**made_scores(result, log), **map_scores(result, log, _without_people(key)), **counts(result)}


def recorded_cell(  # noqa: PLR0913  # what is known of a log, each with a default
    log: str,
    config: str,
    *,
    seed: int | None = None,
    people: int = 0,
    odometry: bool = True,
    max_scans: int | None = None,
    trajectory: str | None = None,
    relations: str | None = None,
    truth: str | None = None,
) -> dict[str, Any]:
    """Run a configuration over a recorded log, or one with people put in, and score what is known.

    Parameters
    ----------
    log, trajectory, relations, truth : str
        Paths: of the log, of the poses that people are put in at, of true relations, of true poses.
    config : str
        From `config_text`.
    seed, people : int
        Of the people who are put in.
    odometry : bool
    max_scans : int
    """
    if people:
        if trajectory is None or seed is None:
            raise InputError(f"{log}: people are put in at the poses of a trajectory, with a seed")
        made = _injected(log, odometry, people, seed, max_scans, trajectory)
        result = completed(Run(made, config=config_of(config)))
        scores = {
            name: value for name, value in made_scores(result, made).items() if name[:3] not in ("ate", "rpe")
        }
    else:
        reader = open_log(log, odometry=odometry)
        result = completed(Run(reader, config=config_of(config), max_scans=max_scans))
        scores = {}
    if relations is not None:
        of = evaluate_relations(result.stamps, result.T_map_base, read_relations(relations))
        scores |= {
            "relations_m": of.translation_m.mean,
            "relations_std_m": of.translation_m.std,
            "relations_deg": of.rotation_deg.mean,
            "n_relations": of.translation_m.n,
        }
    if truth is not None:
        stamps, poses = read_trajectory(Path(truth))
        error = evaluate_truth(result.stamps, result.T_map_base, stamps, poses).error
        scores |= {"ate_m": error.translation_m.rmse, "ate_deg": error.rotation_deg.rmse}
    return {**scores, **counts(result)}


def completed(run: Run) -> RunResult:
    """Run to the end; what cannot be computed there, such as a map too large for one picture, fails no cell.

    Raises
    ------
    SlammotError
        The run ended before the log did.
    """
    try:
        return run.complete()
    except SlammotError:
        if not run.is_complete:
            raise
        return run.result()


def made_scores(result: RunResult, log: SimulatedLog) -> dict[str, Any]:
    """Trajectory, labels and tracks against the truth of a log that was made."""
    n = len(result.stamps)
    if not have_same_times(result.stamps, log.stamps):
        raise InputError(f"{log.path}: the run has other scans than the log")
    poses = log.T_world_base[:n]
    absolute = absolute_error(result.T_map_base, poses)
    relative = relative_error(result.T_map_base, poses, delta=RPE_DELTA_M, unit="m")
    points = evaluate_points(result.is_moving, log.is_moving[:n], result.is_valid)
    objects = TrueObjects.of_beams(
        stamps=log.stamps[:n],
        T_world_base=poses,
        objects=log.objects[:n],
        object_id=log.object_id[:n],
        is_valid=result.is_valid,
    )
    tracks = evaluate_run_tracks(result.stamps, result.T_map_base, result.tracks[:, TRACK_POSE], objects)
    return {
        "ate_m": absolute.translation_m.rmse,
        "ate_deg": absolute.rotation_deg.rmse,
        "rpe_m": relative.translation_m.rmse,
        "rpe_deg": relative.rotation_deg.rmse,
        "iou": points.iou,
        "precision": points.precision,
        "recall": points.recall,
        "static_kept": points.static_kept,
        "mota": tracks.appearance.mota,
        "idf1": tracks.appearance.idf1,
        "hota": tracks.appearance.hota,
        "track_m": tracks.position_rmse_m,
    }


def map_scores(result: RunResult, log: SimulatedLog, clean: SimulatedLog) -> dict[str, Any]:
    """Compare the map with the one of the same drive without people at true poses."""
    T_world_map = absolute_error(result.T_map_base, log.T_world_base).T_world_map
    T_map_base = se2.compose(se2.inverse(T_world_map)[None, :], clean.T_world_base)
    scores = evaluate_map(result.grid, true_map(clean, T_map_base))
    return {"ghosts_per_m2": scores.ghosts_per_m2, "lost_per_m2": scores.lost_walls_per_m2}


def true_map(log: SimulatedLog, T_map_base: FloatArray) -> GridMap:
    """Render all scans of a log at given poses."""
    grid = OccupancyGrid(GridConfig())
    for scan, T in zip(log, T_map_base, strict=True):
        is_valid = scan.is_valid(40.0)
        ends = se2.transform(T, np.vstack([scan.laser.origin_base, scan.points_base()]))
        grid.update(scan.index, ends[0], ends[1:], is_valid, is_valid)
    return grid.to_map()


def counts(result: RunResult) -> dict[str, Any]:
    """What a run counts, whatever the log."""
    return {
        "n_scans": len(result.stamps),
        "n_closures": sum(edge.kind == "closure" for edge in result.edges),
        "n_failed_matches": result.n_failed_matches,
    }


_Key = tuple[str, int, tuple[tuple[str, Any], ...]]


@lru_cache(maxsize=2)
def _simulated(key: _Key) -> SimulatedLog:
    scenario, seed, options = key
    return simulate(scenario, seed=seed, **dict(options))


@lru_cache(maxsize=2)
def _without_people(key: _Key) -> SimulatedLog:
    scenario, seed, options = key
    return simulate(scenario, seed=seed, **{**dict(options), "n_people": 0})


@lru_cache(maxsize=1)
def _injected(
    log: str, odometry: bool, people: int, seed: int, max_scans: int | None, trajectory: str
) -> SimulatedLog:
    _, poses = read_trajectory(Path(trajectory))
    return inject(open_log(log, odometry=odometry), poses, n_people=people, seed=seed, max_scans=max_scans)
