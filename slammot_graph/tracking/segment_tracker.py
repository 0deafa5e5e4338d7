"""Tracks of people: a track joins the segments of a scan that belong to one body, and knows what the laser sees."""

from collections.abc import Sequence

import numpy as np

from slammot_graph.core.results import TrackState
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking import _follow_kernels as _kernels
from slammot_graph.tracking import _table_kernels
from slammot_graph.tracking.base import ScanView, Sightings, Track
from slammot_graph.tracking.clock import TrackerClock
from slammot_graph.tracking.segment_config import SegmentTrackerConfig
from slammot_graph.tracking.track_table import TrackTable

_NO_BEAMS: BoolArray = np.empty(0, dtype=np.bool_)
_NO_POSE: FloatArray = np.zeros(3)
_NO_RANGES: FloatArray = np.empty(0)
_NOWHERE: FloatArray = np.empty((0, 2))


class SegmentTracker:
    """A `Tracker` of people and other things of their size."""

    needs_clusters = False

    def __init__(self, config: SegmentTrackerConfig) -> None:
        self.config = config
        self._limits = config.limits()
        self._table = TrackTable()
        self._clock = TrackerClock(config.max_missed_s)
        self._on_objects: BoolArray = np.zeros((2, 0), dtype=np.bool_)

    @property
    def n_tracks(self) -> int:
        """See `Tracker`."""
        return self._table.n

    @property
    def tracks(self) -> list[Track]:
        """See `Tracker`."""
        return self._table.listed(list(range(self._table.n)))

    @property
    def sightings(self) -> Sightings:
        """See `Tracker`."""
        return self._table.sightings()

    def predicted_positions(self, stamp_s: float) -> FloatArray:
        """(k, 2) places [m] where objects that have displaced should be at a stamp [s], tracker's frame."""
        table = self._table
        if not table.n:
            return _NOWHERE
        places = np.empty((table.n, 2))
        dt = self._clock.elapsed_s(stamp_s)
        return places[
            : _table_kernels.expected_places(table.n, dt, table.states, table.times, table.flags, places)
        ]

    def shown(self) -> list[Track]:
        """Confirmed tracks that were seen a moment ago."""
        return self._table.listed(
            np.flatnonzero(self._table.flags[_table_kernels.IS_SHOWN, : self._table.n]).tolist()
        )

    def shown_in(self, T_a_local: FloatArray) -> tuple[TrackState, ...]:
        """See `Tracker`."""
        return self._table.shown_in(T_a_local)

    def displaced(self) -> list[Track]:
        """See `Tracker`."""
        table = self._table
        is_late = table.times[_table_kernels.MISSED_S, : table.n] > _table_kernels.EXPECTED_S
        return table.listed(
            np.flatnonzero(table.flags[_table_kernels.HAS_DISPLACED, : table.n] & ~is_late).tolist()
        )

    def on_objects(self, n_beams: int) -> BoolArray:
        """See `Tracker`."""
        return self._on_objects if self._table.n else np.zeros((2, n_beams), dtype=np.bool_)

    def update(
        self,
        stamp_s: float,
        centres: FloatArray,
        centre_covs: FloatArray,
        beams: Sequence[IntArray],
        is_proven: BoolArray | None = None,
        view: ScanView | None = None,
    ) -> None:
        """Predict to `stamp_s`, join segments to tracks, begin and end tracks.

        Parameters
        ----------
        stamp_s : float
            A stamp that runs backward counts as no time passed.
        centres, centre_covs, beams, is_proven
            See `Tracker`; without a view each cluster is one segment, with one they are not looked at.
        view : ScanView, optional
            The scan itself: its segments, and what the laser sees where no object was found.
        """
        dt = self._clock.advance(stamp_s)
        table = self._table
        if view is None and not len(centres) and not table.n:
            table.n_latest = 0, 0
            self._on_objects = np.empty((2, 0), dtype=np.bool_)
            return
        if view is None:
            rows, segment = self._segments(centres, centre_covs, beams, is_proven)
            table.reserve(len(rows))
            self._on_objects = np.empty((2, len(segment)), dtype=np.bool_)
            done = _kernels.follow(
                rows, segment, False, _NO_POSE, 0.0, 1.0, _NO_RANGES, _NO_BEAMS, np.inf,
                dt, self._limits, table.n, table.next_id, *table.columns(len(segment)), self._on_objects,
            )  # fmt: skip
        else:
            n_beams = len(view.points)
            table.reserve(n_beams)
            self._on_objects = np.empty((2, n_beams), dtype=np.bool_)
            done = _kernels.follow_scan(
                view.points, view.packed_cov, view.cluster, view.is_proven, view.T_local_laser, view.angle_min,
                view.angle_increment, view.ranges, view.is_valid, view.no_return_m,
                dt, self._limits, table.n, table.next_id, *table.columns(n_beams), self._on_objects,
            )  # fmt: skip
        table.n, table.next_id, *n_latest = done
        table.n_latest = n_latest[0], n_latest[1]

    def _segments(
        self,
        centres: FloatArray,
        centre_covs: FloatArray,
        beams: Sequence[IntArray],
        is_proven: BoolArray | None,
    ) -> tuple[FloatArray, IntArray]:
        """(k, 8) table of the clusters as segments, and the segment of each beam."""
        proven = np.full(len(centres), True) if is_proven is None else is_proven
        sizes = np.array([len(own) for own in beams], dtype=np.float64)
        segment = np.full(1 + max((int(own.max()) for own in beams if len(own)), default=-1), -1)
        for s, own in enumerate(beams):
            segment[own] = s
        width = np.full(len(centres), 2.0 * self.config.leg_width_m)
        covs = [centre_covs[:, 0, 0], centre_covs[:, 0, 1], centre_covs[:, 1, 1]]
        return np.column_stack([sizes, centres, width, *covs, sizes * proven]), segment
