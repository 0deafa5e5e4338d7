"""What the pipeline asks of a tracker, and what it gets."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import TrackState
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking import _kernels


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


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanView:
    """A scan of n beams as a tracker sees it: what was found, and where the laser looked. Frame: the tracker's.

    Attributes
    ----------
    points : (n, 2) array [m]
    packed_cov : (n, 3) array [m^2]
        Covariances of the points: xx, xy, yy.
    cluster : (n,) int array
        Cluster of a moving beam, -1 for others.
    is_proven : (n,) bool array
        Beams on cells that were seen free.
    T_local_laser : (3,) array
    angle_min, angle_increment : float [rad]
        Of the beams, laser frame: the field of view.
    ranges : (n,) array [m]
    is_valid : (n,) bool array
        Beams that hit something.
    no_return_m : float
        Of the others, those with a range from this on hit nothing within the laser's reach; of the rest nothing is
        known.
    """

    points: FloatArray
    packed_cov: FloatArray
    cluster: IntArray
    is_proven: BoolArray
    T_local_laser: FloatArray
    angle_min: float
    angle_increment: float
    ranges: FloatArray
    is_valid: BoolArray
    no_return_m: float

    @classmethod
    def of_scan(
        cls,
        scan: Scan,
        T_local_base: FloatArray,
        points: FloatArray,
        *,
        packed_cov: FloatArray,
        cluster: IntArray,
        is_proven: BoolArray,
        is_valid: BoolArray,
        range_fraction: float,
    ) -> "ScanView":
        """View a scan whose base lies at a pose (3,); `range_fraction` as of `Scan.is_no_return`."""
        return cls(
            points=points,
            packed_cov=packed_cov,
            cluster=cluster,
            is_proven=is_proven,
            T_local_laser=se2.compose(T_local_base, np.array(scan.laser.T_base_laser)),
            angle_min=scan.laser.angle_min,
            angle_increment=scan.laser.angle_increment,
            ranges=scan.ranges,
            is_valid=is_valid,
            no_return_m=range_fraction * scan.laser.range_max,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Sightings:
    """What a tracker saw of its objects at one scan, m of them: places as measured, not as filtered.

    Attributes
    ----------
    ids : (m,) int array
    places : (m, 2) array [m]
    covs : (m, 2, 2) array [m^2]
    sizes_m : (m,) array
        Extent of what was seen.
    thickness_m : (m,) array
        How far its points lie off their line, root mean square; NaN with too few points.
    """

    ids: IntArray
    places: FloatArray
    covs: FloatArray
    sizes_m: FloatArray
    thickness_m: FloatArray


class Tracker(Protocol):
    """Follows the clusters of moving points from scan to scan."""

    @property
    def needs_clusters(self) -> bool:
        """Whether the clusters are looked at where there is a view of the scan."""

    @property
    def sightings(self) -> Sightings | None:
        """What was seen at the latest scan; None of a tracker whose tracks are not smoothed after the run."""

    @property
    def n_tracks(self) -> int:
        """Number of tracks now, confirmed or not."""

    @property
    def tracks(self) -> list[Track]:
        """All tracks now, confirmed or not."""

    def predicted_positions(self, stamp_s: float) -> FloatArray:
        """(k, 2) places [m] where objects that have displaced should be at a stamp [s], tracker's frame."""

    def shown(self) -> list[Track]:
        """Confirmed tracks, those that are to be shown."""

    def shown_in(self, T_a_local: FloatArray) -> tuple[TrackState, ...]:
        """Give them in a frame a in which the tracker's lies at (3,)."""

    def displaced(self) -> list[Track]:
        """Confirmed tracks of objects that have displaced."""

    def on_objects(self, n_beams: int) -> BoolArray:
        """(2, n_beams) beams of the latest scan on such objects; on these or others that are no false alarm."""

    def update(
        self,
        stamp_s: float,
        centres: FloatArray,
        centre_covs: FloatArray,
        beams: Sequence[IntArray],
        is_proven: BoolArray | None = None,
        view: ScanView | None = None,
    ) -> None:
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
        view : ScanView, optional
            The scan itself; where there is none, no track is known to be occluded.
        """


def track_states(tracks: Sequence[Track], T_a_local: FloatArray) -> tuple[TrackState, ...]:
    """Carry tracks from the local frame, which lies at (3,) in frame a, into that."""
    carried = []
    for track in tracks:
        motion, cov = np.empty(4), np.empty((2, 2))
        _kernels.carry_track(track.state, track.cov, T_a_local, motion, cov)
        carried.append(
            TrackState(
                track_id=track.track_id,
                position=motion[:2],
                velocity=motion[2:],
                position_cov=cov,
                beams=track.beams,
            )
        )
    return tuple(carried)
