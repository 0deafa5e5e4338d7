"""Tracks of moving objects against the truth: MOTA, IDF1, HOTA and the error of positions.

An own small implementation, since the public ones bring an image library or a data frame with them; the tests
hold figures of trackeval 1.3.0, whose rules these are, for comparison.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.evaluation.stats import ratio

_KEPT_BONUS = 1000.0  # a pair of the last frame stays together while it can
_HOTA_LEVELS = np.arange(1, 20) / 20.0


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackPoints:
    """Positions of objects over time, one row each; an object stands at most once in a frame.

    Attributes
    ----------
    frames : (n,) int array
        Scan index.
    ids : (n,) int array
        Which object or track.
    positions : (n, 2) array [m]
        Truth and estimate in the same frame.
    """

    frames: IntArray
    ids: IntArray
    positions: FloatArray

    def __post_init__(self) -> None:
        n = len(self.frames)
        if self.ids.shape != (n,) or self.positions.shape != (n, 2):
            raise InputError(
                f"track points need one id and one position per frame: {n} frames,"
                f" ids {self.ids.shape}, positions {self.positions.shape}"
            )
        pairs = np.unique(np.column_stack([self.frames, self.ids]), axis=0)
        if len(pairs) < n:
            raise InputError("track points hold an object twice in one frame")


@dataclass(frozen=True, kw_only=True)
class TrackScores:
    """How well tracks follow the objects; a share of nothing is NaN.

    Attributes
    ----------
    mota : float
        Multiple object tracking accuracy (Bernardin and Stiefelhagen 2008):
        ``1 - (misses + false + switches) / n``.
    idf1 : float
        F1 of the positions that the best one-to-one pairing of identities explains (Ristani et al. 2016).
    hota, det_a, ass_a : float
        Higher order tracking accuracy, its detection and its association part (Luiten et al. 2021), averaged
        over the levels 0.05 to 0.95 of the similarity ``max(0, 1 - distance / (2 max_distance))``; level 0.5
        is thus the distance at which the other scores accept a match.
    position_rmse_m : float
        Of the matches that MOTA is made from [m].
    n : int
        True positions.
    n_estimates, n_matches, n_misses, n_false, n_switches : int
    """

    mota: float
    idf1: float
    hota: float
    det_a: float
    ass_a: float
    position_rmse_m: float
    n: int
    n_estimates: int
    n_matches: int
    n_misses: int
    n_false: int
    n_switches: int


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackMatches:
    """Which rows of the estimate follow which rows of the truth, by the CLEAR MOT rules.

    Attributes
    ----------
    truth_rows, estimate_rows : (k,) int arrays
        Row ``estimate_rows[i]`` of the estimate was matched to row ``truth_rows[i]`` of the truth.
    distances_m : (k,) array
    n_switches : int
    """

    truth_rows: IntArray
    estimate_rows: IntArray
    distances_m: FloatArray
    n_switches: int


@dataclass(frozen=True, kw_only=True, eq=False)
class _Frame:
    truth: IntArray
    """Dense identities of the objects in this frame, and of the tracks; their rows."""
    tracks: IntArray
    truth_rows: IntArray
    track_rows: IntArray
    distances: FloatArray


def evaluate_tracks(truth: TrackPoints, estimate: TrackPoints, *, max_distance_m: float = 0.5) -> TrackScores:
    """Score tracks against the true positions of the objects.

    Parameters
    ----------
    truth, estimate : TrackPoints
    max_distance_m : float
        A track farther than this from an object does not follow it.

    Returns
    -------
    TrackScores
        With no true position every score is NaN, and the false tracks are counted.

    Raises
    ------
    InputError
        The distance is not positive.
    """
    _require_distance(max_distance_m)
    frames, n_objects, n_tracks = _by_frame(truth, estimate)
    n, n_estimates = len(truth.frames), len(estimate.frames)
    matches = _clear_matches(frames, n_objects, max_distance_m)
    distances, n_switches = matches.distances_m, matches.n_switches
    n_matches = len(distances)
    n_misses, n_false = n - n_matches, n_estimates - n_matches
    hota, det_a, ass_a = _hota(frames, n_objects, n_tracks, max_distance_m) if n else (math.nan,) * 3
    return TrackScores(
        mota=1.0 - ratio(n_misses + n_false + n_switches, n),
        idf1=ratio(2 * _id_matches(frames, n_objects, n_tracks, max_distance_m), n + n_estimates)
        if n
        else math.nan,
        hota=hota,
        det_a=det_a,
        ass_a=ass_a,
        position_rmse_m=float(np.sqrt(np.mean(distances**2))) if n_matches else math.nan,
        n=n,
        n_estimates=n_estimates,
        n_matches=n_matches,
        n_misses=n_misses,
        n_false=n_false,
        n_switches=n_switches,
    )


def match_tracks(truth: TrackPoints, estimate: TrackPoints, *, max_distance_m: float = 0.5) -> TrackMatches:
    """Match tracks to the true positions as MOTA does; parameters as of `evaluate_tracks`.

    Raises
    ------
    InputError
        The distance is not positive.
    """
    _require_distance(max_distance_m)
    frames, n_objects, _ = _by_frame(truth, estimate)
    return _clear_matches(frames, n_objects, max_distance_m)


def _require_distance(max_distance_m: float) -> None:
    if not max_distance_m > 0.0:
        raise InputError(f"the largest distance of a match must be positive, not {max_distance_m}")


def _by_frame(truth: TrackPoints, estimate: TrackPoints) -> tuple[list[_Frame], int, int]:
    objects, dense_truth = np.unique(truth.ids, return_inverse=True)
    tracks, dense_tracks = np.unique(estimate.ids, return_inverse=True)
    numbers = np.union1d(truth.frames, estimate.frames)
    frames = []
    for i, j in zip(_rows_of(truth.frames, numbers), _rows_of(estimate.frames, numbers), strict=True):
        distances = cdist(truth.positions[i], estimate.positions[j])
        frames.append(
            _Frame(
                truth=dense_truth[i],
                tracks=dense_tracks[j],
                truth_rows=i,
                track_rows=j,
                distances=distances,
            )
        )
    return frames, len(objects), len(tracks)


def _rows_of(frames: IntArray, numbers: IntArray) -> list[IntArray]:
    """The rows of each frame, in their order."""
    order = np.argsort(frames, kind="stable")
    return np.split(order, np.searchsorted(frames[order], numbers[1:])) if len(numbers) else []


def _clear_matches(frames: list[_Frame], n_objects: int, max_distance_m: float) -> TrackMatches:
    last_track = np.full(n_objects, -1, dtype=np.int64)
    track_in_last_frame = last_track.copy()
    matched: list[tuple[int, int, float]] = []
    n_switches = 0
    for frame in frames:
        is_kept = track_in_last_frame[frame.truth][:, None] == frame.tracks[None, :]
        score = _similarity(frame, max_distance_m) + _KEPT_BONUS * is_kept
        score[frame.distances > max_distance_m] = 0.0
        track_in_last_frame[:] = -1
        for row, col in zip(*linear_sum_assignment(score, maximize=True), strict=True):
            if score[row, col] <= 0.0:
                continue
            one, track = frame.truth[row], frame.tracks[col]
            n_switches += int(last_track[one] >= 0 and last_track[one] != track)
            last_track[one] = track_in_last_frame[one] = track
            matched.append((frame.truth_rows[row], frame.track_rows[col], frame.distances[row, col]))
    rows = np.array(matched, dtype=np.float64).reshape(-1, 3)
    return TrackMatches(
        truth_rows=rows[:, 0].astype(np.int64),
        estimate_rows=rows[:, 1].astype(np.int64),
        distances_m=rows[:, 2],
        n_switches=n_switches,
    )


def _similarity(frame: _Frame, max_distance_m: float) -> FloatArray:
    return np.maximum(0.0, 1.0 - frame.distances / (2.0 * max_distance_m))


def _id_matches(frames: list[_Frame], n_objects: int, n_tracks: int, max_distance_m: float) -> int:
    """Frames explained by the best one-to-one pairing of objects and tracks."""
    together = np.zeros((n_objects, n_tracks))
    for frame in frames:
        together[np.ix_(frame.truth, frame.tracks)] += frame.distances <= max_distance_m
    rows, cols = linear_sum_assignment(together, maximize=True)
    return int(together[rows, cols].sum())


def _hota(
    frames: list[_Frame], n_objects: int, n_tracks: int, max_distance_m: float
) -> tuple[float, float, float]:
    """HOTA, detection and association accuracy, averaged over the levels."""
    object_frames, track_frames = np.zeros(n_objects), np.zeros(n_tracks)
    potential = np.zeros((n_objects, n_tracks))
    similarities = []
    for frame in frames:
        similarity = _similarity(frame, max_distance_m)
        both = similarity.sum(axis=0)[None, :] + similarity.sum(axis=1)[:, None] - similarity
        share = np.divide(similarity, both, out=np.zeros_like(similarity), where=both > 1e-12)
        potential[np.ix_(frame.truth, frame.tracks)] += share
        object_frames[frame.truth] += 1
        track_frames[frame.tracks] += 1
        similarities.append(similarity)
    alignment = potential / np.maximum(1.0, object_frames[:, None] + track_frames[None, :] - potential)
    matches = np.zeros((len(_HOTA_LEVELS), n_objects, n_tracks))
    for frame, similarity in zip(frames, similarities, strict=True):
        score = alignment[np.ix_(frame.truth, frame.tracks)] * similarity
        rows, cols = linear_sum_assignment(score, maximize=True)
        is_match = similarity[rows, cols][None, :] >= _HOTA_LEVELS[:, None] - 1e-12
        matches[:, frame.truth[rows], frame.tracks[cols]] += is_match
    n_matches = matches.sum(axis=(1, 2))
    n_all = object_frames.sum() + track_frames.sum() - n_matches
    union = np.maximum(1.0, object_frames[:, None] + track_frames[None, :] - matches)
    det_a = n_matches / np.maximum(1.0, n_all)
    ass_a = np.sum(matches * (matches / union), axis=(1, 2)) / np.maximum(1.0, n_matches)
    return float(np.sqrt(det_a * ass_a).mean()), float(det_a.mean()), float(ass_a.mean())
