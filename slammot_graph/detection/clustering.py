"""Subsets of moving points by distance; too few points, or too wide for a person: discarded."""

from dataclasses import dataclass, field

import numpy as np

from slammot_graph.core.checks import Checked, Count, CountOrZero, Positive
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _cluster_kernels


@dataclass(frozen=True, kw_only=True)
class SplitConfig(Checked):
    """How a subset that is too wide is split: people who walk side by side.

    Attributes
    ----------
    gap_m : float
        At gaps of this size.
    min_points : int
        Parts with fewer points are discarded: legs of chairs are no people.
    """

    gap_m: Positive = 0.15
    min_points: Count = 8


@dataclass(frozen=True, kw_only=True)
class ClusterConfig(Checked):
    """How moving points are grouped and which groups are kept.

    Attributes
    ----------
    max_gap_m : float
        Points nearer than this belong together.
    max_skipped_beams : int
        Beams in between that may belong to something else.
    min_points : int
        MINNUMBER: smaller subsets are discarded.
    max_x_range_m, max_y_range_m : float
        MAX X RANGE, MAX Y RANGE: wider subsets are discarded, unless they can be split.
    split : SplitConfig or None
        None: wide subsets are not split.
    """

    max_gap_m: Positive = 0.6
    max_skipped_beams: CountOrZero = 10
    min_points: Count = 2
    max_x_range_m: Positive = 1.5
    max_y_range_m: Positive = 1.5
    split: SplitConfig | None = field(default_factory=SplitConfig)

    def kernel_arguments(self) -> tuple[float, int, int, float, float, float, int]:
        """Give what the kernels take, in their order: without a split its gap is 0."""
        return (
            self.max_gap_m,
            self.max_skipped_beams,
            self.min_points,
            self.max_x_range_m,
            self.max_y_range_m,
            0.0 if self.split is None else self.split.gap_m,
            1 if self.split is None else self.split.min_points,
        )


def find_clusters(points: FloatArray, is_member: BoolArray, config: ClusterConfig) -> tuple[IntArray, int]:
    """Group the member points of a scan and drop the groups that are no person.

    Parameters
    ----------
    points : (n, 2) array [m]
        In beam order.
    is_member : (n,) bool array

    Returns
    -------
    labels : (n,) int array
        Cluster number from 0; -1 for points that are not members or were discarded.
    n_clusters : int
    """
    labels = np.empty(len(points), dtype=np.int64)
    n_clusters = _cluster_kernels.find_clusters(
        points,
        is_member,
        *config.kernel_arguments(),
        labels,
    )
    return labels, n_clusters
