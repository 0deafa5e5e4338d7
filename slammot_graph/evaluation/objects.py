"""Tracks of a run against the true states of the objects: sight, absence and drift, by one convention.

An object counts where at least `MIN_BEAMS` valid beams hit it. A track that follows one with fewer is neither right nor
wrong and is left out. Who was out of sight for more than `ABSENT_S` comes back as a new appearance, since nothing in
the scans says who it is. The truth is brought into the map scan by scan, by the true and the estimated pose of the
robot, so that drift of the map does not count as an error of the tracks.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.scan import Scan
from slammot_graph.core.stamps import nearest_stamps
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.evaluation.consistency import nees_and_coverage
from slammot_graph.evaluation.stats import summarize
from slammot_graph.evaluation.tracks import TrackPoints, TrackScores, evaluate_tracks, match_tracks

MIN_BEAMS = 3
ABSENT_S = 3.0
MAX_DISTANCE_M = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueObjects:
    """The true states of the objects, n scans, k objects.

    Attributes
    ----------
    stamps : (n,) array [s]
    T_world_base : (n, 3) array
    objects : (n, k, 4) array
        x, y [m], vx, vy [m/s] in the world; NaN while away.
    n_beams : (n, k) int array
        Valid beams on each object.
    """

    stamps: FloatArray
    T_world_base: FloatArray
    objects: FloatArray
    n_beams: IntArray

    @classmethod
    def of_beams(
        cls,
        *,
        stamps: FloatArray,
        T_world_base: FloatArray,
        objects: FloatArray,
        object_id: IntArray,
        is_valid: BoolArray,
    ) -> "TrueObjects":
        """Count the valid beams of each object: `object_id`, `is_valid` (n, beams), -1 for no object.

        Raises
        ------
        InputError
            The arrays do not fit each other.
        """
        n, k = objects.shape[:2]
        if not (len(stamps) == len(T_world_base) == len(object_id) == len(is_valid) == n):
            raise InputError(
                f"the true states of {n} scans do not fit {len(stamps)} stamps, {len(T_world_base)} poses and the beams"
                f" of {len(object_id)} scans"
            )
        ids = np.where(is_valid[:, : object_id.shape[1]], object_id[:, : is_valid.shape[1]], -1)
        rows, cols = np.nonzero((ids >= 0) & (ids < k))
        n_beams = np.bincount(rows * k + ids[rows, cols], minlength=n * k).reshape(n, k)
        return cls(stamps=stamps, T_world_base=T_world_base, objects=objects, n_beams=n_beams)


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatedTracks:
    """What a run says of the objects, one row for each object and scan, map frame.

    Attributes
    ----------
    frames, ids : (m,) int arrays
        Row of the scan, identity.
    positions, velocities : (m, 2) arrays [m, m/s]
    covs : (m, 2, 2) array [m^2]
        Of the positions.
    T_map_base : (n, 3) array
        The robot at each scan as estimated when these positions were.
    """

    frames: IntArray
    ids: IntArray
    positions: FloatArray
    velocities: FloatArray
    covs: FloatArray
    T_map_base: FloatArray


@dataclass(frozen=True, kw_only=True)
class ObjectScores:
    """How well the tracks of a run follow the objects; a figure over nothing is NaN.

    Attributes
    ----------
    person, appearance : TrackScores
        With one identity a person for the whole log, and with a new one after an absence. All but the identities'
        scores (IDF1, HOTA, switches) agree.
    n_objects, n_appearances : int
    ids_per_object, ids_per_appearance : float
        Mean number of identities that follow one.
    position_rmse_m, velocity_rmse_m_s : float
        Of the matches [m, m/s].
    nees : float
        Mean normalised squared error of the matched positions; 2 where their covariances are right.
    """

    person: TrackScores
    appearance: TrackScores
    n_objects: int
    n_appearances: int
    ids_per_object: float
    ids_per_appearance: float
    position_rmse_m: float
    velocity_rmse_m_s: float
    nees: float


def read_objects(scans: Iterable[Scan], is_valid: BoolArray) -> TrueObjects | None:
    """Collect the true states of the objects from a log's first n scans, whose valid returns are (n, beams).

    None where a scan does not know its true pose, the objects' states, or which beam hit which.
    """
    stamps, poses, objects, ids = [], [], [], []
    for scan, _ in zip(scans, is_valid, strict=False):
        truth = scan.truth
        if truth is None or truth.T_world_base is None or truth.objects is None or truth.object_id is None:
            return None
        stamps.append(scan.stamp)
        poses.append(truth.T_world_base)
        objects.append(truth.objects)
        ids.append(truth.object_id)
    if not stamps:
        return None
    return TrueObjects.of_beams(
        stamps=np.array(stamps),
        T_world_base=np.array(poses),
        objects=np.array(objects),
        object_id=np.array(ids),
        is_valid=is_valid[: len(stamps)],
    )


def evaluate_objects(
    truth: TrueObjects,
    estimate: EstimatedTracks,
    *,
    min_beams: int = MIN_BEAMS,
    absent_s: float = ABSENT_S,
    max_distance_m: float = MAX_DISTANCE_M,
) -> ObjectScores:
    """Score the tracks of a run, by the convention of this module.

    Parameters
    ----------
    truth : TrueObjects
        Of n scans.
    estimate : EstimatedTracks
        Of the first scans of these.
    min_beams : int
    absent_s : float
    max_distance_m : float
        A track farther than this from an object does not follow it.

    Raises
    ------
    InputError
        The estimate has more scans than the truth, or a row of a scan that is not there.
    """
    n = len(estimate.T_map_base)
    if n > len(truth.stamps) or (len(estimate.frames) and not 0 <= estimate.frames.max() < n):
        raise InputError(f"tracks of {n} scans cannot be judged by a truth of {len(truth.stamps)}")
    present = np.isfinite(truth.objects[:n, :, :2]).all(axis=2)
    frames, people = np.nonzero(present)
    places, velocities = _in_map(truth, estimate.T_map_base, frames, people)
    is_seen = truth.n_beams[frames, people] >= min_beams
    appearances = _appearances(truth.stamps[:n], frames, people, is_seen, absent_s)

    everybody = TrackPoints(frames=frames, ids=people, positions=places)
    followed = match_tracks(everybody, _points(estimate), max_distance_m=max_distance_m)
    is_judged = np.full(len(estimate.frames), True)
    is_judged[followed.estimate_rows[~is_seen[followed.truth_rows]]] = False

    found = _points(estimate, is_judged)
    scores = [
        evaluate_tracks(
            TrackPoints(frames=frames[is_seen], ids=ids[is_seen], positions=places[is_seen]),
            found,
            max_distance_m=max_distance_m,
        )
        for ids in (people, appearances)
    ]
    seen = TrackPoints(frames=frames[is_seen], ids=people[is_seen], positions=places[is_seen])
    matches = match_tracks(seen, found, max_distance_m=max_distance_m)
    of_truth = np.flatnonzero(is_seen)[matches.truth_rows]
    of_estimate = np.flatnonzero(is_judged)[matches.estimate_rows]
    offset = estimate.positions[of_estimate] - places[of_truth]
    ids = estimate.ids[of_estimate]
    return ObjectScores(
        person=scores[0],
        appearance=scores[1],
        n_objects=len(np.unique(people[is_seen])),
        n_appearances=len(np.unique(appearances[is_seen])),
        ids_per_object=_ids_per(people[of_truth], ids),
        ids_per_appearance=_ids_per(appearances[of_truth], ids),
        position_rmse_m=_rms(offset),
        velocity_rmse_m_s=_rms(estimate.velocities[of_estimate] - velocities[of_truth]),
        nees=nees_and_coverage(offset, estimate.covs[of_estimate])[0],
    )


def true_places(
    truth: TrueObjects, T_map_base: FloatArray, *, min_beams: int = MIN_BEAMS, absent_s: float = ABSENT_S
) -> tuple[IntArray, IntArray, FloatArray, BoolArray]:
    """Rows of the truth in the map of estimated poses (n, 3): scan, appearance, place [m], and whether it counts.

    Rows that do not count belong to the appearance before them; -1 before the first one.
    """
    n = len(T_map_base)
    frames, people = np.nonzero(np.isfinite(truth.objects[:n, :, :2]).all(axis=2))
    places, _ = _in_map(truth, T_map_base, frames, people)
    is_seen = truth.n_beams[frames, people] >= min_beams
    appearances = _appearances(truth.stamps[:n], frames, people, is_seen, absent_s)
    for person in np.unique(people):
        rows = np.flatnonzero(people == person)
        last = np.maximum.accumulate(np.where(is_seen[rows], np.arange(len(rows)), -1))
        appearances[rows] = np.where(last >= 0, appearances[rows[last]], -1)
    return frames, appearances, places, is_seen


def estimated_tracks(
    stamps: FloatArray,
    T_map_base: FloatArray,
    tracks: FloatArray,
    T_map_base_of_rows: FloatArray | None = None,
) -> EstimatedTracks:
    """Take the rows of a run's tracks; parameters and errors as of `evaluate_run_tracks`."""
    frames = nearest_stamps(stamps, tracks[:, 0], 1e-4)
    if (frames < 0).any():
        raise InputError("tracks have times at which the run has no scan; were files of two runs mixed?")
    poses = T_map_base.copy()
    if T_map_base_of_rows is not None:
        poses[frames] = T_map_base_of_rows
    return EstimatedTracks(
        frames=frames,
        ids=tracks[:, 1].astype(np.int64),
        positions=tracks[:, 2:4],
        velocities=tracks[:, 4:6],
        covs=tracks[:, [6, 7, 7, 8]].reshape(-1, 2, 2),
        T_map_base=poses,
    )


def evaluate_run_tracks(
    stamps: FloatArray,
    T_map_base: FloatArray,
    tracks: FloatArray,
    truth: TrueObjects,
    T_map_base_of_rows: FloatArray | None = None,
) -> ObjectScores:
    """Score the rows of a run's tracks.

    Parameters
    ----------
    stamps, T_map_base : (n,) array [s], (n, 3) array
        Scans and poses of the run.
    tracks : (m, 9) array
        The columns of ``tracks.csv``.
    truth : TrueObjects
    T_map_base_of_rows : (m, 3) array, optional
        The robot's pose for each row, in place of `T_map_base`: as estimated when the row was.

    Raises
    ------
    InputError
        A row has the time of no scan.
    """
    return evaluate_objects(truth, estimated_tracks(stamps, T_map_base, tracks, T_map_base_of_rows))


def _points(estimate: EstimatedTracks, is_used: BoolArray | None = None) -> TrackPoints:
    rows = slice(None) if is_used is None else is_used
    return TrackPoints(
        frames=estimate.frames[rows], ids=estimate.ids[rows], positions=estimate.positions[rows]
    )


def _in_map(
    truth: TrueObjects, T_map_base: FloatArray, frames: IntArray, people: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Places and velocities (m, 2) of the objects in the map, as the robot's estimated pose puts them."""
    T_map_world = se2.compose(T_map_base, se2.inverse(truth.T_world_base[: len(T_map_base)]))[frames]
    states = truth.objects[frames, people]
    R = se2.rotation(T_map_world[:, 2])
    turned = np.einsum("mij,mkj->mki", R, states.reshape(-1, 2, 2))
    return turned[:, 0] + T_map_world[:, :2], turned[:, 1]


def _appearances(
    stamps: FloatArray, frames: IntArray, people: IntArray, is_seen: BoolArray, absent_s: float
) -> IntArray:
    """(m,) number of each row's appearance: a new one after more than `absent_s` out of sight."""
    numbers = np.full(len(frames), -1)
    n = 0
    for person in np.unique(people):
        rows = np.flatnonzero((people == person) & is_seen)
        is_new = np.diff(stamps[frames[rows]], prepend=-math.inf) > absent_s
        numbers[rows] = n - 1 + np.cumsum(is_new)
        n += int(is_new.sum())
    return numbers


def _ids_per(whose: IntArray, ids: IntArray) -> float:
    pairs = np.unique(np.column_stack([whose, ids]), axis=0)
    return len(pairs) / len(np.unique(whose)) if len(pairs) else math.nan


def _rms(offset: FloatArray) -> float:
    length = np.hypot(offset[:, 0], offset[:, 1])
    return summarize(length[np.isfinite(length)]).rmse
