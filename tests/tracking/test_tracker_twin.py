"""The tracker against a plain one, track by track."""

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking._kernels import OUTSIDE, join_nearest
from slammot_graph.tracking.base import Track
from slammot_graph.tracking.tracker import KalmanTracker, KalmanTrackerConfig


@dataclass(frozen=True, kw_only=True)
class Clusters:
    """One scan's."""

    stamp_s: float
    centres: FloatArray
    covs: FloatArray
    beams: list[IntArray]
    is_proven: BoolArray


class PlainTracker:
    """The tracker in the filter's textbook form, a track at a time."""

    def __init__(self, config: KalmanTrackerConfig) -> None:
        self.config = config
        self.tracks: list[Track] = []
        self.clock_s = -np.inf
        self.n_begun = 0

    def update(self, clusters: Clusters) -> None:
        dt = max(clusters.stamp_s - self.clock_s, 0.0) if np.isfinite(self.clock_s) else 0.0
        is_set_back = clusters.stamp_s < self.clock_s - self.config.max_missed_s
        self.clock_s = clusters.stamp_s if is_set_back else max(clusters.stamp_s, self.clock_s)
        noise = clusters.covs + self.config.centre_std_m**2 * np.eye(2)
        predicted = [self.predict(track, dt) for track in self.tracks]
        pairs = dict(self.join(predicted, clusters.centres, noise))
        kept = [
            self.correct(track, clusters, pairs[t], noise[pairs[t]]) if t in pairs else track
            for t, track in enumerate(predicted)
        ]
        self.tracks = [track for track in kept if track.missed_s <= self.config.max_missed_s]
        for c, centre in enumerate(clusters.centres):
            if clusters.is_proven[c] and c not in pairs.values():
                self.begin(centre, noise[c], clusters.beams[c])

    def predict(self, track: Track, dt: float) -> Track:
        F = np.eye(4) + dt * np.eye(4, k=2)
        G = np.vstack([dt**2 / 2 * np.eye(2), dt * np.eye(2)])
        return replace(
            track,
            state=F @ track.state,
            cov=F @ track.cov @ F.T + self.config.acceleration_std_m_s2**2 * G @ G.T,
            missed_s=track.missed_s + dt,
            beams=np.empty(0, dtype=np.int64),
        )

    def join(self, tracks: list[Track], centres: FloatArray, noise: FloatArray) -> list[tuple[int, int]]:
        costs = np.full((len(tracks), len(centres)), 1e6)
        for t, track in enumerate(tracks):
            for c, centre in enumerate(centres):
                offset = centre - track.state[:2]
                distance2 = offset @ np.linalg.inv(track.cov[:2, :2] + noise[c]) @ offset
                costs[t, c] = distance2 if distance2 <= self.config.gate else 1e6
        rows, cols = linear_sum_assignment(costs)
        pairs = zip(rows.tolist(), cols.tolist(), strict=True)
        return [(t, c) for t, c in pairs if costs[t, c] <= self.config.gate]

    def correct(self, track: Track, clusters: Clusters, c: int, noise: FloatArray) -> Track:
        H = np.eye(2, 4)
        K = track.cov @ H.T @ np.linalg.inv(H @ track.cov @ H.T + noise)
        return replace(
            track,
            state=track.state + K @ (clusters.centres[c] - H @ track.state),
            cov=(np.eye(4) - K @ H) @ track.cov,
            n_hits=track.n_hits + 1,
            missed_s=0.0 if clusters.is_proven[c] else track.missed_s,
            beams=clusters.beams[c],
        )

    def begin(self, centre: FloatArray, noise: FloatArray, beams: IntArray) -> None:
        cov = self.config.start_speed_std_m_s**2 * np.eye(4)
        cov[:2, :2] = noise
        state = np.array([*centre, 0.0, 0.0])
        track = Track(
            track_id=self.n_begun, state=state, cov=cov, start=centre, n_hits=1, missed_s=0.0, beams=beams
        )
        self.n_begun += 1
        self.tracks.append(track)


def people_seen(rng: np.random.Generator, n_people: int, room_m: float, n_scans: int) -> list[Clusters]:
    """Some missed, some seen twice or without proof, in no order, by a clock that stops and runs backward."""
    places, velocities = rng.uniform(0.0, room_m, (n_people, 2)), rng.normal(0.0, 1.0, (n_people, 2))
    scans, stamp_s = [], 100.0
    for _ in range(n_scans):
        steps_s = [0.1, 0.0, -0.05, 0.6, -3.0]
        dt = rng.choice(steps_s, p=[0.8, 0.05, 0.05, 0.05, 0.05])
        stamp_s += dt
        places = places + max(dt, 0.0) * velocities
        seen = places[rng.permutation(np.flatnonzero(rng.random(n_people) < 0.8))]
        seen = np.concatenate([seen, seen[:1] if rng.random() < 0.2 else seen[:0]])
        k = len(seen)
        roots = rng.normal(0.0, 0.1, (k, 2, 2))
        scans.append(
            Clusters(
                stamp_s=stamp_s,
                centres=seen + rng.normal(0.0, 0.1, (k, 2)),
                covs=roots @ roots.transpose(0, 2, 1),
                beams=[np.arange(5 * c, 5 * c + 3) for c in range(k)],
                is_proven=rng.random(k) < 0.8,
            )
        )
    return scans


@given(
    seed=st.integers(0, 2**32 - 1),
    n_people=st.integers(0, 6),
    room_m=st.sampled_from([0.5, 3.0, 20.0]),
    gate=st.sampled_from([1.0, 9.21, 100.0, 2e6]),
)
def test_the_tracker_does_what_the_textbook_says(
    seed: int, n_people: int, room_m: float, gate: float
) -> None:
    config = KalmanTrackerConfig(gate=gate, max_missed_s=0.5)
    tracker, plain = KalmanTracker(config), PlainTracker(config)
    for scan in people_seen(np.random.default_rng(seed), n_people, room_m, 30):
        tracker.update(scan.stamp_s, scan.centres, scan.covs, scan.beams, scan.is_proven)
        confirmed = tracker.shown()
        plain.update(scan)
        assert confirmed == [track for track in tracker.tracks if track.n_hits >= config.n_confirm]
        assert [(t.track_id, t.n_hits) for t in tracker.tracks] == [
            (t.track_id, t.n_hits) for t in plain.tracks
        ]
        for got, expected in zip(tracker.tracks, plain.tracks, strict=True):
            np.testing.assert_allclose(got.state, expected.state, rtol=1e-12, atol=1e-12)
            np.testing.assert_allclose(got.cov, expected.cov, rtol=1e-12, atol=1e-12)
            np.testing.assert_array_equal(got.cov, got.cov.T)
            np.testing.assert_array_equal(got.start, expected.start)
            np.testing.assert_array_equal(got.beams, expected.beams)
            assert got.missed_s == expected.missed_s
        displaced = [t for t in plain.tracks if t.n_hits >= 3 and np.hypot(*(t.state[:2] - t.start)) >= 1.0]
        assert [t.track_id for t in tracker.displaced()] == [t.track_id for t in displaced]
        later = np.array([t.state[:2] + 0.1 * t.state[2:] for t in displaced]).reshape(-1, 2)
        np.testing.assert_allclose(
            tracker.predicted_positions(plain.clock_s + 0.1), later, rtol=1e-12, atol=1e-12
        )


@given(
    seed=st.integers(0, 2**32 - 1),
    n_tracks=st.integers(0, 5),
    n_clusters=st.integers(0, 5),
    share_outside=st.sampled_from([0.0, 0.5, 0.8]),
    n_values=st.sampled_from([2, 5, 1000]),
)
def test_nearest_tracks_are_joined_only_where_that_is_the_one_best_joining(
    seed: int, n_tracks: int, n_clusters: int, share_outside: float, n_values: int
) -> None:
    rng = np.random.default_rng(seed)
    shape = (n_tracks, n_clusters)
    costs = np.where(rng.random(shape) < share_outside, OUTSIDE, rng.integers(0, n_values, shape) / 8.0)
    cluster_of = np.empty(n_tracks, dtype=np.int64)
    is_best = join_nearest(costs, cluster_of)
    is_within = costs < OUTSIDE
    if (is_within.sum(axis=0) <= 1).all() and (is_within.sum(axis=1) <= 1).all():
        assert is_best  # nothing to choose
    if is_best:
        rows, cols = linear_sum_assignment(costs)
        best = [[t, c] for t, c in zip(rows.tolist(), cols.tolist(), strict=True) if is_within[t, c]]
        assert [[t, c] for t, c in enumerate(cluster_of.tolist()) if c >= 0] == best
