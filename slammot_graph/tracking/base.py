"""What the pipeline asks of a tracker, and what it gets."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import TrackState
from slammot_graph.core.types import BoolArray, FloatArray, IntArray


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
        Time since the last cluster in which a laser looked there.
    beams : (k,) int array
        Beams of the latest scan; empty when the track was only predicted.
    unseen_s : float
        Time since a laser last looked where the object should be; zero where there is one laser.
    """

    track_id: int
    state: FloatArray
    cov: FloatArray
    start: FloatArray
    n_hits: int
    missed_s: float
    beams: IntArray
    unseen_s: float = 0.0


LooksAt = Callable[[FloatArray], BoolArray]
"""Of places (k, 2) [m], those that a scan looks at."""


class Tracker(Protocol):
    """Follows the clusters of moving points from scan to scan."""

    @property
    def tracks(self) -> list[Track]:
        """All tracks now, confirmed or not."""

    def predicted_positions(self, stamp_s: float) -> FloatArray:
        """(k, 2) places [m] where objects that have displaced should be at a stamp [s], tracker's frame."""

    def displaced(self) -> list[Track]:
        """Confirmed tracks of objects that have displaced."""

    def update(
        self,
        stamp_s: float,
        centres: FloatArray,
        centre_covs: FloatArray,
        beams: Sequence[IntArray],
        is_proven: BoolArray | None = None,
        looks_at: "LooksAt | None" = None,
    ) -> list[Track]:
        """Take in the clusters of a scan.

        Parameters
        ----------
        stamp_s : float
        centres : (k, 2) array [m]
            Cluster centres, tracker's frame.
        centre_covs : (k, 2, 2) array [m^2]
            Of the centres, as far as the pose's uncertainty goes.
        beams : k int arrays
            Beams of each cluster.
        is_proven : (k,) bool array, optional
            Clusters with a beam on free cells; by default all.
        looks_at : callable, optional
            Of the scan of one among several lasers: which places (k, 2), tracker's frame, it looked at. An object
            elsewhere is not missed. By default the scan looked everywhere.

        Returns
        -------
        Confirmed tracks.
        """


def track_states(tracks: Sequence[Track], T_map_local: FloatArray) -> tuple[TrackState, ...]:
    """Carry tracks from the local frame, which lies at (3,) in the map, into the map frame."""
    if not tracks:
        return ()
    R = se2.rotation(T_map_local[2])
    turned = np.array([track.state for track in tracks]).reshape(-1, 2, 2) @ R.T  # rows: place, velocity
    places = turned[:, 0] + T_map_local[:2]
    covs = R @ np.array([track.cov for track in tracks])[:, :2, :2] @ R.T
    return tuple(
        TrackState(
            track_id=track.track_id,
            position=place,
            velocity=velocity,
            position_cov=cov,
            beams=track.beams,
        )
        for track, place, velocity, cov in zip(tracks, places, turned[:, 1], covs, strict=True)
    )


EDGE_BEAMS = 2
"""A cluster that reaches so near to the first or last beam of a scan may be cut off there."""

EDGE_STD_M = 0.25
"""How far the centre of what is seen of a person may be from his own, where the field of view cuts him."""


def edge_covariances(beams: Sequence[IntArray], n_beams: int) -> FloatArray:
    """(k, 2, 2) covariances [m^2] that clusters' centres have in addition where the field of view cuts them."""
    is_cut = np.array(
        [b.min() < EDGE_BEAMS or b.max() >= n_beams - EDGE_BEAMS for b in beams], dtype=np.float64
    )
    return np.asarray(EDGE_STD_M**2 * is_cut[:, None, None] * np.eye(2))
