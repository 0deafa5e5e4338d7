"""How probable it is that a beam hit something that moves: a logistic model of what speaks for its cluster.

The test decides by yes or no; how far to trust it depends on what it saw. A person's worth of points on cells that
were seen free many times is nearly certain, three points far away on cells that two beams crossed are not: legs
of chairs look like that. Beams that were not called moving have the share of moving ones among their like.
"""

import numpy as np

from slammot_graph.core.types import FloatArray
from slammot_graph.detection import _cluster_kernels, reasons
from slammot_graph.detection.base import Detection
from slammot_graph.mapping.occupancy_grid import OccupancyGrid

MAX_RANGE_M = 12.0
"""Clusters farther away count as this far."""

NAMES = (
    "constant",
    "log of points",
    "range [m]",
    "share not on free cells",
    "no point on free cells",
    "how much less than surely free [log odds]",
    "log of 1 + width [m]",
    "where a track is expected",
)

WEIGHTS = np.array([5.25, -0.28, -0.29, -1.11, -0.07, -1.80, -1.03, 1.08])
"""Weights of `NAMES`, by ``python -m experiments.fit_p_moving``."""

SHARE_OF_STATIC = {
    reasons.OCCUPIED: 0.001,
    reasons.UNKNOWN: 0.03,
    reasons.TOO_UNCERTAIN: 0.02,
    reasons.DISCARDED: 0.3,
    reasons.ABSTAINED: 0.4,
    reasons.NOT_TESTED: 0.0,
    reasons.FURNITURE: 0.2,
    reasons.TOO_WIDE: 0.3,
    reasons.COME_UP: 0.3,
    reasons.UNSUPPORTED: 0.4,
}
"""Share of moving beams among those that were called static, by reason; by the same command (less for
DISCARDED, which crowds dominate there; TOO_WIDE and COME_UP as that, UNSUPPORTED as ABSTAINED)."""


def cluster_evidence(
    detection: Detection, points: FloatArray, ranges: FloatArray, grid: OccupancyGrid, expected: FloatArray
) -> FloatArray:
    """What speaks for each cluster: the values that `NAMES` names.

    Parameters
    ----------
    detection : Detection
        of n beams.
    points : (n, 2) array [m]
        End points in the grid's frame.
    ranges : (n,) array [m]
    grid : OccupancyGrid
        As the test saw it.
    expected : (k, 2) array [m]
        Where tracked objects were expected.

    Returns
    -------
    (n_clusters, 8) array
    """
    evidence = np.empty((detection.n_clusters, len(NAMES)))
    _cluster_kernels.cluster_evidence(
        grid.log_odds,
        grid.stamp,
        grid.row0,
        grid.col0,
        grid.inv_resolution,
        grid.oldest,
        grid.l_min,
        points,
        ranges,
        detection.cluster,
        detection.reason,
        expected,
        MAX_RANGE_M,
        evidence,
    )
    return evidence


def probability_of_moving(
    detection: Detection, points: FloatArray, ranges: FloatArray, grid: OccupancyGrid, expected: FloatArray
) -> FloatArray:
    """(n,) probability that each beam hit something that moves; NaN without a valid return.

    Parameters as of `cluster_evidence`.
    """
    p = probability_without_clusters(detection)
    if detection.n_clusters:
        evidence = cluster_evidence(detection, points, ranges, grid, expected)
        _cluster_kernels.logistic_of_clusters(evidence, WEIGHTS, detection.cluster, p)
    return p


def probability_without_clusters(detection: Detection) -> FloatArray:
    """(n,) share of moving beams among those that were called static for the same reason; NaN without a return."""
    return _P_STATIC[detection.reason]


_P_STATIC: FloatArray = np.full(len(reasons.REASONS), np.nan)
for _reason, _share in SHARE_OF_STATIC.items():
    _P_STATIC[_reason] = _share
_P_STATIC.setflags(write=False)
