"""What the experiments measure of a run, as plain numbers under names."""

from functools import lru_cache
from typing import Any

import numpy as np

from experiments.common import Scores
from slammot_graph import Run
from slammot_graph.core import se2
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.evaluation import (
    TrackPoints,
    absolute_error,
    evaluate_points,
    evaluate_tracks,
)
from slammot_graph.simulation import Scenario, SimulatedLog, simulate
from slammot_graph.study.measures import map_scores, true_map

__all__ = [
    "map_scores",
    "point_scores",
    "run_method",
    "simulated",
    "step_ms",
    "trajectory_scores",
    "true_map",
    "true_positions",
    "walker_scores",
    "without_people",
]

RPE_DELTA_M = 1.0


def run_method(log: SimulatedLog, method: str) -> RunResult:
    """Run a method over a log in memory."""
    return Run(log, method).complete()


@lru_cache(maxsize=2)
def simulated(
    scenario: str | Scenario,
    seed: int,
    n_people: int | None = None,
    noise_scale: float = 1.0,
    rate_hz: float | None = None,
) -> SimulatedLog:
    """Simulate, or give the log that the last cell used."""
    return simulate(scenario, seed=seed, n_people=n_people, noise_scale=noise_scale, rate_hz=rate_hz)


@lru_cache(maxsize=2)
def without_people(
    scenario: str | Scenario, seed: int, noise_scale: float = 1.0, rate_hz: float | None = None
) -> SimulatedLog:
    """The same drive with nobody about."""
    return simulate(scenario, seed=seed, n_people=0, noise_scale=noise_scale, rate_hz=rate_hz)


def trajectory_scores(result: RunResult, T_world_base: FloatArray) -> Scores:
    """ATE and RPE by evo: `ate_m`, `rpe_m` and `rpe_deg` (root mean square, RPE over 1 m; NaN over shorter drives).

    The alignment is the planar one of `evaluation.alignment`: evo's, in space, has no answer for a straight drive.
    """
    from evo.core import metrics
    from evo.core.filters import FilterException
    from evo.core.trajectory import PosePath3D

    def path(T: FloatArray) -> PosePath3D:
        zero = np.zeros(len(T))
        half = 0.5 * T[:, 2]
        return PosePath3D(
            positions_xyz=np.column_stack([T[:, :2], zero]),
            orientations_quat_wxyz=np.column_stack([np.cos(half), zero, zero, np.sin(half)]),
        )

    T_world_map = absolute_error(result.T_map_base, T_world_base).T_world_map
    both = (path(T_world_base), path(se2.compose(T_world_map[None, :], result.T_map_base)))
    scores: Scores = {}
    metrics_by_name: tuple[tuple[str, Any], ...] = (
        ("ate_m", metrics.APE(metrics.PoseRelation.translation_part)),
        ("rpe_m", _rpe(metrics.PoseRelation.translation_part)),
        ("rpe_deg", _rpe(metrics.PoseRelation.rotation_angle_deg)),
    )
    for name, metric in metrics_by_name:
        try:
            metric.process_data(both)
        except FilterException:  # no two poses are so far apart
            scores[name] = float("nan")
            continue
        scores[name] = float(metric.get_statistic(metrics.StatisticsType.rmse))
    return scores


def _rpe(relation: Any) -> Any:
    from evo.core import metrics

    return metrics.RPE(relation, delta=RPE_DELTA_M, delta_unit=metrics.Unit.meters, all_pairs=True)


def point_scores(is_moving: BoolArray, log: SimulatedLog, is_valid: BoolArray) -> Scores:
    """Labels against the truth: `iou`, `precision`, `recall`, `static_kept`."""
    points = evaluate_points(is_moving, log.is_moving, is_valid)
    return {name: getattr(points, name) for name in ("iou", "precision", "recall", "static_kept")}


def step_ms(result: RunResult) -> float:
    """Median time of a step [ms]."""
    return float(np.median(result.stage_ms["step"]))


def true_positions(log: SimulatedLog, T_map_world: FloatArray) -> TrackPoints:
    """Where the people were who were seen, in the map."""
    seen = np.array([np.isin(np.arange(log.objects.shape[1]), ids) for ids in log.object_id])
    seen = seen.reshape(len(log.stamps), -1)
    frames, people = np.nonzero(seen)
    positions = se2.transform(T_map_world, log.objects[frames, people, :2].reshape(-1, 2))
    return TrackPoints(frames=frames, ids=people, positions=positions)


def walker_scores(result: RunResult, log: SimulatedLog) -> Scores:
    """Tracks against the people who were seen: `walker_rmse_m` and the share of their positions found."""
    T_world_map = absolute_error(result.T_map_base, log.T_world_base).T_world_map
    estimate = TrackPoints(
        frames=result.tracks[:, 9].astype(np.int64),
        ids=result.tracks[:, 1].astype(np.int64),
        positions=result.tracks[:, 2:4],
    )
    scores = evaluate_tracks(true_positions(log, se2.inverse(T_world_map)), estimate)
    found = scores.n_matches / scores.n if scores.n else float("nan")
    return {"walker_rmse_m": scores.position_rmse_m, "walkers_found": found, "mota": scores.mota}
