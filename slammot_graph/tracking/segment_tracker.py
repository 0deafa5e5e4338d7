"""Tracks of people: a track joins the segments of a scan that belong to one body, and knows what the laser sees."""

import math
from collections.abc import Sequence

import numpy as np

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking import _kernels as _track_kernels
from slammot_graph.tracking import _segment_kernels as _kernels
from slammot_graph.tracking import _sight_kernels as _sight
from slammot_graph.tracking.base import ScanView, Sightings, Track
from slammot_graph.tracking.clock import TrackerClock
from slammot_graph.tracking.segment_config import SegmentTrackerConfig
from slammot_graph.tracking.track_table import Tracks

_NO_BEAMS: IntArray = np.empty(0, dtype=np.int64)
_NOWHERE: FloatArray = np.empty((0, 2))
_NO_SIGHTINGS = Sightings(
    ids=_NO_BEAMS, places=np.empty((0, 2)), covs=np.empty((0, 2, 2)), sizes_m=np.empty(0)
)


class SegmentTracker:
    """A `Tracker` of people and other things of their size."""

    def __init__(self, config: SegmentTrackerConfig) -> None:
        self.config = config
        self._tracks = Tracks.none()
        self._beams: dict[int, IntArray] = {}
        self._clock = TrackerClock(config.max_missed_s)
        self._next_id = 0
        self.sightings = _NO_SIGHTINGS

    @property
    def tracks(self) -> list[Track]:
        """See `Tracker`."""
        return self._listed(np.full(len(self._tracks), True))

    def predicted_positions(self, stamp_s: float) -> FloatArray:
        """(k, 2) places [m] where objects that have displaced should be at a stamp [s], tracker's frame."""
        dt = self._clock.elapsed_s(stamp_s)
        states = self._tracks.states[self._displaced()]
        return states[:, :2] + dt * states[:, 2:]

    def displaced(self) -> list[Track]:
        """See `Tracker`."""
        return self._listed(self._displaced())

    def update(
        self,
        stamp_s: float,
        centres: FloatArray,
        centre_covs: FloatArray,
        beams: Sequence[IntArray],
        is_proven: BoolArray | None = None,
        view: ScanView | None = None,
    ) -> list[Track]:
        """Predict to `stamp_s`, join segments to tracks, begin and end tracks.

        Parameters
        ----------
        stamp_s : float
            A stamp that runs backward counts as no time passed.
        centres, centre_covs, beams, is_proven
            See `Tracker`; without a view each cluster is one segment, with one they are not looked at.
        view : ScanView, optional
            The scan itself: its segments, and what the laser sees where no object was found.

        Returns
        -------
        Confirmed tracks that were seen a moment ago.
        """
        config = self.config
        dt = self._clock.advance(stamp_s)
        self.sightings = _NO_SIGHTINGS
        tracks = self._tracks
        if not len(tracks) and not (len(centres) if view is None else (view.cluster >= 0).any()):
            return []
        table, segment = _segments(centres, centre_covs, beams, is_proven, view, self._standing(), config)
        n = len(tracks)
        owner, measured = self._associate(table, dt)
        is_hit = np.empty(n, dtype=np.bool_)
        _kernels.note_sightings(
            measured,
            owner,
            table,
            dt,
            tracks.states,
            tracks.starts,
            config.n_confirm,
            config.min_distance_m,
            is_hit,
            tracks.n_hits,
            tracks.missed_s,
            tracks.unproven_s,
            tracks.has_displaced,
        )
        self._look(view, is_hit, dt)
        self._beams = self._beams_of_tracks(owner, segment, beams, view)
        is_ended = self._is_ended() | self._is_twin(is_hit, dt)
        if n and is_ended.any():
            self._tracks = tracks.take(~is_ended)
        self._begin(table, owner, segment, beams, view)
        return self._listed(self._shown())

    def _standing(self) -> FloatArray:
        """(k, 2) places of the objects that have displaced and are slow now."""
        tracks = self._tracks
        if not tracks.has_displaced.any():
            return _NOWHERE
        speed = np.hypot(tracks.states[:, 2], tracks.states[:, 3])
        is_slow = tracks.has_displaced & (speed < self.config.standing_speed_m_s)
        return tracks.states[is_slow, :2]

    def _associate(self, table: FloatArray, dt: float) -> tuple[IntArray, IntArray]:
        """Predict, join and correct; gives the track of each segment and the first segment of each track, or -1."""
        config, tracks = self.config, self._tracks
        n = len(tracks)
        owner, primary = np.full(len(table), -1), np.full(n, -1)
        if not n:
            return owner, primary
        _track_kernels.predict(tracks.states, tracks.covs, dt, config.acceleration_std_m_s2)
        if not len(table):
            return owner, primary
        level = np.where(tracks.n_hits >= config.n_confirm, 0, 1)
        _kernels.assign(
            tracks.states,
            tracks.covs,
            level,
            table,
            config.leg_std_m**2,
            config.gate,
            config.max_jump_m,
            config.body_m,
            primary,
            owner,
        )
        places, noise, n_joined = np.empty((n, 2)), np.empty((n, 2, 2)), np.empty(n, dtype=np.int64)
        sizes = np.empty(n)
        _kernels.measure(
            table,
            owner,
            config.leg_width_m,
            config.leg_std_m**2,
            config.body_std_m**2,
            places,
            noise,
            n_joined,
            sizes,
        )
        _kernels.drop_weak(table, owner, config.min_unproven_points, primary, n_joined)
        of = np.where(n_joined > 0, np.arange(n), -1)
        _track_kernels.correct(tracks.states, tracks.covs, places, noise, of)
        seen = of >= 0
        self.sightings = Sightings(
            ids=tracks.ids[seen], places=places[seen], covs=noise[seen], sizes_m=sizes[seen]
        )
        return owner, primary

    def _look(self, view: ScanView | None, is_hit: BoolArray, dt: float) -> None:
        """Note what the laser sees where a track was not sighted."""
        tracks = self._tracks
        tracks.sight[:] = _sight.PRESENT
        missed = np.flatnonzero(~is_hit)
        if not len(missed):
            tracks.empty_s[:] = 0.0
            return
        if view is None:
            tracks.sight[missed] = _sight.EMPTY
            tracks.empty_s[missed] += dt
        else:
            sight = np.empty(len(missed), dtype=np.int64)
            _sight.sight_at(
                tracks.states[missed],
                view.T_local_laser,
                view.angle_min,
                view.angle_increment,
                view.ranges,
                view.is_valid,
                view.is_no_return,
                self.config.leg_width_m,
                sight,
            )
            tracks.sight[missed] = sight
            tracks.empty_s[missed] += np.where(tracks.sight[missed] == _sight.EMPTY, dt, 0.0)
        tracks.empty_s[is_hit] = 0.0

    def _is_ended(self) -> BoolArray:
        config, tracks = self.config, self._tracks
        is_new = tracks.n_hits < config.n_confirm
        ended = (tracks.empty_s > config.max_empty_s) | (tracks.missed_s > config.max_missed_s)
        ended |= tracks.unproven_s > config.max_unproven_s
        return np.asarray(ended | (is_new & (tracks.missed_s > config.shown_s)))

    def _is_twin(self, is_hit: BoolArray, dt: float) -> BoolArray:
        """Mark tracks on the place of an older one that were hardly ever apart from others."""
        tracks = self._tracks
        is_twin = np.zeros(len(tracks), dtype=np.bool_)
        config = self.config
        _kernels.find_twins(
            tracks.states,
            is_hit,
            dt,
            config.apart_m,
            config.body_m,
            config.twin_m,
            config.max_twin_s,
            tracks.n_alone,
            tracks.twin_s,
            is_twin,
        )
        return is_twin

    def _beams_of_tracks(
        self, owner: IntArray, segment: IntArray, beams: Sequence[IntArray], view: ScanView | None
    ) -> dict[int, IntArray]:
        """The beams of each track that was sighted, by its identity."""
        ids = self._tracks.ids
        if view is None:
            found = {t: [beams[s] for s in np.flatnonzero(owner == t).tolist()] for t in set(owner.tolist())}
            return {int(ids[t]): np.concatenate(own) for t, own in found.items() if t >= 0}
        starts, grouped = np.empty(len(ids) + 1, dtype=np.int64), np.empty(len(segment), dtype=np.int64)
        _kernels.beams_by_track(segment, owner, starts, grouped)
        at = starts.tolist()
        return {
            number: grouped[at[t] : at[t + 1]] for t, number in enumerate(ids.tolist()) if at[t + 1] > at[t]
        }

    def _begin(
        self,
        table: FloatArray,
        owner: IntArray,
        segment: IntArray,
        beams: Sequence[IntArray],
        view: ScanView | None,
    ) -> None:
        """Begin tracks with the segments that belong to none and are not beside an object that is followed."""
        config, tracks = self.config, self._tracks
        is_free = owner < 0
        if not is_free.any():
            return
        followed = tracks.states[tracks.missed_s == 0.0, :2]
        if len(followed):
            offset = table[:, None, _kernels.X : _kernels.Y + 1] - followed
            is_free &= np.hypot(offset[..., 0], offset[..., 1]).min(axis=1) > config.apart_m
        group = np.empty(len(table), dtype=np.int64)
        n_groups = _kernels.group_unowned(table, is_free, config.body_m, group)
        for g in range(n_groups):
            rows = np.flatnonzero(group == g)
            if table[rows, _kernels.N_PROVEN].sum() > 0 and table[rows, _kernels.N_POINTS].sum() >= 2:
                own = (
                    np.flatnonzero(np.isin(segment, rows))
                    if view is not None
                    else np.concatenate([beams[s] for s in rows.tolist()])
                )
                self._add(table[rows], own)

    def _add(self, rows: FloatArray, beams: IntArray) -> None:
        owner = np.zeros(len(rows), dtype=np.int64)
        config = self.config
        place, noise, n_joined = np.empty((1, 2)), np.empty((1, 2, 2)), np.empty(1, dtype=np.int64)
        size = np.empty(1)
        leg, body = config.leg_std_m**2, config.body_std_m**2
        _kernels.measure(rows, owner, config.leg_width_m, leg, body, place, noise, n_joined, size)
        cov = np.zeros((4, 4))
        cov[:2, :2] = noise[0]
        cov[2, 2] = cov[3, 3] = config.start_speed_std_m_s**2
        self._tracks = self._tracks.with_new(self._next_id, place[0], cov)
        self._beams[self._next_id] = beams
        before = self.sightings
        self.sightings = Sightings(
            ids=np.append(before.ids, self._next_id),
            places=np.concatenate([before.places, place]),
            covs=np.concatenate([before.covs, noise]),
            sizes_m=np.append(before.sizes_m, size),
        )
        self._next_id += 1

    def _shown(self) -> BoolArray:
        config, tracks = self.config, self._tracks
        is_known = (tracks.n_hits >= config.n_confirm) & (tracks.missed_s <= config.shown_s)
        return np.asarray(is_known & (tracks.sight != _sight.EMPTY))

    def _displaced(self) -> BoolArray:
        tracks = self._tracks
        return np.asarray(tracks.has_displaced & (tracks.missed_s <= 1.0))

    def _listed(self, is_listed: BoolArray) -> list[Track]:
        tracks = self._tracks
        return [
            Track(
                track_id=(number := int(tracks.ids[t])),
                state=tracks.states[t].copy(),
                cov=tracks.covs[t].copy(),
                start=tracks.starts[t],
                n_hits=int(tracks.n_hits[t]),
                missed_s=float(tracks.missed_s[t]),
                beams=self._beams.get(number, _NO_BEAMS),
            )
            for t in np.flatnonzero(is_listed).tolist()
        ]


def _segments(
    centres: FloatArray,
    centre_covs: FloatArray,
    beams: Sequence[IntArray],
    is_proven: BoolArray | None,
    view: ScanView | None,
    standing: FloatArray,
    config: SegmentTrackerConfig,
) -> tuple[FloatArray, IntArray]:
    """(k, 8) table of the segments, and the segment of each beam; without a view each cluster is one.

    `standing` (m, 2) are places where someone may stand whose beams do not move any more.
    """
    proven = np.full(len(centres), True) if is_proven is None else is_proven
    if view is None:
        sizes = [len(own) for own in beams]
        columns = [sizes, *centres.T, np.full(len(centres), 2.0 * config.leg_width_m)]
        covs = [centre_covs[:, 0, 0], centre_covs[:, 0, 1], centre_covs[:, 1, 1], sizes * proven]
        return np.array([*columns, *covs], dtype=np.float64).T.reshape(-1, 8).copy(), _NO_BEAMS
    n = len(view.points)
    segment, cluster = np.full(n, -1), view.cluster
    if len(standing):
        cluster = np.empty(n, dtype=np.int64)
        is_any = _sight.find_standing(
            view.points,
            view.is_valid,
            view.cluster,
            standing,
            config.standing_reach_m,
            config.standing_gap_m,
            cluster,
        )
    if not (len(standing) and is_any) and not (view.cluster >= 0).any():
        return np.empty((0, 8)), segment
    table = np.empty((n, 8))
    x, y, _ = view.T_local_laser.tolist()
    n_segments = _kernels.find_segments(
        view.points,
        view.packed_cov,
        cluster,
        view.is_proven | (cluster > view.cluster),
        x,
        y,
        view.angle_increment,
        config.segment_gap_m,
        0.25 * math.pi,
        config.leg_width_m,
        segment,
        table,
    )
    return table[:n_segments], segment
