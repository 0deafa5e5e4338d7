"""True poses: found by their times, and the error against them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GridMap
from slammot_graph.core.saved_run import RunFolder
from slammot_graph.evaluation import (
    TruePath,
    absolute_error,
    associate,
    evaluate_truth,
    find_truth,
    read_truth,
)
from slammot_graph.evaluation.truth import true_poses_of
from slammot_graph.logs import write_npz_log
from tests.rooms import ListLog, drive, truth_from_start


def run_of(log: Path | None, stamps: np.ndarray) -> RunFolder:
    return RunFolder(
        path=Path("run"),
        method="graph",
        stamps=stamps,
        T_map_base=np.zeros((len(stamps), 3)),
        points=None,
        tracks=np.zeros((0, 9)),
        grid=GridMap(p_occupied=np.zeros((0, 0)), resolution_m=0.05, origin=np.zeros(2)),
        cov_map=None,
        summary={} if log is None else {"log": str(log)},
    )


def write_log(path: Path, *, are_estimates: bool = False, with_poses: bool = True) -> Path:
    write_npz_log(
        path,
        stamps=[0.0, 0.5, 1.0],
        ranges=np.ones((3, 5)),
        angle_min=-1.0,
        angle_increment=0.5,
        range_min=0.1,
        range_max=10.0,
        odometry=np.zeros((3, 3)),
        poses=np.arange(9.0).reshape(3, 3) if with_poses else None,
        poses_are_estimates=are_estimates,
    )
    return path


def test_poses_find_the_true_ones_nearest_in_time(rng: np.random.Generator) -> None:
    """In any order: stamps of recorded logs run backward here and there."""
    stamps, true_stamps = rng.uniform(0.0, 5.0, 200), rng.uniform(0.0, 5.0, 150)
    distance = np.abs(stamps[:, None] - true_stamps)
    i, j = associate(stamps, true_stamps, max_difference_s=0.02)
    np.testing.assert_array_equal(i, np.flatnonzero(distance.min(axis=1) <= 0.02))
    np.testing.assert_array_equal(j, distance.argmin(axis=1)[i])
    assert 20 < len(i) < 180
    for pair in (associate(stamps, np.zeros(0)), associate(np.zeros(0), true_stamps)):
        assert [len(indices) for indices in pair] == [0, 0]


def test_the_error_is_that_of_the_poses_with_a_true_one(rng: np.random.Generator) -> None:
    true_stamps = np.arange(20.0)
    T_world_base = se2.compose(np.array([3.0, 1.0, 0.7]), rng.normal(0.0, 2.0, (20, 3)))
    chosen = np.array([4, 0, 11, 12, 13])
    T_map_base = se2.compose(np.array([-1.0, 0.0, 0.2]), T_world_base[chosen]) + rng.normal(0.0, 0.01, (5, 3))
    stamps = true_stamps[chosen] + np.array([0.009, -0.009, 0.0, 0.02, 0.0])
    scores = evaluate_truth(stamps, T_map_base, true_stamps, T_world_base)
    is_near = [0, 1, 2, 4]
    expected = absolute_error(T_map_base[is_near], T_world_base[chosen[is_near]])
    assert scores.n_unmatched == 1
    assert scores.error.translation_m == expected.translation_m
    assert scores.error.rotation_deg == expected.rotation_deg
    nothing = evaluate_truth(stamps + 0.5, T_map_base, true_stamps, T_world_base)
    assert (nothing.error.translation_m.n, nothing.n_unmatched) == (0, 5)
    assert np.isnan(nothing.error.translation_m.rmse)


def test_the_truth_of_a_log_is_collected() -> None:
    log = drive(5)
    truth = read_truth(log)
    np.testing.assert_array_equal(truth.stamps, [scan.stamp for scan in log])
    np.testing.assert_allclose(se2.between(truth.T_world_base[0], truth.T_world_base), truth_from_start(log))
    without = ListLog([replace(scan, truth=None) for scan in log])
    with pytest.raises(InputError, match="has no true poses"):
        read_truth(without)


def test_the_truth_is_found_in_the_log_that_all_runs_name(tmp_path: Path) -> None:
    path, stamps = write_log(tmp_path / "log.npz"), np.array([0.0, 0.5])
    found = find_truth([run_of(path, stamps), run_of(None, stamps)])
    assert found is not None
    assert (found.path, len(found.stamps)) == (path, 3)
    estimates = write_log(tmp_path / "estimates.npz", are_estimates=True)
    without = write_log(tmp_path / "without.npz", with_poses=False)
    for runs in (
        [run_of(path, stamps), run_of(estimates, stamps)],
        [run_of(path, stamps + 0.1)],
        [run_of(path, np.arange(4) * 0.5)],
        [run_of(estimates, stamps)],
        [run_of(without, stamps)],
        [run_of(tmp_path / "gone.npz", stamps)],
        [run_of(tmp_path / "some.bag", stamps)],
        [run_of(None, stamps)],
    ):
        assert find_truth(runs) is None


def test_a_run_takes_the_first_true_poses() -> None:
    truth = TruePath(path=Path("log"), stamps=np.arange(3.0), T_world_base=np.arange(9.0).reshape(3, 3))
    np.testing.assert_array_equal(true_poses_of(run_of(None, np.arange(2.0)), truth), truth.T_world_base[:2])
    for stamps in (np.arange(4.0), np.arange(2.0) + 0.1):
        with pytest.raises(InputError, match="other times"):
            true_poses_of(run_of(None, stamps), truth)
