"""Tracks of moving objects: a constant-velocity Kalman filter each, joined to clusters by global assignment."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slammot_graph.errors import ConfigError
from slammot_graph.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class TrackConfig:
    """Motion and measurement noise of the tracks, and when they begin and end.

    Attributes
    ----------
    acceleration_std_m_s2 : float
        White-noise acceleration of a walking person.
    centre_std_m : float
        Of a cluster's centre as a measurement of the person's centre.
    start_speed_std_m_s : float
    gate : float
        Largest squared Mahalanobis distance of a cluster to a track (9.21: 99% for two dimensions).
    n_confirm : int
        Clusters needed before a track is reported.
    max_missed_s : float
        A track that no cluster confirmed for this long ends.
    min_way_m : float
        An object has walked when it is this far from where it was first seen.
    """

    acceleration_std_m_s2: float = 1.5
    centre_std_m: float = 0.12
    start_speed_std_m_s: float = 1.0
    gate: float = 9.21
    n_confirm: int = 3
    max_missed_s: float = 1.0
    min_way_m: float = 1.0

    def __post_init__(self) -> None:
        for name in (
            "acceleration_std_m_s2",
            "centre_std_m",
            "start_speed_std_m_s",
            "gate",
            "max_missed_s",
            "min_way_m",
        ):
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"tracks.{name} must be positive, not {getattr(self, name)}")
        if self.n_confirm < 1:
            raise ConfigError(f"tracks.n_confirm must be at least 1, not {self.n_confirm}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """One object: state (x, y, vx, vy) [m, m/s] with its covariance, in the tracker's frame.

    Attributes
    ----------
    track_id : int
    state : (4,) array
    cov : (4, 4) array
    start : (2,) array
        Where it was first seen [m].
    n_hits : int
    missed_s : float
        Time since the last cluster.
    beams : (k,) int array
        Beams of the latest scan; empty when the track was only predicted.
    """

    track_id: int
    state: FloatArray
    cov: FloatArray
    start: FloatArray
    n_hits: int
    missed_s: float
    beams: IntArray


class Tracker:
    """Follows the clusters of moving points from scan to scan."""

    def __init__(self, config: TrackConfig) -> None:
        self.config = config
        self.tracks: list[Track] = []
        self._stamp_s: float | None = None
        self._next_id = 0

    def expected(self, stamp_s: float) -> FloatArray:
        """(k, 2) places [m] where objects that have walked should be at a stamp [s], tracker's frame."""
        dt = 0.0 if self._stamp_s is None else max(stamp_s - self._stamp_s, 0.0)
        states = [track.state for track in self.walked()]
        return np.array([state[:2] + dt * state[2:] for state in states]).reshape(-1, 2)

    def walked(self) -> list[Track]:
        """Confirmed tracks of objects that have walked."""
        return [
            track
            for track in self.tracks
            if track.n_hits >= self.config.n_confirm
            and math.dist(track.state[:2], track.start) >= self.config.min_way_m
        ]

    def update(
        self,
        stamp_s: float,
        centres: FloatArray,
        centre_covs: FloatArray,
        beams: Sequence[IntArray],
        is_proven: BoolArray | None = None,
    ) -> list[Track]:
        """Predict to `stamp_s`, join clusters to tracks, begin and end tracks.

        Parameters
        ----------
        stamp_s : float
            A stamp that runs backward counts as no time passed.
        centres : (k, 2) array [m]
            Cluster centres, tracker's frame.
        centre_covs : (k, 2, 2) array [m^2]
            What the pose's uncertainty adds to `centre_std_m`.
        beams : k int arrays
            Beams of each cluster.
        is_proven : (k,) bool array, optional
            Clusters with a beam on free cells; the others follow from their track alone, do not begin one, and do
            not keep one alive. By default all are proven.

        Returns
        -------
        Confirmed tracks.
        """
        dt = 0.0 if self._stamp_s is None else max(stamp_s - self._stamp_s, 0.0)
        self._stamp_s = stamp_s if self._stamp_s is None else max(stamp_s, self._stamp_s)
        if stamp_s < self._stamp_s - self.config.max_missed_s:
            self._stamp_s = stamp_s  # the clock was set back for good
        if not self.tracks and not len(centres):
            return []
        proven = np.ones(len(centres), dtype=np.bool_) if is_proven is None else is_proven
        F, Q = self._motion(dt)
        predicted = [self._predict(track, dt, F, Q) for track in self.tracks]
        noise = centre_covs + self.config.centre_std_m**2 * np.eye(2)
        pairs = self._assign(predicted, centres, noise)
        joined = {
            t: self._correct(predicted[t], centres[c], noise[c], beams[c], bool(proven[c])) for t, c in pairs
        }
        taken = {c for _, c in pairs}
        kept = [
            joined.get(t, track)
            for t, track in enumerate(predicted)
            if track.missed_s <= self.config.max_missed_s or (t in joined and joined[t].missed_s == 0.0)
        ]
        begun = [
            self._begin(centres[c], noise[c], beams[c])
            for c in range(len(centres))
            if c not in taken and proven[c]
        ]
        self.tracks = kept + begun
        return [track for track in self.tracks if track.n_hits >= self.config.n_confirm]

    def _motion(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """Transition (4, 4) and process noise (4, 4) over a time [s]."""
        F = np.eye(4)
        F[0, 2] = F[1, 3] = dt
        G = np.array([[dt * dt / 2, 0], [0, dt * dt / 2], [dt, 0], [0, dt]])
        return F, self.config.acceleration_std_m_s2**2 * G @ G.T

    def _predict(self, track: Track, dt: float, F: FloatArray, Q: FloatArray) -> Track:
        return Track(
            track_id=track.track_id,
            state=F @ track.state,
            cov=F @ track.cov @ F.T + Q,
            start=track.start,
            n_hits=track.n_hits,
            missed_s=track.missed_s + dt,
            beams=np.empty(0, dtype=np.int64),
        )

    def _assign(self, tracks: list[Track], centres: FloatArray, noise: FloatArray) -> list[tuple[int, int]]:
        """Pairs (track, cluster) of least total Mahalanobis distance within the gate."""
        if not tracks or not len(centres):
            return []
        offset = centres[None, :, :] - np.array([track.state[:2] for track in tracks])[:, None, :]
        S = np.array([track.cov[:2, :2] for track in tracks])[:, None] + noise[None]
        distance2 = np.einsum("tci,tcij,tcj->tc", offset, np.linalg.inv(S), offset)
        cost = np.where(distance2 <= self.config.gate, distance2, 1e6)
        if cost.size == 1:
            return [(0, 0)] if cost[0, 0] <= self.config.gate else []
        from scipy.optimize import linear_sum_assignment  # half a second, not needed before there are tracks

        rows, cols = linear_sum_assignment(cost)
        return [(int(t), int(c)) for t, c in zip(rows, cols, strict=True) if cost[t, c] <= self.config.gate]

    def _correct(
        self, track: Track, centre: FloatArray, noise: FloatArray, beams: IntArray, is_proven: bool
    ) -> Track:
        S = track.cov[:2, :2] + noise
        K = np.linalg.solve(S, track.cov[:2, :]).T
        cov = track.cov - K @ track.cov[:2, :]
        return Track(
            track_id=track.track_id,
            state=track.state + K @ (centre - track.state[:2]),
            cov=0.5 * (cov + cov.T),
            start=track.start,
            n_hits=track.n_hits + 1,
            missed_s=0.0 if is_proven else track.missed_s,
            beams=beams,
        )

    def _begin(self, centre: FloatArray, noise: FloatArray, beams: IntArray) -> Track:
        cov = np.zeros((4, 4))
        cov[:2, :2] = noise
        cov[2, 2] = cov[3, 3] = self.config.start_speed_std_m_s**2
        self._next_id += 1
        return Track(
            track_id=self._next_id - 1,
            state=np.array([centre[0], centre[1], 0.0, 0.0]),
            cov=cov,
            start=centre,
            n_hits=1,
            missed_s=0.0,
            beams=beams,
        )
