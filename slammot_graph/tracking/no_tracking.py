"""No tracking: moving points stay points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking.base import LooksAt, Track


@dataclass(frozen=True, kw_only=True)
class NoTrackingConfig:
    """No tracks."""


class NoTracking:
    """A `Tracker` that follows nothing."""

    @property
    def tracks(self) -> list[Track]:
        """See `Tracker`; there are none."""
        return []

    def predicted_positions(self, stamp_s: float) -> FloatArray:
        """See `Tracker`."""
        return np.empty((0, 2))

    def displaced(self) -> list[Track]:
        """See `Tracker`."""
        return []

    def update(
        self,
        stamp_s: float,
        centres: FloatArray,
        centre_covs: FloatArray,
        beams: Sequence[IntArray],
        is_proven: BoolArray | None = None,
        looks_at: LooksAt | None = None,
    ) -> list[Track]:
        """See `Tracker`."""
        return []
