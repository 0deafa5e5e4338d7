"""Subsets of moving points by distance; too few points, or too wide for a person: discarded."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _cluster_kernels


@dataclass(frozen=True, kw_only=True)
class ClusterConfig:
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
    split_gap_m : float
        A subset that is too wide is split at gaps of this size, for people who walk side by side; 0: never.
    split_min_points : int
        Parts with fewer points are discarded: legs of chairs are no people.
    """

    max_gap_m: float = 0.6
    max_skipped_beams: int = 10
    min_points: int = 2
    max_x_range_m: float = 1.5
    max_y_range_m: float = 1.5
    split_gap_m: float = 0.15
    split_min_points: int = 8

    def __post_init__(self) -> None:
        if not self.max_gap_m > 0.0:
            raise ConfigError(f"clusters.max_gap_m must be positive, not {self.max_gap_m}")
        if self.max_skipped_beams < 0:
            raise ConfigError(
                f"clusters.max_skipped_beams must not be negative, not {self.max_skipped_beams}"
            )
        for name in ("min_points", "split_min_points"):
            if getattr(self, name) < 1:
                raise ConfigError(f"clusters.{name} must be at least 1, not {getattr(self, name)}")
        if not self.split_gap_m >= 0.0:
            raise ConfigError(f"clusters.split_gap_m must not be negative, not {self.split_gap_m}")
        if not (self.max_x_range_m > 0.0 and self.max_y_range_m > 0.0):
            raise ConfigError("clusters.max_x_range_m and clusters.max_y_range_m must be positive")


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
        config.max_gap_m,
        config.max_skipped_beams,
        config.min_points,
        config.max_x_range_m,
        config.max_y_range_m,
        config.split_gap_m,
        config.split_min_points,
        labels,
    )
    return labels, n_clusters
