"""What the pipeline asks of a tracker, and what it gets."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
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


@dataclass(kw_only=True, eq=False)
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
    is_one_of_several : bool
        Other lasers of the robot look elsewhere.
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
    is_one_of_several: bool = False

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
        """View a scan whose base lies at a pose (3,); `range_fraction` as of `Scan.is_no_return`.

        A sweep is seen as if taken at once: from the middle of its origins, with evenly spaced beams.
        """
        T_base_laser, angle_increment, ranges = _seen_at_once(scan)
        return cls(
            points=points,
            packed_cov=packed_cov,
            cluster=cluster,
            is_proven=is_proven,
            T_local_laser=se2.compose(T_local_base, T_base_laser),
            angle_min=scan.laser.angle_min,
            angle_increment=angle_increment,
            ranges=ranges,
            is_valid=is_valid,
            no_return_m=range_fraction * scan.laser.range_max,
        )

    def by_one_of_several(self) -> "ScanView":
        """The same by one of several lasers: who goes on into the view of another one is seen in part, at its edge.

        Across the line of sight, the centre of a body this near to the edge of the field of view is less certain.
        """
        n = len(self.ranges)
        view_rad = n * abs(self.angle_increment)
        if n == 0 or view_rad > 2.0 * math.pi - 0.5 * abs(self.angle_increment):
            return replace(self, is_one_of_several=True)
        beams = np.arange(n)
        to_edge_m = self.ranges * abs(self.angle_increment) * (np.minimum(beams, n - 1 - beams) + 0.5)
        at_edge = np.flatnonzero((self.cluster >= 0) & (to_edge_m < EDGE_M))
        if not len(at_edge):
            return replace(self, is_one_of_several=True)
        angles = self.T_local_laser[2] + self.angle_min + self.angle_increment * at_edge
        x, y = -EDGE_STD_M * np.sin(angles), EDGE_STD_M * np.cos(angles)
        packed_cov = self.packed_cov.copy()
        packed_cov[at_edge] += np.column_stack([x * x, x * y, y * y])
        return replace(self, packed_cov=packed_cov, is_one_of_several=True)


def _seen_at_once(scan: Scan) -> tuple[FloatArray, float, FloatArray]:
    """Pose (3,) of the laser in the base, step between its beams [rad] and its ranges (n,) [m] at the stamp."""
    laser = scan.laser
    if scan.sweep is None or laser.n_beams < 2:
        return np.array(laser.T_base_laser), laser.angle_increment, scan.ranges
    origin = scan.origins_base.mean(axis=0)
    bearings = np.unwrap(np.arctan2(scan.directions_base[:, 1], scan.directions_base[:, 0]))
    step = float(bearings[-1] - bearings[0]) / (laser.n_beams - 1)
    if step * laser.angle_increment <= 0.0:  # a robot that turns faster than its laser
        step = laser.angle_increment
    ranges = np.hypot(*(scan.points_base() - origin).T)
    ranges = np.where(np.isfinite(ranges), ranges, scan.ranges)
    return np.array([*origin, bearings[0] - laser.angle_min]), step, ranges


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


EDGE_BEAMS = 2
"""A cluster that reaches so near to the first or last beam of a scan may be cut off there."""

EDGE_M = 0.3
"""Where the edge of the field of view is nearer than this to a part of a person, it may cut him."""

EDGE_STD_M = 0.25
"""How far the centre of what is seen of a person may be from his own, where the field of view cuts him."""


def edge_covariances(beams: Sequence[IntArray], n_beams: int) -> FloatArray:
    """(k, 2, 2) covariances [m^2] that clusters' centres have in addition where the field of view cuts them."""
    is_cut = np.array(
        [b.min() < EDGE_BEAMS or b.max() >= n_beams - EDGE_BEAMS for b in beams], dtype=np.float64
    )
    return np.asarray(EDGE_STD_M**2 * is_cut[:, None, None] * np.eye(2))
