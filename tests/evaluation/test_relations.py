import bz2
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.evaluation import Relations, evaluate_relations, read_relations


def relations(rows: list[tuple[float, float, float, float, float]]) -> Relations:
    table = np.array(rows).reshape(-1, 5)
    return Relations(stamps_from=table[:, 0], stamps_to=table[:, 1], T_from_to=table[:, 2:])


def test_a_trajectory_that_keeps_its_relations_has_no_error(rng: np.random.Generator) -> None:
    stamps = rng.permutation(50).astype(float)  # stamps need no order
    poses = rng.normal(size=(50, 3)) * [10.0, 10.0, 2.0]
    i, j = rng.integers(0, 50, (2, 30))
    true = Relations(stamps_from=stamps[i], stamps_to=stamps[j], T_from_to=se2.between(poses[i], poses[j]))
    scores = evaluate_relations(stamps, poses, true)
    assert scores.translation_m.n == scores.n_relations == 30
    assert scores.n_unmatched == 0
    assert scores.translation_m.max == pytest.approx(0.0, abs=1e-9)
    assert scores.rotation_deg.max == pytest.approx(0.0, abs=1e-6)


def test_errors_of_known_size_and_the_time_limit() -> None:
    stamps = np.array([0.0, 5.0, 100.0])
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.3, 0.1], [2.0, 0.0, 0.0]])
    true = relations([(0, 5, 1, 0, 0), (100, 0, -2, 0.4, 0)])
    scores = evaluate_relations(stamps, poses, true)
    assert scores.translation_m.mean == pytest.approx(0.35)
    assert scores.translation_m.std == pytest.approx(0.05)
    assert scores.rotation_deg.max == pytest.approx(np.degrees(0.1))
    short = evaluate_relations(stamps, poses, true, max_duration_s=10.0)
    assert (short.n_relations, short.translation_m.n) == (1, 1)
    assert short.translation_m.median == pytest.approx(0.3)


def test_times_match_to_a_hundred_thousandth_and_the_rest_is_counted() -> None:
    stamps = np.array([10.0, 20.0])
    true = relations([(10.000009, 19.999991, 0, 0, 0), (10.00002, 20, 0, 0, 0), (10, 99, 0, 0, 0)])
    scores = evaluate_relations(stamps, np.zeros((2, 3)), true)
    assert (scores.translation_m.n, scores.n_relations, scores.n_unmatched) == (1, 3, 2)


def test_of_equal_stamps_the_first_pose_counts() -> None:
    stamps = np.array([2.0, 1.0, 1.0, 1.0])
    poses = np.column_stack([[0.0, 1.0, 2.0, 3.0], np.zeros((4, 2))])
    for wanted in (1.0, 1.000004, 0.999996):
        scores = evaluate_relations(stamps, poses, relations([(wanted, 2, -1, 0, 0)]))
        assert scores.translation_m.max == pytest.approx(0.0, abs=1e-12)


def test_nothing_is_nan() -> None:
    for scores in (
        evaluate_relations(np.zeros(0), np.zeros((0, 3)), relations([(0, 1, 0, 0, 0)])),
        evaluate_relations(np.zeros(1), np.zeros((1, 3)), relations([])),
    ):
        assert scores.translation_m.n == 0
        assert np.isnan(scores.translation_m.mean)
        assert np.isnan(scores.rotation_deg.median)


def test_reading(tmp_path: Path) -> None:
    path = tmp_path / "log.relations"
    path.write_text("1.5 2.5 1 2 0 0 0 -0.5\n3.5 2.5 4 5 0 0 0 0.25\n")
    true = read_relations(path)
    assert true.stamps_from.tolist() == [1.5, 3.5]
    assert true.T_from_to.tolist() == [[1, 2, -0.5], [4, 5, 0.25]]
    path.write_text("1 2 3\n")
    with pytest.raises(InputError, match=r"log.relations, line 1: expected 8"):
        read_relations(path)
    path.write_text("\n")
    with pytest.raises(InputError, match="holds no relations"):
        read_relations(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_relations(tmp_path)
    with pytest.raises(InputError, match="2 stamps do not fit"):
        evaluate_relations(np.zeros(2), np.zeros((3, 3)), true)


@pytest.mark.real
def test_raw_odometry_of_intel(recorded_data: Path) -> None:
    """The published floor: 7.37 +- 14.35 m and 39.2 degrees."""
    stamps, poses = [], []
    with bz2.open(recorded_data / "freiburg/intel.clf.bz2", "rt", errors="replace") as file:
        for line in file:
            if line.startswith("FLASER"):
                words = line.split()[-9:]
                stamps.append(float(words[6]))
                poses.append([float(word) for word in words[3:6]])
    true = read_relations(recorded_data / "freiburg/intel.relations")
    scores = evaluate_relations(np.array(stamps), np.array(poses), true)
    assert (scores.translation_m.n, scores.n_unmatched) == (2984, 0)
    assert scores.translation_m.mean == pytest.approx(7.37, abs=0.005)
    assert scores.translation_m.std == pytest.approx(14.35, abs=0.005)
    assert scores.rotation_deg.mean == pytest.approx(39.2, abs=0.05)
