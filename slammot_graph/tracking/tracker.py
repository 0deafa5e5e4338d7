"""Tracks of moving objects: a constant-velocity Kalman filter each, joined to clusters by global assignment."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from slammot_graph.core.checks import Checked, Count, Positive, PositiveOrInfinite
from slammot_graph.core.results import TrackState
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking import _kernels as _track_kernels
from slammot_graph.tracking import _sight_kernels as _sight
from slammot_graph.tracking.base import ScanView, Track, edge_covariances, track_states
from slammot_graph.tracking.clock import TrackerClock

_BODY_M = 0.3
"""Half the width of what must be in view at an object's place, and how far before it a return may be."""


@dataclass(frozen=True, kw_only=True)
class KalmanTrackerConfig(Checked):
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
    max_unseen_s : float
        So does one where none of several lasers looked for this long.
    min_distance_m : float
        An object has displaced when it is this far from where it was first seen.
    """

    acceleration_std_m_s2: Positive = 1.5
    centre_std_m: Positive = 0.12
    start_speed_std_m_s: Positive = 1.0
    gate: PositiveOrInfinite = 9.21
    n_confirm: Count = 3
    max_missed_s: Positive = 1.0
    max_unseen_s: Positive = 2.0
    min_distance_m: Positive = 1.0


class KalmanTracker:
    """A `Tracker`: follows the clusters of moving points from scan to scan."""

    needs_clusters = True

    def __init__(self, config: KalmanTrackerConfig) -> None:
        self.config = config
        self.tracks: list[Track] = []
        self._clock = TrackerClock(config.max_missed_s)
        self._next_id = 0
        self._centre_cov = config.centre_std_m**2 * np.eye(2)

    @property
    def n_tracks(self) -> int:
        """See `Tracker`."""
        return len(self.tracks)

    @property
    def sightings(self) -> None:
        """See `Tracker`; they are not kept."""

    def predicted_positions(self, stamp_s: float) -> FloatArray:
        """(k, 2) places [m] where objects that have displaced should be at a stamp [s], tracker's frame."""
        dt = self._clock.elapsed_s(stamp_s)
        states = np.array([track.state for track in self.displaced()]).reshape(-1, 4)
        return states[:, :2] + dt * states[:, 2:]

    def shown(self) -> list[Track]:
        """Confirmed tracks."""
        return [track for track in self.tracks if track.n_hits >= self.config.n_confirm]

    def shown_in(self, T_a_local: FloatArray) -> tuple[TrackState, ...]:
        """See `Tracker`."""
        return track_states(self.shown(), T_a_local)

    def displaced(self) -> list[Track]:
        """Confirmed tracks of objects that have displaced."""
        return [
            track
            for track in self.tracks
            if track.n_hits >= self.config.n_confirm
            and math.dist(track.state[:2].tolist(), track.start.tolist()) >= self.config.min_distance_m
        ]

    def on_objects(self, n_beams: int) -> BoolArray:
        """See `Tracker`; both are the same."""
        is_on = np.zeros((2, n_beams), dtype=np.bool_)
        for track in self.displaced():
            is_on[:, track.beams] = True
        return is_on

    def update(
        self,
        stamp_s: float,
        centres: FloatArray,
        centre_covs: FloatArray,
        beams: Sequence[IntArray],
        is_proven: BoolArray | None = None,
        view: ScanView | None = None,
    ) -> None:
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
        view : ScanView, optional
            Of the scan of one among several lasers: an object where it did not look is not missed.
        """
        dt = self._clock.advance(stamp_s)
        if not self.tracks and not len(centres):
            return
        proven = [True] * len(centres) if is_proven is None else is_proven.tolist()
        noise = centre_covs + self._centre_cov
        if view is not None and view.is_one_of_several and len(beams):
            noise = noise + edge_covariances(beams, len(view.ranges))
        states = np.array([track.state for track in self.tracks]).reshape(-1, 4)
        covs = np.array([track.cov for track in self.tracks]).reshape(-1, 4, 4)
        _track_kernels.predict(states, covs, dt, self.config.acceleration_std_m_s2)
        cluster_of = self._assign(states, covs, centres, noise)
        _track_kernels.correct(states, covs, centres, noise, cluster_of)
        joined = cluster_of.tolist()
        followed = [
            _follow(track, state, cov, dt, beams[c], proven[c])
            if c >= 0
            else _follow(track, state, cov, dt, None, False)
            for track, state, cov, c in zip(self.tracks, states, covs, joined, strict=True)
        ]
        if view is not None and view.is_one_of_several and followed:
            followed = self._less_missed(followed, dt, view)
        kept = [track for track in followed if self._lives(track)]
        begun = [
            self._begin(centres[c], noise[c], beams[c])
            for c in range(len(centres))
            if proven[c] and c not in joined
        ]
        self.tracks = kept + begun

    def _less_missed(self, followed: list[Track], dt: float, view: ScanView) -> list[Track]:
        """Take back what tracks have missed, `dt` [s], where the scan did not look; that counts later in part."""
        sight = np.empty(len(followed), dtype=np.int64)
        _sight.sight_at(
            np.array([track.state for track in followed]),
            view.T_local_laser,
            view.angle_min,
            view.angle_increment,
            view.ranges,
            view.is_valid,
            view.no_return_m,
            _BODY_M,
            sight,
        )
        is_looked_at = (sight != _sight.OUT_OF_VIEW) & (sight != _sight.OCCLUDED)
        longest_s = 0.5 * self.config.max_missed_s
        out = []
        for track, is_looked in zip(followed, is_looked_at.tolist(), strict=True):
            if track.missed_s == 0.0:
                out.append(replace(track, unseen_s=0.0))
            elif is_looked:
                missed_s = track.missed_s + min(track.unseen_s, longest_s)
                out.append(replace(track, missed_s=missed_s, unseen_s=0.0))
            else:
                missed_s, unseen_s = track.missed_s - dt, track.unseen_s + dt
                out.append(replace(track, missed_s=missed_s, unseen_s=unseen_s))
        return out

    def _lives(self, track: Track) -> bool:
        return track.missed_s <= self.config.max_missed_s and track.unseen_s <= self.config.max_unseen_s

    def _assign(
        self, states: FloatArray, covs: FloatArray, centres: FloatArray, noise: FloatArray
    ) -> IntArray:
        """(n,) cluster joined to each track, -1 for none: of least total Mahalanobis distance within the gate."""
        gate = self.config.gate
        costs = np.empty((len(states), len(centres)))
        cluster_of = np.empty(len(states), dtype=np.int64)
        _track_kernels.pair_costs(states, covs, centres, noise, gate, costs)
        # with a gate as wide as that, a pair within it may cost more than one outside
        if gate < _track_kernels.OUTSIDE and _track_kernels.join_nearest(costs, cluster_of):
            return cluster_of
        from scipy.optimize import linear_sum_assignment  # half a second, not needed before tracks compete

        rows, cols = linear_sum_assignment(costs)
        is_within = costs[rows, cols] <= gate
        cluster_of[:] = -1
        cluster_of[rows[is_within]] = cols[is_within]
        return cluster_of

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


def _follow(
    track: Track, state: FloatArray, cov: FloatArray, dt: float, beams: IntArray | None, is_proven: bool
) -> Track:
    """Give the track a scan later, `dt` [s], with the beams of the cluster joined to it; None: only predicted."""
    return Track(
        track_id=track.track_id,
        state=state,
        cov=cov,
        start=track.start,
        n_hits=track.n_hits if beams is None else track.n_hits + 1,
        missed_s=0.0 if is_proven else track.missed_s + dt,
        beams=np.empty(0, dtype=np.int64) if beams is None else beams,
        unseen_s=track.unseen_s,
    )
