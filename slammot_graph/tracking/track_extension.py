"""What the other scans of a run say of a track: where it goes on before its first label and after its last.

An object stands or walks where the laser sees through once it has gone, or before it came. That tells whether small
things in a track's way, which the moving-point test could not know to move, were the object itself: at its first
scans, before anything was seen free, or where it parked.
"""

from collections.abc import Callable

import numpy as np

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.tracking import _kernels as _track_kernels
from slammot_graph.tracking import _segment_kernels as _segments
from slammot_graph.tracking import _sight_kernels as _sight
from slammot_graph.tracking import _table_kernels as _table
from slammot_graph.tracking._follow_kernels import PUSH
from slammot_graph.tracking.base import ScanView
from slammot_graph.tracking.boxes import laid_in_box
from slammot_graph.tracking.chain import Chain, SmoothingConfig

Views = Callable[[int], ScanView]
"""The scan of a number at its optimised pose, its labelled beams as clusters, map frame."""

_BODY_M = 0.2
"""Half the width of what must be seen through at a place."""

_AWAY_M = 0.8
"""An object this far from a place does not occlude it."""

_LOOKS = 24
"""Scans that are asked about a place."""

_STRIDE = 4
"""Of the scans of an absence every fourth is asked."""

_MIN_LOOKS = 3
"""Fewer decide nothing."""

_MOST_SCANS = 1000
"""Scans from a track's end on among which those are."""

_SAME_M = 0.05
"""Places nearer than this to one that was asked about are not asked about again."""


class TrackExtension:
    """Asks the scans of a run about places [m], map frame.

    Parameters
    ----------
    views : Views
    stamps : (n,) array [s]
        Of the scans.
    limits : (27,) array
        Of the tracker.
    """

    def __init__(self, views: Views, stamps: FloatArray, limits: FloatArray) -> None:
        self._view = views
        self._stamps = stamps
        self._limits = limits

    def looks(self, place: FloatArray, scans: IntArray) -> tuple[int, int]:
        """How many of some scans see through a place (2,), and how many hit something there."""
        state = np.array([[place[0], place[1], 0.0, 0.0]])
        sight = np.empty(1, dtype=np.int64)
        n_empty = n_present = 0
        for k in scans.tolist():
            view = self._view(k)
            _sight.sight_at(
                state, view.T_local_laser, view.angle_min, view.angle_increment, view.ranges, view.is_valid,
                view.no_return_m, _BODY_M, sight,
            )  # fmt: skip
            n_empty += int(sight[0] == _sight.EMPTY)
            if sight[0] == _sight.PRESENT:
                offset = view.points[view.is_valid] - place
                n_present += int(np.square(offset).sum(axis=1).min() < _BODY_M**2)
        return n_empty, n_present

    def absences(self, chains: list[Chain], place: FloatArray, scans: IntArray) -> IntArray:
        """Of some scans, nearest first, `_LOOKS` at most at which none of the chains is near a place (2,)."""
        n = len(self._stamps)
        is_taken = np.zeros(n, dtype=np.bool_)
        first, last = int(scans.min()), int(scans.max())
        for chain in chains:
            if chain.scans[0] > last or chain.scans[-1] < first:
                continue
            is_close = np.hypot(*(chain.places - place).T) < _AWAY_M
            if not is_close.any():
                continue
            every = np.arange(int(chain.scans[0]), int(chain.scans[-1]) + 1)
            # between two sightings there it is there as well
            is_taken[every] |= np.interp(every, chain.scans, is_close.astype(np.float64)) > 0.0
        free = scans[~is_taken[scans]]
        return free[: _STRIDE * _LOOKS : _STRIDE]

    def extended(self, chain: Chain, chains: list[Chain], config: SmoothingConfig) -> Chain:
        """Follow a chain beyond both its ends through what is not labelled, as long as that is gone at other times."""
        every = [chain]
        for step in (-1, 1):
            found = self._followed(chain, chains, step, config)
            if found is not None:
                every.insert(0 if step < 0 else len(every), found)
        if len(every) == 1:
            return chain
        return Chain(
            **{name: np.concatenate([getattr(part, name) for part in every]) for name in vars(chain)}
        )

    def boxed(self, chain: Chain, config: SmoothingConfig) -> Chain:
        """The chain of a vehicle with the centres of its box for places."""
        reach = 0.75 * float(np.quantile(chain.sizes, 0.9)) + 0.1
        views = []
        for k, place in zip(chain.scans.tolist(), chain.places, strict=True):
            view = self._view(k)
            is_near = view.is_valid & (np.hypot(*(view.points - place).T) <= reach)
            is_labelled = is_near & (view.cluster >= 0)
            views.append((view.points[is_labelled if is_labelled.any() else is_near], view))
        return laid_in_box(chain, views, self._stamps, config)[0]

    def _followed(
        self, chain: Chain, chains: list[Chain], step: int, config: SmoothingConfig
    ) -> Chain | None:
        """Sightings before (-1) or after (1) a chain, in the order of the scans."""
        end = 0 if step < 0 else -1
        part = slice(0, 30) if step < 0 else slice(-30, None)
        states, covs = chain.part(part).smoothed(chain.scans[part], self._stamps, config)
        state, cov = states[[end]].copy(), covs[[end]].copy()
        state[:, 2:] *= step  # time runs backward
        cov[:, :2, 2:] *= step
        cov[:, 2:, :2] *= step
        reach = max(self._limits[_table.STANDING_REACH], 0.75 * float(np.quantile(chain.sizes, 0.9)) + 0.1)
        scans, places, noises, sizes = [], [], [], []
        k, missed_s, vacated = int(chain.scans[end]), 0.0, np.full(2, np.inf)
        while 0 <= k + step < len(self._stamps) and missed_s <= config.max_gap_s:
            dt = max(step * (self._stamps[k + step] - self._stamps[k]), 0.0)
            k += step
            missed_s += dt
            _track_kernels.predict(state, cov, dt, config.acceleration_std_m_s2)
            if _is_near(chains, chain, k, state[0, :2]):
                continue
            seen = self._seen_at(k, state, cov, reach)
            if seen is None:
                continue
            place, noise, size = seen
            if np.hypot(*(place - vacated)) > _SAME_M:
                if not self._is_vacated(place, chain, chains, step):
                    break
                vacated = place
            _track_kernels.correct(state, cov, place[None], noise[None], np.zeros(1, dtype=np.int64))
            missed_s = 0.0
            scans.append(k)
            places.append(place)
            noises.append(noise)
            sizes.append(size)
        if not scans:
            return None
        order = slice(None, None, step)
        return Chain(
            scans=np.array(scans)[order],
            places=np.array(places)[order],
            covs=np.array(noises)[order],
            sizes=np.array(sizes)[order],
            thickness=np.full(len(scans), np.nan),
        )

    def _seen_at(
        self, k: int, state: FloatArray, cov: FloatArray, reach: float
    ) -> tuple[FloatArray, FloatArray, float] | None:
        """Place (2,), covariance (2, 2) and size of a small thing that stands by itself where one is expected."""
        view, limits = self._view(k), self._limits
        n = len(view.ranges)
        cluster = np.empty(n, dtype=np.int64)
        is_any = _sight.find_standing(
            view.points,
            view.is_valid,
            np.full(n, -1),
            state[:, :2],
            reach,
            limits[_table.STANDING_GAP],
            cluster,
        )
        if not is_any:
            return None
        segment, table = np.empty(n, dtype=np.int64), np.empty((n, 8))
        is_proven: BoolArray = cluster >= 0
        m = _segments.find_segments(
            view.points, view.packed_cov, cluster, is_proven, view.T_local_laser[0], view.T_local_laser[1],
            view.angle_increment, limits[_table.SEGMENT_GAP], PUSH, limits[_table.LEG_WIDTH], segment, table,
        )  # fmt: skip
        table = table[:m]
        place, noise = np.empty((1, 2)), np.empty((1, 2, 2))
        n_joined, size = np.empty(1, dtype=np.int64), np.empty(1)
        _segments.measure(
            table, np.zeros(m, dtype=np.int64), limits[_table.LEG_WIDTH], limits[_table.LEG_VARIANCE],
            limits[_table.BODY_VARIANCE], place, noise, n_joined, size,
            np.empty(1, dtype=np.int64),
        )  # fmt: skip
        offset = place[0] - state[0, :2]
        distance2 = float(offset @ np.linalg.solve(cov[0, :2, :2] + noise[0], offset))
        return (place[0], noise[0], float(size[0])) if distance2 <= limits[_table.GATE] else None

    def _is_vacated(self, place: FloatArray, chain: Chain, chains: list[Chain], step: int) -> bool:
        """Whether the laser sees through a place before (1) a chain's end, or after (-1) its start, with none near.

        On the other side of the end the object itself may be there.
        """
        n = len(self._stamps)
        end = int(chain.scans[0 if step < 0 else -1])
        scans = np.arange(end, n)[:_MOST_SCANS] if step < 0 else np.arange(end, -1, -1)[:_MOST_SCANS]
        n_empty, n_present = self.looks(place, self.absences(chains, place, scans))
        return n_empty >= _MIN_LOOKS and n_empty > 4 * n_present


def _is_near(chains: list[Chain], own: Chain, k: int, place: FloatArray) -> bool:
    """Whether another chain is near a place (2,) at a scan."""
    for chain in chains:
        if chain is own:
            continue
        at = int(np.searchsorted(chain.scans, k).clip(0, len(chain.scans) - 1))
        for m in (at, max(at - 1, 0)):
            if abs(int(chain.scans[m]) - k) <= 3 and np.hypot(*(chain.places[m] - place)) < 0.5:
                return True
    return False
