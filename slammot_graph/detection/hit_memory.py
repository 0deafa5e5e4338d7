"""Partly occupied places: where static points lay time and again, what shows up on free cells is furniture.

Legs of chairs and tables, hedges and edges are hit by one beam in ten or twenty; the others pass. The log-odds of such
a cell, bounded as they are, say that it is free, and each hit looks like something that has come. How often the cell
was hit is remembered here beside them (hits and passes are counted apart in the reflection maps of Haehnel 2004).
"""

import math
from dataclasses import dataclass

import numpy as np

from slammot_graph.core.checks import Checked, Count, NotNegative, PositiveShare, Share
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _hit_kernels
from slammot_graph.detection.clustering import ClusterConfig


@dataclass(frozen=True, kw_only=True)
class HitMemoryConfig(Checked):
    """When the points of a cluster on free cells are furniture.

    Attributes
    ----------
    min_hits : int
        A cell that static points hit at so many scans, more than moving ones did, was hit before.
    min_hits_displaced : int
        The same, after the run, for points on an object that has displaced.
    min_share : float
        A cluster is furniture if this share of its points lies in such cells.
    spacing_s : float
        Scans that follow an earlier one of the same laser sooner than this are not counted: they see the same.
    apart_s : float
        After the run: only hits at least this long before or after count, for who comes and stands is hit as well.
    crowd_share : float
        Where more than this share of a scan moves, nothing is counted and nothing called furniture: what stands beside
        is people as well.
    spare_m : float
        Static points this near to where an object that has displaced is expected are no hits, neither here nor for
        the test's grid: who stops must not be taken for a part of the building.
    """

    min_hits: Count = 3
    min_hits_displaced: Count = 12
    min_share: PositiveShare = 0.5
    spacing_s: NotNegative = 0.15
    apart_s: NotNegative = 3.0
    crowd_share: Share = 0.25
    spare_m: NotNegative = 0.35


class HitMemory:
    """Counts of hits in the cells of a grid that rolls along, as the test's own grid does.

    Parameters
    ----------
    config : HitMemoryConfig
    resolution_m : float
        Side of a cell.
    window_m : float
        What it covers around the robot.
    """

    def __init__(self, config: HitMemoryConfig, *, resolution_m: float, window_m: float) -> None:
        self.config = config
        side = 1 << max(math.ceil(math.log2(window_m / resolution_m)), 6)
        self.counts = np.zeros((side, side), dtype=np.int32)
        self.stamp = np.full((side, side), -1, dtype=np.int32)
        self.inv_resolution = 1.0 / resolution_m
        self.oldest = 0
        self._latest_s: dict[int, float] = {}

    def add(
        self,
        number: int,
        stamp_s: float,
        points: FloatArray,
        is_valid: BoolArray,
        is_static: BoolArray,
        laser: int = 0,
    ) -> None:
        """Take in a scan: its number, stamp [s], points (n, 2) [m], its returns, those that are static, its laser."""
        if abs(stamp_s - self._latest_s.get(laser, -math.inf)) < self.config.spacing_s:
            return
        self._latest_s[laser] = stamp_s
        _hit_kernels.count_hits(
            self.counts,
            self.stamp,
            self.inv_resolution,
            number,
            self.oldest,
            points,
            is_valid,
            is_static,
            self.config.crowd_share,
        )

    def hits(self, points: FloatArray, is_static: BoolArray, expected: FloatArray) -> BoolArray:
        """(n,) static points that count as hits: not those near a place (k, 2) where an object is expected."""
        if not len(expected):
            return is_static
        is_hit = np.empty_like(is_static)
        _hit_kernels.leave_near(points, is_static, expected, self.config.spare_m, is_hit)
        return is_hit

    def call_furniture(
        self,
        points: FloatArray,
        reason: IntArray,
        clusters: ClusterConfig,
        expected: FloatArray,
        reach_m: float,
    ) -> None:
        """Change the reasons (n,) of clusters on free cells that were hit before from FREE to FURNITURE.

        Parameters
        ----------
        points : (n, 2) array [m]
        reason : (n,) int array
        clusters : ClusterConfig
        expected : (k, 2) array [m]
            Where tracked objects that have displaced should be: a cluster within `reach_m` of one stays.
        reach_m : float
        """
        _hit_kernels.find_furniture(
            self.counts,
            self.stamp,
            self.inv_resolution,
            self.oldest,
            points,
            reason,
            self.config.min_hits,
            self.config.crowd_share,
            self.config.min_share,
            expected,
            reach_m,
            *clusters.kernel_arguments(),
        )
