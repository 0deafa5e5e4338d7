"""Kernel that tells apart what lies on free cells and is too wide for a person: it may ride along with the robot."""

import numpy as np

from slammot_graph.core._numba import kernel
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection._cluster_kernels import cluster_beams, cluster_boxes
from slammot_graph.detection.reasons import ALONG, DISCARDED, FREE, TOO_WIDE, TRACKED, VACATED


@kernel
def mark_wide(
    points: FloatArray,
    is_valid: BoolArray,
    mapped_share: float,
    max_gap: float,
    max_skipped_beams: int,
    max_x_range: float,
    max_y_range: float,
    reason: IntArray,
) -> None:
    """Change the `reason` (n,) of beams from DISCARDED to TOO_WIDE where, with what moves beside, they are too wide.

    Only where those and what moves are more than `mapped_share` of the valid beams.
    """
    n = points.shape[0]
    is_member = np.empty(n, dtype=np.bool_)
    n_valid = n_members = n_discarded = 0
    for k in range(n):
        is_member[k] = reason[k] in (DISCARDED, FREE, VACATED, TRACKED, ALONG)
        n_valid += is_valid[k]
        n_members += is_member[k]
        n_discarded += reason[k] == DISCARDED
    if n_discarded == 0 or n_members <= mapped_share * n_valid:
        return
    labels = np.empty(n, dtype=np.int64)
    n_clusters = cluster_beams(points, is_member, max_gap, max_skipped_beams, labels)
    box = np.empty((n_clusters, 4))
    cluster_boxes(points, labels, box)
    for k in range(n):
        c = labels[k]
        is_wide = c >= 0 and (box[c, 1] - box[c, 0] > max_x_range or box[c, 3] - box[c, 2] > max_y_range)
        if is_wide and reason[k] == DISCARDED:
            reason[k] = TOO_WIDE
