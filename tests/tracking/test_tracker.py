import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.linalg import mahalanobis2
from slammot_graph.core.types import FloatArray
from slammot_graph.tracking.base import ScanView, Track, track_states
from slammot_graph.tracking.tracker import KalmanTracker, KalmanTrackerConfig


def update(tracker: KalmanTracker, stamp_s: float, *centres: FloatArray) -> list[Track]:
    k = len(centres)
    beams = [np.arange(3 * c, 3 * c + 3) for c in range(k)]
    tracker.update(stamp_s, np.array(centres).reshape(-1, 2), np.zeros((k, 2, 2)), beams)
    return tracker.shown()


def at(t: float, x0: float = 0.0, y0: float = 0.0, vx: float = 1.0, vy: float = 0.5) -> FloatArray:
    return np.array([x0 + vx * t, y0 + vy * t])


def test_a_walker_is_confirmed_and_followed(rng: np.random.Generator) -> None:
    tracker = KalmanTracker(KalmanTrackerConfig())
    reported = [update(tracker, 0.1 * k, at(0.1 * k) + rng.normal(0, 0.02, 2)) for k in range(60)]
    assert [len(tracks) for tracks in reported[:4]] == [0, 0, 1, 1]
    assert {track.track_id for tracks in reported for track in tracks} == {0}
    last = reported[-1][0]
    np.testing.assert_allclose(last.state, [*at(5.9), 1.0, 0.5], atol=0.1)
    assert last.n_hits == 60
    assert last.beams.tolist() == [0, 1, 2]


def test_one_prediction_and_correction_by_hand() -> None:
    config = KalmanTrackerConfig(
        acceleration_std_m_s2=2.0, centre_std_m=0.5, start_speed_std_m_s=3.0, n_confirm=1
    )
    tracker = KalmanTracker(config)
    update(tracker, 10.0, np.zeros(2))
    track = update(tracker, 10.5, np.array([1.0, 0.0]))[0]
    # x and v_x alone: P = [[.25, 0], [0, 9]], one step of 0.5 s, one measurement of variance .25
    F, G = np.array([[1.0, 0.5], [0.0, 1.0]]), np.array([0.125, 0.5])
    P = F @ np.diag([0.25, 9.0]) @ F.T + 4.0 * np.outer(G, G)
    K = P[:, 0] / (P[0, 0] + 0.25)
    np.testing.assert_allclose(track.state, [K[0], 0.0, K[1], 0.0], atol=1e-12)
    np.testing.assert_allclose(track.cov[np.ix_([0, 2], [0, 2])], P - np.outer(K, P[0]), atol=1e-12)


def test_the_id_survives_a_short_occlusion_without_beams() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig())
    for k in range(15):
        update(tracker, 0.1 * k, at(0.1 * k))
    for k in range(15, 22):
        hidden = update(tracker, 0.1 * k)
        assert [track.track_id for track in hidden] == [0]
        assert len(hidden[0].beams) == 0
    np.testing.assert_allclose(hidden[0].state[:2], at(2.1), atol=0.15)
    assert [track.track_id for track in update(tracker, 2.2, at(2.2))] == [0]


def test_a_long_occlusion_ends_the_track() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(max_missed_s=0.5))
    for k in range(10):
        update(tracker, 0.1 * k, at(0.1 * k))
    for k in range(10, 16):
        update(tracker, 0.1 * k)
    assert tracker.tracks == []
    for k in range(16, 20):
        again = update(tracker, 0.1 * k, at(0.1 * k))
    assert [track.track_id for track in again] == [1]


def test_false_alarms_here_and_there_are_never_reported() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(max_missed_s=0.3))
    for k in range(20):
        assert update(tracker, 0.1 * k, np.array([7.0 * k, -3.0])) == []


def test_crossing_walkers_keep_their_ids(rng: np.random.Generator) -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(centre_std_m=0.05))
    for k in range(50):
        t = 0.1 * k
        centres = [at(t, -2.5, -1.25, 1.0, 0.5), at(t, -2.5, 1.25, 1.0, -0.5)]
        order = rng.permutation(2)
        noise = rng.normal(0, 0.02, (2, 2))
        tracks = update(tracker, t, *(centres[i] + noise[i] for i in order))
        if k == 10:
            before = {track.track_id: np.sign(track.state[3]) for track in tracks}
    after = {track.track_id: np.sign(track.state[3]) for track in tracks}
    assert len(before) == 2
    assert after == before


def test_covariance_of_a_track_is_honest(rng: np.random.Generator) -> None:
    config, dt = KalmanTrackerConfig(acceleration_std_m_s2=1.0, centre_std_m=0.1, gate=100.0), 0.1
    nees, position_nees = [], []
    for _ in range(60):
        tracker, state = KalmanTracker(config), np.array([*rng.normal(size=2), *rng.normal(size=2)])
        for k in range(25):
            tracks = update(tracker, dt * k, state[:2] + rng.normal(0, 0.1, 2))
            truth, a = state, rng.normal(size=2)
            state = np.array([*(state[:2] + dt * state[2:] + dt**2 / 2 * a), *(state[2:] + dt * a)])
        error = tracks[0].state - truth
        nees.append(mahalanobis2(error, tracks[0].cov))
        position_nees.append(mahalanobis2(error[:2], tracks[0].cov[:2, :2]))
    # means of 60 chi-square draws with 4 and 2 degrees of freedom: 4 +- 0.37, 2 +- 0.26 (one sigma)
    assert 2.9 < np.mean(nees) < 5.1
    assert 1.3 < np.mean(position_nees) < 2.8


def test_what_the_pose_adds_to_a_centre_counts() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(n_confirm=1))
    uncertain = np.array([[[0.5, 0.1], [0.1, 0.2]]])
    tracker.update(0.0, np.zeros((1, 2)), uncertain, [np.arange(2)])
    (track,) = tracker.shown()
    np.testing.assert_allclose(track.cov[:2, :2], uncertain[0] + 0.12**2 * np.eye(2))


def test_a_backward_stamp_counts_as_no_time() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig())
    for k in range(20):
        tracks = update(tracker, 0.1 * k, at(0.1 * k))
    state = tracks[0].state
    tracks = update(tracker, 1.85, at(1.9))
    assert [track.track_id for track in tracks] == [0]
    np.testing.assert_allclose(tracks[0].state, state, atol=0.02)
    assert np.linalg.eigvalsh(tracks[0].cov)[0] > 0.0


@pytest.mark.parametrize("back_s", [0.5, 2.0, 1e6])
def test_tracks_end_after_the_clock_was_set_back(back_s: float) -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(max_missed_s=1.0))
    for k in range(20):
        tracks = update(tracker, 2e6 + 0.1 * k, at(0.1 * k))
    assert [track.track_id for track in tracks] == [0]
    start = 2e6 + 2.0 - back_s
    for k in range(18):
        update(tracker, start + 0.1 * k)
    assert tracker.tracks == []
    # and a new one is followed at its speed
    for k in range(18, 40):
        tracks = update(tracker, start + 0.1 * k, at(0.1 * k))
    assert [track.track_id for track in tracks] == [1]
    np.testing.assert_allclose(tracks[0].state[2:], [1.0, 0.5], atol=0.05)


def test_who_has_walked_is_expected_where_he_goes() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(min_distance_m=1.0))
    assert tracker.predicted_positions(0.0).shape == (0, 2)
    displaced = []
    for k in range(30):
        update(tracker, 0.1 * k, at(0.1 * k), np.array([5.0, 5.0]))
        displaced.append(len(tracker.displaced()))
    # 1.12 m/s: a metre after nine or ten scans; who stands is never expected
    assert displaced[:8] == [0] * 8
    assert displaced[11:] == [1] * 19
    for later_s in (0.0, 0.1, 0.7):
        np.testing.assert_allclose(tracker.predicted_positions(2.9 + later_s), [at(2.9 + later_s)], atol=0.05)
    # a clock that runs back is no time
    np.testing.assert_allclose(tracker.predicted_positions(-50.0), [at(2.9)], atol=0.05)


def test_who_has_walked_and_stands_is_still_expected() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(max_missed_s=0.5))
    for k in range(60):
        update(tracker, 0.1 * k, at(min(0.1 * k, 3.0)))
    np.testing.assert_allclose(tracker.predicted_positions(6.0), [at(3.0)], atol=0.05)
    for k in range(60, 67):
        update(tracker, 0.1 * k)
    assert len(tracker.predicted_positions(6.7)) == 0


def test_what_is_not_confirmed_is_not_expected() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(n_confirm=3, min_distance_m=0.1, gate=100.0))
    for k in range(2):
        update(tracker, 0.5 * k, at(0.5 * k))
    assert np.hypot(*tracker.tracks[0].state[:2]) > 0.1
    assert len(tracker.predicted_positions(1.0)) == 0
    update(tracker, 1.0, at(1.0))
    assert len(tracker.predicted_positions(1.0)) == 1


def update_with(tracker: KalmanTracker, stamp_s: float, centre: FloatArray, is_proven: bool) -> list[Track]:
    tracker.update(stamp_s, centre[None], np.zeros((1, 2, 2)), [np.arange(3)], np.array([is_proven]))
    return tracker.shown()


def test_what_no_free_cell_proves_begins_no_track_and_keeps_none_alive() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(max_missed_s=1.0))
    for k in range(10):
        assert update_with(tracker, 0.1 * k, at(0.1 * k), is_proven=False) == []
    assert tracker.tracks == []
    for k in range(10, 30):
        update_with(tracker, 0.1 * k, at(0.1 * k), is_proven=True)
    for k in range(30, 39):
        (track,) = update_with(tracker, 0.1 * k, at(0.1 * k), is_proven=False)
        assert track.beams.tolist() == [0, 1, 2]  # it is followed all the same
        assert track.missed_s == pytest.approx(0.1 * (k - 29))
        np.testing.assert_allclose(track.state[:2], at(0.1 * k), atol=0.05)
    for k in range(39, 42):
        left = update_with(tracker, 0.1 * k, at(0.1 * k), is_proven=False)
    assert left == tracker.tracks == []


def test_one_proof_makes_up_for_the_time_without() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(max_missed_s=1.0))
    for k in range(60):
        tracks = update_with(tracker, 0.1 * k, at(0.1 * k), is_proven=k % 9 == 0 or k < 3)
    assert [track.track_id for track in tracks] == [0]


def test_nothing_seen_nothing_tracked() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig())
    assert update(tracker, 0.0) == []
    assert update(tracker, 5.0) == []


@pytest.mark.parametrize(
    "name", ["acceleration_std_m_s2", "centre_std_m", "start_speed_std_m_s", "gate", "max_missed_s"]
)
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_impossible_tracks_are_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"KalmanTrackerConfig.{name} must be positive, not {value}"):
        KalmanTrackerConfig(**{name: value})  # type: ignore[arg-type]


def test_a_track_needs_a_hit() -> None:
    with pytest.raises(ConfigError, match=r"KalmanTrackerConfig\.n_confirm must be at least 1, not 0"):
        KalmanTrackerConfig(n_confirm=0)


def test_a_track_handed_out_stays_as_it_was() -> None:
    tracker = KalmanTracker(KalmanTrackerConfig(n_confirm=1))
    before = update(tracker, 0.0, at(0.0))[0]
    state, cov = before.state.copy(), before.cov.copy()
    update(tracker, 0.5, at(0.5))
    np.testing.assert_array_equal(before.state, state)
    np.testing.assert_array_equal(before.cov, cov)


def test_tracks_are_reported_in_the_map_frame(rng: np.random.Generator) -> None:
    tracker, T_map_local = KalmanTracker(KalmanTrackerConfig()), np.array([3.0, -2.0, 2.5])
    uncertain = np.array([[[0.5, 0.1], [0.1, 0.2]], [[0.01, -0.03], [-0.03, 0.3]]])
    places, velocities = rng.normal(0.0, 9.0, (2, 2)), rng.normal(size=(2, 2))
    beams = [np.arange(3), np.arange(5, 9)]
    for k in range(5):
        tracker.update(0.1 * k, places + 0.1 * k * velocities, uncertain, beams)
        tracks = tracker.shown()
    reported = track_states(tracks, T_map_local)
    R = se2.rotation(2.5)
    assert [state.track_id for state in reported] == [0, 1]
    for state, track in zip(reported, tracks, strict=True):
        np.testing.assert_allclose(state.position, T_map_local[:2] + R @ track.state[:2], rtol=1e-12)
        np.testing.assert_allclose(state.velocity, R @ track.state[2:], rtol=1e-12)
        np.testing.assert_allclose(state.position_cov, R @ track.cov[:2, :2] @ R.T, rtol=1e-12)
        np.testing.assert_array_equal(state.beams, track.beams)
    assert track_states([], T_map_local) == ()


def test_a_track_is_missed_only_where_a_laser_looked() -> None:
    def seen_once() -> KalmanTracker:
        tracker = KalmanTracker(KalmanTrackerConfig(n_confirm=1))
        tracker.update(0.0, np.array([[1.0, 0.0]]), np.zeros((1, 2, 2)), [np.arange(3)])
        return tracker

    def update(tracker: KalmanTracker, stamp: float, *, looks: bool) -> int:
        nothing = np.empty((0, 2)), np.empty((0, 2, 2)), list[np.ndarray]()
        view = ScanView(
            points=np.full((19, 2), np.nan),
            packed_cov=np.zeros((19, 3)),
            cluster=np.full(19, -1),
            is_proven=np.full(19, False),
            T_local_laser=np.array([0.0, 0.0, 0.0 if looks else np.pi]),
            angle_min=-0.9,
            angle_increment=0.1,
            ranges=np.full(19, np.inf),
            is_valid=np.full(19, False),
            no_return_m=30.0,
            is_one_of_several=True,
        )
        tracker.update(stamp, *nothing, None, view)
        return len(tracker.tracks)

    unseen, missed, back = seen_once(), seen_once(), seen_once()
    n_unseen = [update(unseen, 0.1 * k, looks=False) for k in range(1, 25)]
    assert n_unseen == [1] * 20 + [0] * 4  # 2 s out of every laser's view
    n_missed = [update(missed, 0.1 * k, looks=k % 2 == 0) for k in range(1, 25)]
    assert n_missed == [1] * 11 + [0] * 13  # two lasers in turn: a second, told by the next scan that looks
    assert [update(back, 0.1 * k, looks=k > 15) for k in range(1, 25)] == [1] * 20 + [0] * 4
