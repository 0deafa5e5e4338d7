"""Two drives that share a stretch of the ring, each a run of its own, in frames of their own."""

from functools import cache

import numpy as np

from slammot_graph import Run, SavedMap
from slammot_graph.core import se2
from slammot_graph.core.results import RunResult
from slammot_graph.core.types import FloatArray
from slammot_graph.saved_maps import MergedMaps, merge_maps
from tests.localization.saved_maps import Later
from tests.loop_closure.ring import ring_log

FIRSTS = (0, 120)
"""Scans at which the drives begin."""

N_SCANS = 260


@cache
def half(k: int) -> RunResult:
    return Run(Later(ring_log(k + 1), FIRSTS[k]), max_scans=N_SCANS).complete()


@cache
def half_map(k: int) -> SavedMap:
    saved = half(k).saved_map
    assert saved is not None
    return SavedMap.from_bytes(saved.to_bytes())


@cache
def merged() -> MergedMaps:
    return merge_maps([half_map(0), half_map(1)])


def true_poses(k: int) -> FloatArray:
    """(n, 3) true poses of a drive in the frame of the first one's map."""
    rows = slice(FIRSTS[k], FIRSTS[k] + N_SCANS)
    return se2.between(ring_log(1).T_world_base[FIRSTS[0]], ring_log(k + 1).T_world_base[rows])


def errors_m(T: FloatArray, truth: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(*(T - truth)[:, :2].T))
