"""Tracks after the run: tracklets linked across absences, smoothed, and moved with the optimised poses.

Each sighting of the time is kept relative to the robot, so that loop closures move it with the robot's pose.
Tracklets are linked by an assignment of least cost: the end of one, predicted forward, and the begin of another must
agree in place and velocity. A chain is smoothed with a constant velocity that accelerations change (Rauch, Tung and
Striebel 1965), and once more with sightings that it contradicts weighed down.
"""

import math
from array import array
from dataclasses import dataclass

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.tracked_object import ObjectKind, TrackedObject
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking import _kernels as _track_kernels
from slammot_graph.tracking.base import Sightings
from slammot_graph.tracking.chain import Chain, SmoothingConfig
from slammot_graph.tracking.track_extension import TrackExtension

PERSON_SIZE_M = 0.9
"""What is larger than this most of the time is no person."""

EDGE_M, MAX_BEND = 0.25, 0.04
"""What is at least this long and whose points lie off a line by no more than this share of its length is an edge: a
side of a vehicle or a cart. Legs and trunks are round."""

MIN_SIGHTINGS_OF_KIND = 10
"""With fewer sightings the kind is unknown."""


class SightingHistory:
    """All sightings of a run, relative to the robot: 9 numbers each."""

    def __init__(self) -> None:
        self._rows = array("d")

    def add(self, scan: int, sightings: Sightings, T_local_base: FloatArray) -> None:
        """Take in the sightings at the scan of this number, at which the base lay at (3,) in the local frame."""
        if not len(sightings.ids):
            return
        T_base_local = se2.inverse(T_local_base)
        rows = np.empty((len(sightings.ids), 9))
        R = se2.rotation(T_base_local[2])
        rows[:, 0], rows[:, 1], rows[:, 7] = scan, sightings.ids, sightings.sizes_m
        rows[:, 8] = sightings.thickness_m
        rows[:, 2:4] = sightings.places @ R.T + T_base_local[:2]
        rows[:, 4:7] = (R @ sightings.covs @ R.T).reshape(-1, 4)[:, [0, 1, 3]]
        self._rows.frombytes(rows.tobytes())

    def table(self) -> FloatArray:
        """(m, 9) scan number, track, x, y [m], xx, xy, yy [m^2] in the base frame, size and thickness [m]."""
        return np.array(self._rows, dtype=np.float64).reshape(-1, 9)


@dataclass(frozen=True, kw_only=True, eq=False)
class SmoothedTracks:
    """The tracks of a run, m rows by identity and scan.

    Attributes
    ----------
    scans, ids : (m,) int arrays
        Number of the scan, identity.
    states : (m, 4) array
        x, y, vx, vy [m, m/s], map frame.
    covs : (m, 2, 2) array [m^2]
        Of the positions.
    is_seen : (m,) bool array
    objects : tuple of TrackedObject
    """

    scans: IntArray
    ids: IntArray
    states: FloatArray
    covs: FloatArray
    is_seen: BoolArray
    objects: tuple[TrackedObject, ...]


def smooth_tracks(
    sightings: FloatArray,
    stamps: FloatArray,
    T_map_base: FloatArray,
    config: SmoothingConfig,
    extension: TrackExtension | None = None,
) -> SmoothedTracks:
    """Link and smooth the tracks of a run.

    Parameters
    ----------
    sightings : (m, 9) array
        As of `SightingHistory.table`.
    stamps : (n,) array [s]
        Of the scans.
    T_map_base : (n, 3) array
        Their optimised poses.
    config : SmoothingConfig
    extension : TrackExtension, optional
        The scans themselves: objects are followed beyond their labels.
    """
    tracklets = _tracklets(sightings, T_map_base)
    chains = _linked([one for one in tracklets if len(one.scans) >= 3], stamps, config)
    kept = [chain for chain in chains if chain.is_object(config)]
    kept.sort(key=lambda chain: int(chain.scans[0]))
    kept = _without_twins(kept, config.twin_m)
    if extension is not None:
        kept = [extension.extended(chain, kept, config) for chain in kept]
        kept = [
            extension.boxed(chain, config) if _object(0, chain).kind == "vehicle" else chain for chain in kept
        ]
        kept.sort(key=lambda chain: int(chain.scans[0]))
    scans, ids, states, covs, is_seen = [], [], [], [], []
    for number, chain in enumerate(kept):
        every = np.arange(chain.scans[0], chain.scans[-1] + 1)
        state, cov = chain.smoothed(every, stamps, config)
        seen = np.isin(every, chain.scans)
        variance = np.linalg.eigvalsh(cov[:, :2, :2])[:, 1]
        is_known = seen | (variance <= config.max_gap_std_m**2)
        scans.append(every[is_known])
        ids.append(np.full(len(scans[-1]), number))
        states.append(state[is_known])
        covs.append(cov[is_known, :2, :2])
        is_seen.append(seen[is_known])
    return SmoothedTracks(
        scans=np.concatenate([np.empty(0, dtype=np.int64), *scans]),
        ids=np.concatenate([np.empty(0, dtype=np.int64), *ids]),
        states=np.concatenate([np.empty((0, 4)), *states]),
        covs=np.concatenate([np.empty((0, 2, 2)), *covs]),
        is_seen=np.concatenate([np.empty(0, dtype=np.bool_), *is_seen]),
        objects=tuple(_object(number, chain) for number, chain in enumerate(kept)),
    )


def _without_twins(chains: list[Chain], twin_m: float) -> list[Chain]:
    """Leave out chains that mostly lie on a longer one: the other leg of the same person."""
    kept: list[Chain] = []
    for chain in sorted(chains, key=lambda one: -len(one.scans)):
        is_covered = np.zeros(len(chain.scans), dtype=np.bool_)
        for other in kept:
            at = np.searchsorted(other.scans, chain.scans).clip(0, len(other.scans) - 1)
            offset = other.places[at] - chain.places
            is_near = np.hypot(offset[:, 0], offset[:, 1]) < twin_m
            is_covered |= is_near & (np.abs(other.scans[at] - chain.scans) <= 3)
        if 2 * np.count_nonzero(is_covered) <= len(chain.scans):
            kept.append(chain)
    return sorted(kept, key=lambda one: int(one.scans[0]))


def _tracklets(sightings: FloatArray, T_map_base: FloatArray) -> list[Chain]:
    """The tracks of the time, in the map."""
    rows = sightings[sightings[:, 0] < len(T_map_base)]
    scans = rows[:, 0].astype(np.int64)
    T = T_map_base[scans]
    R = se2.rotation(T[:, 2])
    places = np.einsum("mij,mj->mi", R, rows[:, 2:4]) + T[:, :2]
    covs = R @ rows[:, [4, 5, 5, 6]].reshape(-1, 2, 2) @ R.transpose(0, 2, 1)
    order = np.argsort(rows[:, 1], kind="stable")
    starts = np.flatnonzero(np.diff(rows[order, 1], prepend=-1.0))
    return [
        Chain(
            scans=scans[own], places=places[own], covs=covs[own], sizes=rows[own, 7], thickness=rows[own, 8]
        )
        for own in np.split(order, starts[1:])
        if len(own)
    ]


def _linked(tracklets: list[Chain], stamps: FloatArray, config: SmoothingConfig) -> list[Chain]:
    """Join tracklets into chains: each has one successor at most, of least total cost."""
    from scipy.optimize import linear_sum_assignment

    n = len(tracklets)
    if n < 2:
        return tracklets
    ends = [one.smoothed(one.scans, stamps, config) for one in tracklets]
    cost = np.full((n, n), _track_kernels.OUTSIDE)
    starts_s = np.array([stamps[one.scans[0]] for one in tracklets])
    for i, one in enumerate(tracklets):
        end_s = stamps[one.scans[-1]]
        for j in np.flatnonzero((starts_s > end_s) & (starts_s <= end_s + config.max_absence_s)).tolist():
            cost[i, j] = _link_cost(ends[i], ends[j], starts_s[j] - end_s, config)
    following = np.full(n, -1)
    for i, j in np.column_stack(linear_sum_assignment(cost)).tolist():
        if cost[i, j] < _track_kernels.OUTSIDE:
            following[i] = j
    chains = []
    for first in np.flatnonzero(~np.isin(np.arange(n), following)).tolist():
        members = [first]
        while following[members[-1]] >= 0:
            members.append(int(following[members[-1]]))
        parts = [tracklets[k] for k in members]
        chains.append(
            Chain(
                **{name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])}
            )
        )
    return chains


def _link_cost(
    end: tuple[FloatArray, FloatArray],
    start: tuple[FloatArray, FloatArray],
    dt: float,
    config: SmoothingConfig,
) -> float:
    """``d2 + ln det S`` of the begin of a tracklet against the end of another, `dt` [s] before."""
    state, cov = end[0][-1:].copy(), end[1][-1:].copy()
    _track_kernels.predict(state, cov, dt, config.acceleration_std_m_s2)
    S = cov[0] + start[1][0]
    offset = start[0][0] - state[0]
    distance2 = float(offset @ np.linalg.solve(S, offset))
    return distance2 + float(np.linalg.slogdet(S)[1]) if distance2 <= config.gate else _track_kernels.OUTSIDE


def _object(number: int, chain: Chain) -> TrackedObject:
    """Say what it is by size and shape at most of the sightings that show one; the probability is their share."""
    is_large = chain.sizes > PERSON_SIZE_M
    is_edge = (chain.sizes >= EDGE_M) & (chain.thickness <= MAX_BEND * chain.sizes)
    has_shape = is_large | (np.isfinite(chain.thickness) & (chain.sizes >= EDGE_M))
    n, n_vehicle = int(np.count_nonzero(has_shape)), int(np.count_nonzero(is_large | is_edge))
    if n < MIN_SIGHTINGS_OF_KIND:  # too few points for a shape
        n, n_vehicle = len(chain.sizes), int(np.count_nonzero(is_large))
    p_person = (n - n_vehicle + 1.0) / (n + 2.0)
    kind: ObjectKind = "person" if p_person >= 0.5 else "vehicle"
    if n < MIN_SIGHTINGS_OF_KIND:
        kind = "unknown"
    return TrackedObject(
        track_id=number,
        kind=kind,
        probability=math.nan if kind == "unknown" else max(p_person, 1.0 - p_person),
        size_m=float(np.quantile(chain.sizes, 0.9)),
    )
