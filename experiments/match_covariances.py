"""Whose covariance of a match is right? Ours, small_gicp's Hessian, Karto's responses, kiss-icp's constant."""

import math
import sys
from collections.abc import Callable
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from experiments.common import Options, Scores, main, run_cells
from experiments.tables import Table, number, write_tables
from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation.consistency import average_nees, nees, nees_and_coverage, pose_errors
from slammot_graph.mapping.local_map import LocalMap, LocalMapConfig, make_keyframe
from slammot_graph.registration.point_to_line import PointToLineConfig, match_to_local_map
from slammot_graph.simulation import simulate

try:
    small_gicp: ModuleType | None = import_module(
        "small_gicp"
    )  # left out of the table where it is not installed
except ImportError:
    small_gicp = None

SCENARIOS = ("lab", "office", "hall", "corridor")
FULL_SEEDS, FIRST_SEED = 20, 2000
EVERY, AHEAD = 25, 5
"""Each so-manieth scan is matched onto the one so many before it."""

PRIOR = np.diag(np.square((0.05, 0.05, 0.02)))
"""Of the starts, which are drawn from it around the truth."""

KISS_VARIANCE = 0.1
"""kiss-icp's ROS node publishes this for position and heading alike."""

RESOLUTION_M, SMEAR_M, REACH_M = 0.01, 0.03, 0.15
TURN_STEP_RAD, TURN_REACH_RAD, MIN_RESPONSE = math.radians(0.2), math.radians(2.0), 0.1
"""Karto's fine search; poses whose response is by less than the last one below the best count."""

HEIGHTS_M = (-0.1, 0.0, 0.1)
"""small_gicp's points have three coordinates: a wall of one height would be a line without a normal."""

METHODS = {
    "ours": "`graph`'s match",
    "gicp": "small_gicp, inverse of its Hessian",
    "scaled": "small_gicp, scaled by its residuals",
    "karto": "Karto's response-weighted covariance, at our pose",
    "kiss": "kiss-icp's constant 0.1, at our pose",
}


def cell(scenario: str, seed: int) -> Scores:
    """Mean NEES and coverage over a run's pairs of scans, method by method; static points only."""
    log = simulate(scenario, seed=seed)
    rng = np.random.default_rng(seed)
    found: dict[str, list[tuple[FloatArray, FloatArray]]] = {name: [] for name in METHODS}
    scans = list(log)
    for k in range(AHEAD, len(scans), EVERY):
        first, scan = scans[k - AHEAD], scans[k]
        used = [s.is_valid() & ~log.is_moving[s.index] for s in (first, scan)]
        local_map = LocalMap(LocalMapConfig())
        keyframe = make_keyframe(
            0, se2.IDENTITY, first.points_base(), used[0], first.laser, local_map.config, first.origins_base
        )
        local_map.start([keyframe])
        truth = se2.between(log.T_world_base[k - AHEAD], log.T_world_base[k])
        start = se2.compose(truth, se2.exp(rng.multivariate_normal(np.zeros(3), PRIOR)))
        match, _, _ = match_to_local_map(
            scan.points_base(), used[1], scan.origins_base, local_map, start, PRIOR, PointToLineConfig()
        )
        if match.status != "converged":
            continue
        error = _error(match.T_ref_base, truth)
        points = first.points_base()[used[0]], scan.points_base()[used[1]]
        found["ours"].append((error, match.cov))
        found["kiss"].append((error, KISS_VARIANCE * np.eye(3)))
        found["karto"].append((error, karto_covariance(*points, match.T_ref_base)))
        if small_gicp is not None:
            T, cov, variance = gicp(small_gicp, *points, start)
            found["gicp"].append((_error(T, truth), cov))
            found["scaled"].append((_error(T, truth), variance * cov))
    scores: Scores = {}
    for name, pairs in found.items():
        errors, covs = (
            np.array([pair[i] for pair in pairs]).reshape(-1, *shape)
            for i, shape in enumerate(((3,), (3, 3)))
        )
        scores[f"{name} nees"], scores[f"{name} covered"] = nees_and_coverage(errors, covs)
        scores[f"{name} median"] = float(np.median(nees(errors, covs))) if pairs else math.nan
    return scores


def _error(T: FloatArray, truth: FloatArray) -> FloatArray:
    return np.asarray(pose_errors(T[None], truth[None])[0])


def gicp(
    library: ModuleType, target: FloatArray, source: FloatArray, T_start: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Pose (3,) of small_gicp's point-to-plane match, covariance (3, 3) for residuals of 1 m, their variance [m^2].

    Each wall counts once, whatever its heights.
    """
    c, s = math.cos(T_start[2]), math.sin(T_start[2])
    start = np.eye(4)
    start[:2] = [[c, -s, 0.0, T_start[0]], [s, c, 0.0, T_start[1]]]
    result: Any = library.align(
        _raised(target),
        _raised(source),
        init_T_target_source=start,
        registration_type="PLANE_ICP",
        downsampling_resolution=0.02,
        max_correspondence_distance=0.4,
        num_threads=1,
    )
    T: FloatArray = np.asarray(result.T_target_source, dtype=np.float64)
    planar = [3, 4, 2]  # rotations come first; x, y, heading
    variance = float(2.0 * result.error / max(result.num_inliers, 1))
    H = np.array(result.H)[np.ix_(planar, planar)] / len(HEIGHTS_M)
    return (
        np.array([T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0])]),
        np.asarray(np.linalg.pinv(H), dtype=np.float64),
        variance,
    )


def _raised(points: FloatArray) -> FloatArray:
    return np.vstack([np.column_stack([points, np.full(len(points), height)]) for height in HEIGHTS_M])


def karto_covariance(target: FloatArray, source: FloatArray, T: FloatArray) -> FloatArray:
    """(3, 3) covariance by the responses of a correlation around a pose (3,), as of Karto's scan matcher.

    Konolige et al. 2010 (open_karto, `ComputePositionalCovariance`, `ComputeAngularCovariance`): variances of the
    offsets weighted by their responses, divided by the best one; in the target's axes, turned into the body frame.
    """
    low = target.min(axis=0) - 0.5
    size = np.ceil((target.max(axis=0) + 0.5 - low) / RESOLUTION_M).astype(np.int64) + 1
    grid = np.zeros(size)
    reach = round(3.0 * SMEAR_M / RESOLUTION_M)
    cells = np.floor((target - low) / RESOLUTION_M).astype(np.int64)
    for i in range(-reach, reach + 1):
        for j in range(-reach, reach + 1):
            value = math.exp(-0.5 * (i * i + j * j) * (RESOLUTION_M / SMEAR_M) ** 2)
            np.maximum.at(grid, (cells[:, 0] + i, cells[:, 1] + j), value)

    def response(x: float, y: float, turn: float) -> float:
        at = np.floor((se2.transform(T + np.array([x, y, turn]), source) - low) / RESOLUTION_M).astype(
            np.int64
        )
        inside = ((at >= 0) & (at < size)).all(axis=1)
        return float(grid[at[inside, 0], at[inside, 1]].sum() / len(source))

    steps = RESOLUTION_M * np.arange(-round(REACH_M / RESOLUTION_M), round(REACH_M / RESOLUTION_M) + 1)
    offsets = np.array([(x, y) for x in steps for y in steps])
    responses = np.array([response(x, y, 0.0) for x, y in offsets])
    best = float(responses.max())
    w = np.where(responses >= best - MIN_RESPONSE, responses, 0.0)
    centre = offsets[np.argmax(responses)]
    xy = np.einsum("n,ni,nj->ij", w, offsets - centre, offsets - centre) / w.sum()
    least = 0.1 * RESOLUTION_M**2
    xy[[0, 1], [0, 1]] = np.maximum(xy[[0, 1], [0, 1]], least)
    turns = TURN_STEP_RAD * np.arange(
        -round(TURN_REACH_RAD / TURN_STEP_RAD), round(TURN_REACH_RAD / TURN_STEP_RAD) + 1
    )
    by_turn = np.array([response(0.0, 0.0, turn) for turn in turns])
    w = np.where(by_turn >= by_turn.max() - MIN_RESPONSE, by_turn, 0.0)
    cov = np.zeros((3, 3))
    R = se2.rotation(T[2])
    cov[:2, :2] = R.T @ xy @ R / best
    cov[2, 2] = max(float((w * turns**2).sum() / w.sum()), 0.1 * TURN_STEP_RAD**2)
    return cov


def experiment(options: Options) -> None:
    """Average NEES and coverage of four covariances of a match on the same pairs of simulated scans."""
    seeds = [FIRST_SEED + seed for seed in options.seed_range(FULL_SEEDS)]
    names = SCENARIOS[:1] if options.quick else SCENARIOS
    cells = {f"{name} {seed}": {"scenario": name, "seed": seed} for name in names for seed in seeds}
    scores = run_cells("match_covariances", cell, cells, options)

    def mean(scenario: str, figure: str) -> float:
        return float(np.mean([scores[f"{scenario} {seed}"][figure] for seed in seeds]))

    methods = [method for method in METHODS if method not in ("gicp", "scaled") or small_gicp is not None]
    bounds = average_nees(np.zeros(1), dof=3, n_independent=len(seeds))
    notes = [
        f"{len(seeds)} runs each, seeds from {FIRST_SEED} on; every {EVERY}th scan onto the one {AHEAD} before it,"
        " points on people left out, matches that leave a direction open too. A consistent covariance has an average"
        f" NEES of 3 ({bounds.lower:.2f} to {bounds.upper:.2f} if a run is worth one sample) and a median of 2.37.",
    ]
    if small_gicp is None:
        notes.append("small_gicp is not installed (`pip install slammot-graph[matchers]`): left out.")
    rows = [_row(METHODS[method], name, method, mean) for method in methods for name in names]
    columns = ["covariance", "scenario", "average NEES", "median NEES", "within 95%"]
    tables = [Table(heading="Covariances of a match", columns=columns, rows=rows)]
    write_tables("match_covariances", "Covariances of a match, compared", notes, tables, options)


def _row(what: str, scenario: str, method: str, mean: Callable[[str, str], float]) -> list[str]:
    figures = [mean(scenario, f"{method} {figure}") for figure in ("nees", "median", "covered")]
    return [what, scenario, number(figures[0], 2), number(figures[1], 2), f"{figures[2]:.1%}"]


if __name__ == "__main__":
    sys.exit(main(experiment))
