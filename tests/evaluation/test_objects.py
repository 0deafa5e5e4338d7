from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.scan import LaserModel, Scan, ScanTruth
from slammot_graph.evaluation import (
    EstimatedTracks,
    TrueObjects,
    evaluate_objects,
    read_objects,
    write_mot_challenge,
)

N = 100
STAMPS = np.arange(0.0, 0.1 * N - 0.05, 0.1)
ROBOT = np.column_stack([0.05 * np.arange(N), np.zeros(N), np.linspace(0.0, 1.0, N)])


def people() -> np.ndarray:
    """Two who walk, 4 m apart; the second is away at first."""
    objects = np.full((N, 2, 4), np.nan)
    objects[:, 0] = np.column_stack([STAMPS, np.full(N, 2.0), np.ones(N), np.zeros(N)])
    objects[20:, 1] = np.column_stack([5.0 - STAMPS, np.full(N, -2.0), -np.ones(N), np.zeros(N)])[20:]
    return objects


def truth(n_beams: np.ndarray) -> TrueObjects:
    return TrueObjects(stamps=STAMPS, T_world_base=ROBOT, objects=people(), n_beams=n_beams)


def perfect(T_map_world: np.ndarray, offset: float = 0.0) -> EstimatedTracks:
    """Whoever is there, in a map that lies at `T_map_world` (3,); all covariances 0.01 m^2."""
    frames, ids = np.nonzero(np.isfinite(people()[:, :, 0]))
    states = people()[frames, ids]
    return EstimatedTracks(
        frames=frames,
        ids=ids,
        positions=se2.transform(T_map_world, states[:, :2]) + np.array([offset, 0.0]),
        velocities=states[:, 2:] @ se2.rotation(T_map_world[2]).T,
        covs=np.broadcast_to(0.01 * np.eye(2), (len(ids), 2, 2)),
        T_map_base=se2.compose(T_map_world, ROBOT),
    )


@pytest.mark.parametrize("drift", [(0.0, 0.0, 0.0), (3.0, -1.0, 0.7)])
def test_where_the_map_lies_does_not_count(drift: tuple[float, float, float]) -> None:
    scores = evaluate_objects(truth(np.full((N, 2), 9)), perfect(np.array(drift), 0.1))
    assert scores.person.mota == scores.appearance.idf1 == 1.0
    assert (scores.n_objects, scores.n_appearances, scores.ids_per_appearance) == (2, 2, 1.0)
    assert scores.position_rmse_m == pytest.approx(0.1)
    assert scores.velocity_rmse_m_s == pytest.approx(0.0, abs=1e-9)
    assert scores.nees == pytest.approx(1.0)


@pytest.mark.parametrize(("hidden_s", "appearances"), [(2.5, 2), (3.5, 3)])
def test_who_was_out_of_sight_for_long_appears_anew(hidden_s: float, appearances: int) -> None:
    n_beams = np.full((N, 2), 3)
    n_beams[30 : 30 + round(10 * hidden_s), 0] = 2
    estimate = perfect(np.zeros(3))
    scores = evaluate_objects(truth(n_beams), estimate)
    # rows that follow him while he is out of sight are neither right nor wrong
    assert (scores.person.mota, scores.person.n_false) == (1.0, 0)
    assert (scores.person.idf1, scores.n_appearances) == (1.0, appearances)
    assert (scores.appearance.idf1 < 1.0) == (appearances == 3)
    assert scores.ids_per_object == scores.ids_per_appearance == 1.0


def test_a_new_number_in_sight_is_a_switch() -> None:
    estimate = perfect(np.zeros(3))
    ids = np.where((estimate.ids == 0) & (estimate.frames >= 50), 7, estimate.ids)
    changed = EstimatedTracks(**{**vars(estimate), "ids": ids})
    scores = evaluate_objects(truth(np.full((N, 2), 9)), changed)
    assert (scores.person.n_switches, scores.ids_per_object) == (1, 1.5)
    assert scores.person.idf1 == pytest.approx((50 + 80) * 2 / 360)


def test_valid_beams_are_counted() -> None:
    object_id = np.array([[0, 0, 1, -1], [1, 1, 1, 0]])
    is_valid = np.array([[True, False, True, True], [True, True, True, True]])
    found = TrueObjects.of_beams(
        stamps=STAMPS[:2],
        T_world_base=ROBOT[:2],
        objects=people()[:2],
        object_id=object_id,
        is_valid=is_valid,
    )
    assert found.n_beams.tolist() == [[1, 1], [1, 3]]
    with pytest.raises(InputError, match="2 scans"):
        TrueObjects.of_beams(
            stamps=STAMPS,
            T_world_base=ROBOT,
            objects=people()[:2],
            object_id=object_id,
            is_valid=is_valid,
        )


def test_more_scans_than_the_truth_has_are_refused() -> None:
    short = TrueObjects(
        stamps=STAMPS[:9], T_world_base=ROBOT[:9], objects=people()[:9], n_beams=np.full((9, 2), 9)
    )
    with pytest.raises(InputError, match="100 scans"):
        evaluate_objects(short, perfect(np.zeros(3)))


def test_the_states_come_from_the_scans_of_a_log() -> None:
    laser = LaserModel(angle_min=0.0, angle_increment=0.1, n_beams=4, range_min=0.1, range_max=8.0)

    def scan(k: int, objects: np.ndarray | None) -> Scan:
        known = ScanTruth(T_world_base=ROBOT[k], object_id=np.array([0, 0, 1, -1]), objects=objects)
        return Scan(index=k, stamp=STAMPS[k], ranges=np.ones(4), laser=laser, T_odom_base=None, truth=known)

    found = read_objects((scan(k, people()[k]) for k in range(9)), np.full((5, 4), True))
    assert found is not None
    assert found.objects.shape == (5, 2, 4)
    assert found.n_beams.tolist() == [[2, 1]] * 5
    assert read_objects((scan(k, None) for k in range(9)), np.full((5, 4), True)) is None


def test_the_motchallenge_files_hold_truth_and_tracks(tmp_path: Path) -> None:
    n_beams = np.full((N, 2), 3)
    n_beams[30:65, 0] = 2
    drift = np.array([3.0, -1.0, 0.7])
    write_mot_challenge(tmp_path / "mot", truth(n_beams), perfect(drift, 0.1))
    true, found = (np.loadtxt(tmp_path / "mot" / name, delimiter=",") for name in ("gt.txt", "tracks.txt"))
    assert true.shape == found.shape == (N + N - 20, 10)
    np.testing.assert_array_equal(true[:, 0], found[:, 0])
    assert np.unique(true[:, 1]).tolist() == [1, 2, 3]  # the first one comes back as another
    assert np.count_nonzero(true[:, 6] == 0) == 35
    np.testing.assert_allclose(np.sort(found[:, 7] - true[:, 7])[[0, -1]], 0.1, atol=2e-4)
    np.testing.assert_allclose(true[:, 2:4] + 0.5, true[:, 7:9], atol=2e-4)
    first = true[(true[:, 0] == 1) & (true[:, 1] == 1)][0, 7:9]
    np.testing.assert_allclose(first, se2.transform(drift, np.array([[0.0, 2.0]]))[0], atol=1e-4)


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "mot").write_text("")
    with pytest.raises(InputError, match="mot: cannot be written"):
        write_mot_challenge(tmp_path / "mot", truth(np.full((N, 2), 9)), perfect(np.zeros(3)))
