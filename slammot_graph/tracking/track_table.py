"""All tracks of a tracker as columns of numbers, which its kernels fill."""

import numpy as np

from slammot_graph.core.results import TrackState
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking import _table_kernels as _kernels
from slammot_graph.tracking.base import Sightings, Track

Columns = tuple[
    FloatArray, FloatArray, FloatArray, IntArray, FloatArray, BoolArray, FloatArray, IntArray, IntArray
]

_ROOM = 64
"""Tracks that there is room for at first."""


class TrackTable:
    """Columns with an entry for each track, the older ones first, and room for more; and the latest scan's sightings.

    Attributes
    ----------
    n, next_id : int
        Number of tracks, next identity.
    n_latest : tuple of two int
        Numbers of the latest scan's sightings, and of the tracks that are to be shown.
    states, covs, starts : (room, 4), (room, 4, 4), (room, 2) arrays
        x, y, vx, vy [m, m/s]; where each was first seen [m].
    whole, times, flags : (5, room), (5, room), (2, room) arrays
        Their rows are named in the kernels.
    seen : (room, 8) array
        Identity, x, y [m], xx, xy, yy [m^2], extent [m] of each sighting, and how far its points lie off their line.
    beam_starts, beams : (room + 1,), (n_beams,) int arrays
        Beams of track t: ``beams[beam_starts[t]:beam_starts[t + 1]]``.
    """

    def __init__(self) -> None:
        self.n = self.next_id = 0
        self.n_latest = 0, 0
        self.states: FloatArray = np.zeros((_ROOM, 4))
        self.covs: FloatArray = np.zeros((_ROOM, 4, 4))
        self.starts: FloatArray = np.zeros((_ROOM, 2))
        self.whole: IntArray = np.zeros((5, _ROOM), dtype=np.int64)
        self.times: FloatArray = np.zeros((6, _ROOM))
        self.flags: BoolArray = np.zeros((2, _ROOM), dtype=np.bool_)
        self.seen: FloatArray = np.full((_ROOM, 8), np.nan)
        self.beam_starts: IntArray = np.zeros(_ROOM + 1, dtype=np.int64)
        self.beams: IntArray = np.zeros(0, dtype=np.int64)

    def reserve(self, n_new: int) -> None:
        """Make room for so many more tracks."""
        more = self.n + n_new - len(self.states)
        if more <= 0:
            return
        for name in ("states", "covs", "starts", "seen", "beam_starts"):
            column = getattr(self, name)
            setattr(self, name, np.concatenate([column, np.zeros((more, *column.shape[1:]), column.dtype)]))
        for name in ("whole", "times", "flags"):
            rows = getattr(self, name)
            setattr(self, name, np.concatenate([rows, np.zeros((len(rows), more), rows.dtype)], axis=1))

    def columns(self, n_beams: int) -> Columns:
        """Give what the kernels take, in their order, with new room for the beams of a scan."""
        self.beams = np.empty(n_beams, dtype=np.int64)
        return (
            self.states, self.covs, self.starts, self.whole, self.times, self.flags, self.seen, self.beam_starts,
            self.beams,
        )  # fmt: skip

    def listed(self, rows: list[int]) -> list[Track]:
        """Give some of the tracks, which later scans do not change."""
        if not rows:
            return []
        states, covs = self.states[: self.n].copy(), self.covs[: self.n].copy()
        starts, at = self.starts[: self.n].copy(), self.beam_starts[: self.n + 1].tolist()
        ids, n_hits = (
            self.whole[_kernels.ID, : self.n].tolist(),
            self.whole[_kernels.N_HITS, : self.n].tolist(),
        )
        missed_s = self.times[_kernels.MISSED_S, : self.n].tolist()
        return [
            Track(
                track_id=ids[t],
                state=states[t],
                cov=covs[t],
                start=starts[t],
                n_hits=n_hits[t],
                missed_s=missed_s[t],
                beams=self.beams[at[t] : at[t + 1]],
            )
            for t in rows
        ]

    def shown_in(self, T_a_local: FloatArray) -> tuple[TrackState, ...]:
        """Give the tracks that are to be shown in a frame a in which the table's lies at (3,)."""
        n_shown = self.n_latest[1] if self.n else 0
        if not n_shown:
            return ()
        which, motion, covs = (
            np.empty((n_shown, 3), dtype=np.int64),
            np.empty((n_shown, 4)),
            np.empty((n_shown, 2, 2)),
        )
        _kernels.list_shown(
            self.n,
            self.states,
            self.covs,
            self.whole,
            self.flags,
            self.beam_starts,
            T_a_local,
            which,
            motion,
            covs,
        )
        return tuple(
            TrackState(
                track_id=number,
                position=motion[k, :2],
                velocity=motion[k, 2:],
                position_cov=covs[k],
                beams=self.beams[first:end],
            )
            for k, (number, first, end) in enumerate(which.tolist())
        )

    def sightings(self) -> Sightings:
        """Give what was seen at the latest scan."""
        rows = self.seen[: self.n_latest[0]].copy()
        return Sightings(
            ids=rows[:, 0].astype(np.int64),
            places=rows[:, 1:3],
            covs=rows[:, [3, 4, 4, 5]].reshape(-1, 2, 2),
            sizes_m=rows[:, 6],
            thickness_m=rows[:, 7],
        )
