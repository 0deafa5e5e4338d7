import numpy as np
import pytest
from evo.core import metrics
from evo.core.trajectory import PoseTrajectory3D

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import ErrorStats, absolute_error, alignment, path_length, relative_error


def walk(rng: np.random.Generator, n: int = 200) -> FloatArray:
    poses = [np.array([4.0, -3.0, 2.0])]
    for _ in range(n - 1):
        poses.append(se2.compose(poses[-1], rng.normal([0.1, 0.0, 0.05], [0.03, 0.01, 0.1])))
    return np.array(poses)


def noisy(rng: np.random.Generator, truth: FloatArray) -> FloatArray:
    estimate = se2.compose(truth, rng.normal(0.0, [0.05, 0.05, 0.02], truth.shape))
    return se2.compose(np.array([1.0, 2.0, -2.5])[None], estimate)


def evo_trajectory(poses: FloatArray) -> PoseTrajectory3D:
    matrices = np.tile(np.eye(4), (len(poses), 1, 1))
    matrices[:, :2, :2] = se2.rotation(poses[:, 2])
    matrices[:, :2, 3] = poses[:, :2]
    return PoseTrajectory3D(poses_se3=list(matrices), timestamps=np.arange(len(poses), dtype=float))


def assert_agrees(mine: ErrorStats, evo: metrics.PE) -> None:
    theirs = evo.get_all_statistics()
    for name in ("rmse", "mean", "median", "std", "max"):
        assert getattr(mine, name) == pytest.approx(theirs[name], rel=1e-6, abs=1e-9)
    assert mine.n == len(evo.error)


@pytest.mark.parametrize("align", [True, False])
def test_absolute_error_agrees_with_evo(rng: np.random.Generator, align: bool) -> None:
    truth = walk(rng)
    estimate = noisy(rng, truth)
    reference, other = evo_trajectory(truth), evo_trajectory(estimate)
    if align:
        other.align(reference)
    translation = metrics.APE(metrics.PoseRelation.translation_part)
    rotation = metrics.APE(metrics.PoseRelation.rotation_angle_deg)
    for metric in (translation, rotation):
        metric.process_data((reference, other))
    mine = absolute_error(estimate, truth, align=align)
    assert_agrees(mine.translation_m, translation)
    assert_agrees(mine.rotation_deg, rotation)


@pytest.mark.parametrize(
    ("delta", "unit", "evo_unit", "overlap"),
    [
        (1, "steps", metrics.Unit.frames, True),
        (10, "steps", metrics.Unit.frames, True),
        (10, "steps", metrics.Unit.frames, False),
        (1.0, "m", metrics.Unit.meters, False),
    ],
)
def test_relative_error_agrees_with_evo(
    rng: np.random.Generator, delta: float, unit: str, evo_unit: metrics.Unit, overlap: bool
) -> None:
    truth = walk(rng)
    estimate = noisy(rng, truth)
    mine = relative_error(estimate, truth, delta=delta, unit=unit, overlap=overlap)  # type: ignore[arg-type]
    for name, relation in (
        ("translation_m", metrics.PoseRelation.translation_part),
        ("rotation_deg", metrics.PoseRelation.rotation_angle_deg),
    ):
        metric = metrics.RPE(relation, delta, evo_unit, all_pairs=overlap, pairs_from_reference=True)
        metric.process_data((evo_trajectory(truth), evo_trajectory(estimate)))
        assert_agrees(getattr(mine, name), metric)


def test_alignment_finds_a_known_transform(rng: np.random.Generator) -> None:
    truth = walk(rng)
    T_map_world = np.array([3.0, -1.0, 3.0])
    found = alignment(se2.compose(T_map_world[None], truth), truth)
    np.testing.assert_allclose(se2.compose(found, T_map_world), 0.0, atol=1e-9)


def test_time_pairs_follow_the_log_even_where_stamps_run_backward() -> None:
    truth = np.zeros((5, 3))
    stamps = np.array([0.0, 1.0, 0.5, 2.0, 3.0])
    pairs = relative_error(truth, truth, delta=1.0, unit="s", stamps=stamps).pairs
    assert pairs.tolist() == [[0, 1], [1, 3], [2, 3], [3, 4]]


def test_distance_pairs_start_at_every_pose() -> None:
    truth = np.column_stack([0.4 * np.arange(6.0), np.zeros((6, 2))])
    pairs = relative_error(truth, truth, delta=1.0, unit="m").pairs
    assert pairs.tolist() == [[0, 3], [1, 4], [2, 5]]


@pytest.mark.parametrize("n", [0, 1])
def test_nothing_to_compare_is_nan(n: int) -> None:
    poses = np.zeros((n, 3))
    assert absolute_error(poses, poses).translation_m.n == n
    for unit in ("steps", "m"):
        error = relative_error(poses, poses, delta=1, unit=unit)
        assert error.translation_m.n == 0
        assert np.isnan(error.translation_m.rmse)


def test_misuse_is_a_clear_error() -> None:
    with pytest.raises(InputError, match="same shape"):
        absolute_error(np.zeros((3, 3)), np.zeros((4, 3)))
    with pytest.raises(InputError, match="positive"):
        relative_error(np.zeros((3, 3)), np.zeros((3, 3)), delta=0)
    with pytest.raises(InputError, match="stamp"):
        relative_error(np.zeros((3, 3)), np.zeros((3, 3)), delta=1, unit="s")


def test_path_length() -> None:
    assert path_length(np.array([[0.0, 0.0, 1.0], [3.0, 4.0, 2.0], [3.0, 3.0, 0.0]])) == 6.0
    assert path_length(np.zeros((1, 3))) == path_length(np.zeros((0, 3))) == 0.0
