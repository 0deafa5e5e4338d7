import math

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.tracking._smoothing_kernels import smooth
from slammot_graph.tracking.base import Sightings
from slammot_graph.tracking.chain import SmoothingConfig
from slammot_graph.tracking.smoothing import SightingHistory, smooth_tracks

CONFIG = SmoothingConfig()


def transition(dt: float) -> tuple[np.ndarray, np.ndarray]:
    F = np.eye(4)
    F[0, 2] = F[1, 3] = dt
    G = np.vstack([0.5 * dt * dt * np.eye(2), dt * np.eye(2)])
    return F, G


def test_the_smoother_is_the_least_squares_solution() -> None:
    """All states at once, by the normal equations of the same model with accelerations as unknowns."""
    rng = np.random.default_rng(3)
    stamps = np.array([0.0, 0.1, 0.2, 0.5, 0.6, 0.6, 0.9])
    is_seen = np.array([True, True, False, True, True, False, True])
    n = len(stamps)
    places = rng.normal(size=(n, 2))
    noise = np.array([A @ A.T + 0.01 * np.eye(2) for A in 0.2 * rng.normal(size=(n, 2, 2))])
    acceleration, speed = 1.3, 0.9
    states, covs = np.empty((n, 4)), np.empty((n, 4, 4))
    smooth(stamps, is_seen, places, noise, acceleration, speed, states, covs)
    # every state as a linear function of the first one and of the accelerations
    width = 4 + 2 * (n - 1)
    maps = [np.eye(4, width)]
    for k in range(1, n):
        F, G = transition(stamps[k] - stamps[k - 1])
        step = F @ maps[-1]
        step[:, 2 + 2 * k : 4 + 2 * k] += G
        maps.append(step)
    information = np.zeros((width, width))
    information[2:4, 2:4] = np.eye(2) / speed**2
    information[4:, 4:] = np.eye(width - 4) / acceleration**2
    vector = np.zeros(width)
    for k in np.flatnonzero(is_seen).tolist():
        H = maps[k][:2]
        information += H.T @ np.linalg.solve(noise[k], H)
        vector += H.T @ np.linalg.solve(noise[k], places[k])
    cov = np.linalg.inv(information)
    for k in range(n):
        np.testing.assert_allclose(states[k], maps[k] @ cov @ vector, atol=1e-8)
        np.testing.assert_allclose(covs[k], maps[k] @ cov @ maps[k].T, atol=1e-8)


def walk(
    rng: np.random.Generator,
    hidden: range,
    poses: np.ndarray,
    stamps: np.ndarray,
    *,
    turn_back: bool = False,
    thickness_m: float = 0.03,
) -> tuple[SightingHistory, np.ndarray]:
    """Someone walks past; while hidden he is not seen, and afterwards he has another number."""
    truth = np.column_stack([0.1 * np.arange(len(stamps)), np.full(len(stamps), 2.0)])
    if turn_back:
        truth[hidden.stop :, 0] = truth[hidden.start, 0] - truth[hidden.stop :, 0] + truth[hidden.stop, 0]
    history = SightingHistory()
    for k in range(len(stamps)):
        if k in hidden:
            continue
        one = Sightings(
            ids=np.array([4 if k < hidden.start else 9]),
            places=(truth[k] + 0.05 * rng.standard_normal(2))[None],
            covs=0.0025 * np.eye(2)[None],
            sizes_m=np.array([0.4]),
            thickness_m=np.array([thickness_m]),
        )
        history.add(k, one, poses[k])
    return history, truth


STAMPS = np.arange(60) / 10.0
POSES = np.column_stack([0.02 * np.arange(60), np.zeros(60), 0.01 * np.arange(60)])


def test_tracklets_are_linked_across_an_absence_and_moved_with_the_poses() -> None:
    history, truth = walk(np.random.default_rng(0), range(20, 32), POSES, STAMPS)
    moved = np.array([3.0, -1.0, 0.8])  # a loop closure moves the whole map
    found = smooth_tracks(history.table(), STAMPS, se2.compose(moved[None], POSES), CONFIG)
    assert found.ids.tolist() == [0] * 60
    assert found.scans.tolist() == list(range(60))
    assert np.flatnonzero(~found.is_seen).tolist() == list(range(20, 32))
    offset = found.states[:, :2] - se2.transform(moved, truth)
    assert np.hypot(*offset.T).max() < 0.15
    np.testing.assert_allclose(found.states[5:55, 2:] @ se2.rotation(0.8), [[1.0, 0.0]] * 50, atol=0.2)
    (one,) = found.objects
    assert (one.track_id, one.kind) == (0, "person")
    assert one.probability > 0.9
    assert one.size_m == pytest.approx(0.4)


def test_who_cannot_be_the_same_is_not_linked() -> None:
    absent = walk(np.random.default_rng(0), range(15, 50), POSES, STAMPS)[
        0
    ]  # longer than an appearance lasts
    far = absent.table()
    far[far[:, 1] == 9, 2] += 4.0
    for table in (absent.table(), far):
        found = smooth_tracks(table, STAMPS, POSES, CONFIG)
        assert np.unique(found.ids).tolist() == [0, 1]


def test_the_other_leg_as_a_track_of_its_own_is_left_out() -> None:
    history, truth = walk(np.random.default_rng(0), range(0), POSES, STAMPS)
    for k in range(20, 40):
        leg = Sightings(
            ids=np.array([11]),
            places=truth[k][None] + [0.0, 0.2],
            covs=0.0025 * np.eye(2)[None],
            sizes_m=np.array([0.1]),
            thickness_m=np.array([math.nan]),
        )
        history.add(k, leg, POSES[k])
    found = smooth_tracks(history.table(), STAMPS, POSES, CONFIG)
    assert len(found.objects) == 1


@pytest.mark.parametrize(
    ("thickness_m", "kind"), [(0.005, "vehicle"), (0.03, "person"), (math.nan, "person")]
)
def test_what_has_a_straight_edge_is_a_vehicle(thickness_m: float, kind: str) -> None:
    history, _ = walk(np.random.default_rng(0), range(0), POSES, STAMPS, thickness_m=thickness_m)
    (one,) = smooth_tracks(history.table(), STAMPS, POSES, CONFIG).objects
    assert one.kind == kind
    assert one.probability > 0.9


def test_a_place_that_is_hardly_known_is_left_out() -> None:
    history, _ = walk(np.random.default_rng(0), range(15, 44), POSES, STAMPS)
    found = smooth_tracks(history.table(), STAMPS, POSES, SmoothingConfig(max_gap_std_m=0.15))
    assert found.ids.tolist() == [0] * len(found.ids)
    absent = sorted(set(range(60)) - set(found.scans.tolist()))
    assert absent == list(range(absent[0], absent[-1] + 1))
    assert 15 < absent[0] < absent[-1] < 43
    assert found.scans[found.is_seen].tolist() == [*range(15), *range(44, 60)]


@pytest.mark.parametrize(
    ("n", "speed", "is_kept"), [(14, 0.0, False), (15, 0.0, True), (8, 1.0, True), (4, 2.0, False)]
)
def test_what_goes_nowhere_must_be_seen_more_often(n: int, speed: float, is_kept: bool) -> None:
    rows = np.array([[k, 3, 0.1 * speed * k, 0, 0.01, 0, 0.01, 0.4, math.nan] for k in range(n)])
    assert bool(smooth_tracks(rows, STAMPS, np.zeros((60, 3)), CONFIG).objects) == is_kept


def test_few_sightings_are_no_track_and_a_large_thing_is_no_person() -> None:
    rows = np.array([[k, 3, 0.1 * k, 0, 0.01, 0, 0.01, 1.6, math.nan] for k in range(30)], dtype=float)
    poses = np.zeros((60, 3))
    assert smooth_tracks(rows[:4], STAMPS, poses, CONFIG).objects == ()
    (some,) = smooth_tracks(rows[:6], STAMPS, poses, CONFIG).objects
    assert some.kind == "unknown"
    assert np.isnan(some.probability)
    (large,) = smooth_tracks(rows, STAMPS, poses, CONFIG).objects
    assert large.kind == "vehicle"
    assert smooth_tracks(rows[:0], STAMPS, poses, CONFIG).states.shape == (0, 4)
