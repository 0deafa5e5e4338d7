"""No tracking: moving points stay points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slammot_graph.core.results import TrackState
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking.base import ScanView, Track, track_states


@dataclass(frozen=True, kw_only=True)
class NoTrackingConfig:
    """No tracks."""


class NoTracking:
    """A `Tracker` that follows nothing."""

    needs_clusters = False

    @property
    def n_tracks(self) -> int:
        """See `Tracker`; there are none."""
        return 0

    @property
    def tracks(self) -> list[Track]:
        """See `Tracker`; there are none."""
        return []

    @property
    def sightings(self) -> None:
        """See `Tracker`; they are not kept."""

    def predicted_positions(self, stamp_s: float) -> FloatArray:
        """See `Tracker`."""
        return np.empty((0, 2))

    def shown(self) -> list[Track]:
        """See `Tracker`."""
        return []

    def shown_in(self, T_a_local: FloatArray) -> tuple[TrackState, ...]:
        """See `Tracker`."""
        return track_states(self.shown(), T_a_local)

    def displaced(self) -> list[Track]:
        """See `Tracker`."""
        return []

    def on_objects(self, n_beams: int) -> BoolArray:
        """See `Tracker`."""
        return np.zeros((2, n_beams), dtype=np.bool_)

    def update(
        self,
        stamp_s: float,
        centres: FloatArray,
        centre_covs: FloatArray,
        beams: Sequence[IntArray],
        is_proven: BoolArray | None = None,
        view: ScanView | None = None,
    ) -> None:
        """See `Tracker`."""
