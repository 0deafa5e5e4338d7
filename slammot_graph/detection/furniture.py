"""Furniture among the final labels: what is called moving where static points lay at other times of the run."""

import math
from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np

from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection.clustering import ClusterConfig, find_clusters
from slammot_graph.detection.hit_memory import HitMemoryConfig
from slammot_graph.detection.scan_history import ScanRecord


def without_furniture(
    labels: Sequence[BoolArray],
    history: Sequence[ScanRecord],
    T_map_base: FloatArray,
    *,
    config: HitMemoryConfig,
    clusters: ClusterConfig,
    resolution_m: float,
) -> list[BoolArray]:
    """Take back the labels of clusters most of whose points lie where static points lay at other times.

    Parameters
    ----------
    labels : n bool arrays
        Final labels so far.
    history, T_map_base
        As of `backward_pass.retrospective_labels`.
    config : HitMemoryConfig
    clusters : ClusterConfig
    resolution_m : float
        Side of the cells.

    Returns
    -------
    n bool arrays
    """
    n = len(labels)
    moving: dict[int, tuple[FloatArray, IntArray, BoolArray]] = {}
    is_crowd = np.zeros(n, dtype=np.bool_)
    for k in range(n):
        n_moving = np.count_nonzero(labels[k])
        if not n_moving:
            continue
        item = history[k]
        is_crowd[k] = n_moving > config.crowd_share * np.count_nonzero(item.is_valid)
        if not is_crowd[k]:
            points = item.scan.points(T_map_base[k])
            moving[k] = points, _cell_codes(points[labels[k]], resolution_m), item.is_displaced[labels[k]]
    known = np.unique(np.concatenate([_NO_CELLS, *(codes for _, codes, _ in moving.values())]))
    if not len(known):
        return list(labels)
    stamps = np.empty(n)
    hits = list[IntArray]()
    passed_by = dict[int, IntArray]()
    latest_s = dict[int, float]()
    for k in range(n):
        item = history[k]
        scan = item.scan
        stamps[k] = scan.stamp
        is_same = abs(scan.stamp - latest_s.get(scan.laser.number, -math.inf)) < config.spacing_s
        if is_same or is_crowd[k]:
            hits.append(_NO_CELLS)
            continue
        latest_s[scan.laser.number] = scan.stamp
        static = scan.points(T_map_base[k])[item.is_valid & ~labels[k]]
        hits.append(_numbers(np.unique(_cell_codes(static, resolution_m)), known))
        if k in moving:
            passed_by[k] = np.searchsorted(known, np.unique(moving[k][1]))
    asked = {k: np.searchsorted(known, codes) for k, (_, codes, _) in moving.items()}
    before = _hits_apart(range(n), stamps, hits, passed_by, asked, len(known), config.apart_s)
    after = _hits_apart(range(n - 1, -1, -1), stamps, hits, passed_by, asked, len(known), config.apart_s)
    kept = list(labels)
    for k, (points, _, is_displaced) in moving.items():
        was_hit = np.zeros(len(points), dtype=np.bool_)
        least = np.where(is_displaced, config.min_hits_displaced, config.min_hits)
        was_hit[labels[k]] = before[k] + after[k] >= least
        if not was_hit.any():
            continue
        cluster, n_clusters = find_clusters(points, labels[k], clusters)
        member = cluster >= 0
        size = np.bincount(cluster[member], minlength=n_clusters)
        n_hit = np.bincount(cluster[member & was_hit], minlength=n_clusters)
        is_furniture = np.append(n_hit >= config.min_share * size, False)  # -1: of no cluster
        kept[k] = labels[k] & ~is_furniture[cluster]
    return kept


_NO_CELLS: IntArray = np.empty(0, dtype=np.int64)
_MOST_COLUMNS = 1 << 31


def _cell_codes(points: FloatArray, resolution_m: float) -> IntArray:
    """One number (n,) for the cell of each point (n, 2)."""
    cells = np.floor(points / resolution_m).astype(np.int64)
    return np.asarray(cells[:, 1] * _MOST_COLUMNS + cells[:, 0])


def _numbers(codes: IntArray, known: IntArray) -> IntArray:
    """Places in the sorted `known` of those codes that are among them."""
    place = np.minimum(np.searchsorted(known, codes), len(known) - 1)
    return np.asarray(place[known[place] == codes])


def _hits_apart(
    order: Iterable[int],
    stamps: FloatArray,
    hits: Sequence[IntArray],
    passed_by: dict[int, IntArray],
    asked: dict[int, IntArray],
    n_cells: int,
    apart_s: float,
) -> dict[int, IntArray]:
    """For each scan that asks, how often its cells were hit by scans earlier in the order, at least `apart_s` away."""
    counts = np.zeros(n_cells, dtype=np.int64)
    waiting = deque[int]()
    found = {}
    for k in order:
        while waiting and abs(stamps[waiting[0]] - stamps[k]) >= apart_s:
            j = waiting.popleft()
            counts[hits[j]] += 1
            if j in passed_by:
                counts[passed_by[j]] -= 1
        if k in asked:
            found[k] = counts[asked[k]]
        waiting.append(k)
    return found
