"""Occupancy grid with the paper's three states: occupied (p > 0.8), free (p < 0.2), unknown (between)."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slammot_graph.core import se2
from slammot_graph.core.checks import Checked, Count, Positive, PositiveShare
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.results import GridMap
from slammot_graph.core.scan import NO_RETURN_FRACTION, Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.mapping._grid_kernels import far_beams, update_beams, update_by_scan

LEAST_CELL_M, MOST_CELL_M = 1e-3, 10.0

MOST_CELLS = 1 << 27
"""Of a grid in one piece: 8 bytes each."""


def _logit(p: float) -> float:
    return math.log(p / (1.0 - p))


@dataclass(frozen=True, kw_only=True)
class NoReturnConfig(Checked):
    """Beams without a return free cells: in open space nothing is in the laser's reach.

    Attributes
    ----------
    reach_m : float
        Such a beam frees the cells up to this distance.
    min_run : int
        Only so many neighbouring beams count: single ones are more often dark or shiny surfaces.
    range_fraction : float
        From this share of the laser's `range_max` on, a range is no return.
    """

    reach_m: Positive = 5.0
    min_run: Count = 25
    range_fraction: PositiveShare = NO_RETURN_FRACTION


@dataclass(frozen=True, kw_only=True)
class GridConfig(Checked):
    """Resolution and inverse sensor model of an occupancy grid.

    Attributes
    ----------
    resolution_m : float
    p_hit, p_pass : float
        Probability that a cell is occupied, given that a beam ended in it or crossed it.
    p_soft_hit : float
        The same for a soft hit: something moving stood there, which fills a cell only if it stays for long.
    fill_gaps : bool
        Free the cells between neighbouring beams too where the beams are farther apart than a cell.
    p_min, p_max : float
        Bounds of a cell's probability, so that a cell can change its state again.
    p_free, p_occupied : float
        Below is free, above is occupied, between is unknown (0.2 and 0.8 in the paper).
    max_apart_cells : float
        Two lines nearer than this leave no cell between them: a line in between frees nothing that they do not.
    occupy_with_moving : bool
        Moving points occupy cells too (the paper's map takes ALL points).
    no_return : NoReturnConfig or None
        None: beams without a return free nothing.
    """

    resolution_m: Positive = 0.05
    p_hit: float = 0.7
    p_pass: float = 0.4
    p_soft_hit: float = 0.505
    fill_gaps: bool = True
    p_min: float = 0.03
    p_max: float = 0.97
    p_free: float = 0.2
    p_occupied: float = 0.8
    max_apart_cells: Positive = 0.7
    occupy_with_moving: bool = False
    no_return: NoReturnConfig | None = None

    def __post_init__(self) -> None:
        """See `Checked`."""
        super().__post_init__()
        self.require(
            LEAST_CELL_M <= self.resolution_m <= MOST_CELL_M,
            f"must be from {LEAST_CELL_M:g} to {MOST_CELL_M:g} m, not {self.resolution_m:g}",
            key="resolution_m",
        )
        self.require(
            0.0 < self.p_min < self.p_pass < 0.5 < self.p_hit < self.p_max < 1.0,
            "needs 0 < p_min < p_pass < 0.5 < p_hit < p_max < 1",
        )
        self.require(0.5 <= self.p_soft_hit <= self.p_hit, "needs 0.5 <= p_soft_hit <= p_hit")
        self.require(
            self.p_min < self.p_free < 0.5 < self.p_occupied < self.p_max,
            "needs p_min < p_free < 0.5 < p_occupied < p_max",
        )


class OccupancyGrid:
    """Log-odds grid of square cells, in a frame of the caller's.

    A fixed grid grows as needed and never forgets. A rolling one (`window_m` given) keeps constant memory: it
    covers at least `window_m` metres around wherever it is updated, and cells that no scan since `oldest`
    touched count as never seen.

    Attributes
    ----------
    log_odds : (rows, cols) float32 array
    stamp : (rows, cols) int32 array
        Number of the last scan that touched a cell; -1 for none.
    row0, col0 : int
        Global cell index of storage cell [0, 0] (0 for a rolling grid).
    oldest : int
        Cells with an older stamp have expired.

    Over 12 attributes because the kernels take the storage and the log odds of each probability one by one.
    """

    def __init__(self, config: GridConfig, *, window_m: float | None = None) -> None:
        self.config = config
        self.is_rolling = window_m is not None
        extent_m = window_m if window_m is not None else 12.8
        side = 1 << max(math.ceil(math.log2(extent_m / config.resolution_m)), 6)
        self.row0 = self.col0 = 0 if self.is_rolling else -side // 2
        self.log_odds = np.zeros((side, side), dtype=np.float32)
        self.stamp = np.full((side, side), -1, dtype=np.int32)
        self.oldest = 0
        self.inv_resolution = 1.0 / config.resolution_m
        self.l_pass, self.l_hit = _logit(config.p_pass), _logit(config.p_hit)
        self.l_soft = _logit(config.p_soft_hit)
        self.l_min, self.l_max = _logit(config.p_min), _logit(config.p_max)
        self.l_free, self.l_occupied = _logit(config.p_free), _logit(config.p_occupied)

    @property
    def cells(
        self,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int32], int, int, float, int, bool]:
        """The cells and where they lie, as the kernels of the moving-point test take them."""
        return (
            self.log_odds,
            self.stamp,
            self.row0,
            self.col0,
            self.config.resolution_m,
            self.oldest,
            not self.is_rolling,
        )

    def add_scan(
        self,
        number: int,
        scan: Scan,
        T_a_base: FloatArray,
        points: FloatArray,
        is_valid: BoolArray,
        is_static: BoolArray,
    ) -> None:
        """Take in a scan of n beams: static points occupy, all beams free the cells they cross.

        Parameters
        ----------
        number : int
            Not below that of an earlier scan.
        scan : Scan
        T_a_base : (3,) array
            Base in the grid's frame a.
        points : (n, 2) array [m]
            The scan's end points in frame a.
        is_valid, is_static : (n,) bool arrays
            Returns, and those of them that do not move.
        """
        is_hit = is_valid if self.config.occupy_with_moving else is_static
        ends, is_beam, no_return = points, is_valid, self.config.no_return
        if no_return is not None and self.is_rolling:
            update_by_scan(
                self.log_odds,
                self.stamp,
                self.row0,
                self.col0,
                self.inv_resolution,
                number,
                self.oldest,
                T_a_base,
                scan.origins_base,
                scan.directions_base,
                scan.ranges,
                no_return.range_fraction * scan.laser.range_max,
                no_return.min_run,
                min(no_return.reach_m, scan.laser.range_max),
                points,
                is_valid,
                is_hit,
                self.l_pass,
                self.l_hit,
                self.l_soft,
                self.config.fill_gaps,
                self.config.max_apart_cells,
                self.l_min,
                self.l_max,
            )
            return
        origins = np.empty_like(scan.origins_base)
        if no_return is None:
            se2.transform_points(T_a_base, scan.origins_base, origins)
        else:
            ends, is_beam = np.empty_like(points), np.empty_like(is_valid)
            far_beams(
                T_a_base,
                scan.origins_base,
                scan.directions_base,
                min(no_return.reach_m, scan.laser.range_max),
                scan.is_no_return(no_return.min_run, no_return.range_fraction),
                points,
                is_valid,
                origins,
                ends,
                is_beam,
            )
        self.update(number, origins, ends, is_beam, is_hit, is_valid & ~is_hit)

    def update(
        self,
        now: int,
        origins: FloatArray,
        end_points: FloatArray,
        is_beam: BoolArray,
        is_hit: BoolArray,
        is_soft_hit: BoolArray | None = None,
        weight: float = 1.0,
        hit_weight: float = 1.0,
    ) -> None:
        """Take in one scan.

        Parameters
        ----------
        now : int
            Number of the scan; not below that of an earlier update.
        origins : (2,), (1, 2) or (n, 2) array
            The laser [m]: one place, or that of each beam.
        end_points : (n, 2) array [m]
        is_beam : (n,) bool array
            Beams that free the cells they cross.
        is_hit : (n,) bool array
            Beams whose end point occupies its cell.
        is_soft_hit : (n,) bool array, optional
            Beams whose end point fills its cell a little; by default all others that free.
        weight, hit_weight : float
            Of the scan's evidence, of what it frees and of its hits: the log-odds are multiplied by it.
        """
        origins = origins.reshape(-1, 2)
        if not self.is_rolling:
            self._cover(origins, end_points[is_beam])
        update_beams(
            self.log_odds,
            self.stamp,
            self.row0,
            self.col0,
            self.inv_resolution,
            now,
            self.oldest,
            origins,
            end_points,
            is_beam,
            is_hit,
            is_beam & ~is_hit if is_soft_hit is None else is_soft_hit,
            weight * self.l_pass,
            hit_weight * self.l_hit,
            hit_weight * self.l_soft,
            self.config.fill_gaps,
            self.config.max_apart_cells,
            self.l_min,
            self.l_max,
        )

    def probability(self, points: FloatArray) -> FloatArray:
        """(n,) probabilities of occupation of the cells at (n, 2) points [m]; 0.5 where never seen."""
        rows, cols = self.log_odds.shape
        i = np.floor(points[:, 1] * self.inv_resolution).astype(np.int64) - self.row0
        j = np.floor(points[:, 0] * self.inv_resolution).astype(np.int64) - self.col0
        inside = (
            np.full(len(points), True) if self.is_rolling else (i >= 0) & (i < rows) & (j >= 0) & (j < cols)
        )
        i, j = i & (rows - 1), j & (cols - 1)
        value = np.where(inside & (self.stamp[i, j] >= self.oldest), self.log_odds[i, j], 0.0)
        return np.asarray(1.0 / (1.0 + np.exp(-value.astype(np.float64))))

    def crop(self, centre: FloatArray, half_side_m: float) -> GridMap:
        """Give the cells that a square touches; NaN where never seen, expired, or outside of a fixed grid.

        Parameters
        ----------
        centre : (2,) array [m]
            In the grid's frame.
        half_side_m : float
            Of a rolling grid at most half its window.

        Returns
        -------
        GridMap
            With its origin in the grid's frame.
        """
        low = np.floor((centre - half_side_m) * self.inv_resolution).astype(np.int64)
        high = np.floor((centre + half_side_m) * self.inv_resolution).astype(np.int64)
        i = np.arange(low[1], high[1] + 1) - self.row0
        j = np.arange(low[0], high[0] + 1) - self.col0
        stamp = self.stamp.take(i, axis=0, mode="wrap").take(j, axis=1, mode="wrap")
        log_odds = self.log_odds.take(i, axis=0, mode="wrap").take(j, axis=1, mode="wrap")
        is_seen = stamp >= max(self.oldest, 0)
        if not self.is_rolling:
            rows, cols = self.log_odds.shape
            is_seen &= ((i >= 0) & (i < rows))[:, None] & ((j >= 0) & (j < cols))
        p = 1.0 / (1.0 + np.exp(-log_odds.astype(np.float64)))
        return GridMap(
            p_occupied=np.where(is_seen, p, np.nan),
            resolution_m=self.config.resolution_m,
            origin=low.astype(np.float64) * self.config.resolution_m,
        )

    def to_map(self) -> GridMap:
        """Crop a fixed grid to what was seen."""
        seen = (self.stamp >= max(self.oldest, 0)) & (not self.is_rolling)
        rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if len(rows) == 0:
            nothing = np.full((1, 1), np.nan)
            return GridMap(p_occupied=nothing, resolution_m=self.config.resolution_m, origin=np.zeros(2))
        window = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
        p = 1.0 / (1.0 + np.exp(-self.log_odds[window].astype(np.float64)))
        corner = np.array([cols[0] + self.col0, rows[0] + self.row0], dtype=np.float64)
        return GridMap(
            p_occupied=np.where(seen[window], p, np.nan),
            resolution_m=self.config.resolution_m,
            origin=corner * self.config.resolution_m,
        )

    def _cover(self, origins: FloatArray, end_points: FloatArray) -> None:
        """Grow a fixed grid, doubling, until it holds the beams."""
        corners = np.vstack([origins, end_points])
        low = np.floor(corners.min(axis=0) * self.inv_resolution).astype(np.int64) - 1
        high = np.floor(corners.max(axis=0) * self.inv_resolution).astype(np.int64) + 1
        row0, col0 = self.row0, self.col0
        rows, cols = self.log_odds.shape
        while low[1] < row0 or high[1] >= row0 + rows:
            row0, rows = (row0 - rows if low[1] < row0 else row0), 2 * rows
        while low[0] < col0 or high[0] >= col0 + cols:
            col0, cols = (col0 - cols if low[0] < col0 else col0), 2 * cols
        if (rows, cols) == self.log_odds.shape:
            return
        if rows * cols > MOST_CELLS:
            extent_m = max(rows, cols) * self.config.resolution_m
            raise SlammotError(
                f"the map has grown to {extent_m:.0f} m in cells of {self.config.resolution_m:g} m, more than memory"
                " holds; look for a leap in the trajectory, or take a larger grid.resolution_m"
            )
        log_odds = np.zeros((rows, cols), dtype=np.float32)
        stamp = np.full((rows, cols), -1, dtype=np.int32)
        i, j = self.row0 - row0, self.col0 - col0
        window = slice(i, i + self.log_odds.shape[0]), slice(j, j + self.log_odds.shape[1])
        log_odds[window], stamp[window] = self.log_odds, self.stamp
        self.log_odds, self.stamp, self.row0, self.col0 = log_odds, stamp, row0, col0
