"""Occupancy grid whose memory follows what was seen, not the extent: square tiles, the nearest in one window."""

import math

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from slammot_graph.core.errors import SlammotError
from slammot_graph.core.results import GridMap
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.mapping._tile_kernels import bounds
from slammot_graph.mapping.occupancy_grid import GridConfig, OccupancyGrid

TILE = 64
"""Side of a tile [cells]; a power of two."""

MOST_CELLS = 32_000_000
"""A map of more cells is not made: as numbers and as a picture it would take gigabytes."""

FIRST_WINDOW_M = 25.6
_NOBODY = np.iinfo(np.int64).min
_TileKey = tuple[int, int]
_NOTHING_HELD: tuple[_TileKey, _TileKey] = ((0, 0), (-1, -1))


class PartialMapError(SlammotError):
    """Not all that was seen is in the map.

    Attributes
    ----------
    grid : GridMap
        What of it could be made.
    """

    def __init__(self, problem: str, grid: GridMap) -> None:
        super().__init__(problem)
        self.grid = grid


class TiledGrid:
    """Log-odds grid of any extent, in tiles of `TILE` cells.

    The tiles that a scan touches lie in a rolling `OccupancyGrid`, in which the kernel works; those that leave it are
    put aside where they were seen.

    Attributes
    ----------
    config : GridConfig
    window : OccupancyGrid
        Rolling; holds the tiles around the latest scan.
    """

    def __init__(self, config: GridConfig) -> None:
        self.config = config
        self.window = OccupancyGrid(config, window_m=max(FIRST_WINDOW_M, TILE * config.resolution_m))
        self._tiles: dict[_TileKey, npt.NDArray[np.float32]] = {}
        self._owner = self._no_owners()
        self._held = _NOTHING_HELD

    def update(
        self,
        now: int,
        origins: FloatArray,
        end_points: FloatArray,
        is_beam: BoolArray,
        is_hit: BoolArray,
        is_soft_hit: BoolArray,
        weight: float = 1.0,
        hit_weight: float = 1.0,
    ) -> None:
        """Take in one scan; see `OccupancyGrid.update`."""
        origins = origins.reshape(-1, 2)
        self._hold(*bounds(origins, end_points, is_beam, is_hit, is_soft_hit))
        self.window.update(now, origins, end_points, is_beam, is_hit, is_soft_hit, weight, hit_weight)

    def add_evidence(self, now: int, point: FloatArray, log_odds: float) -> None:
        """Add log-odds to the cell at a point (2,) [m], within the bounds of a cell."""
        window = self.window
        x, y = point.tolist()
        self._hold(x, y, x, y)
        mask = len(window.stamp) - 1
        i, j = math.floor(y * window.inv_resolution) & mask, math.floor(x * window.inv_resolution) & mask
        before = float(window.log_odds[i, j]) if window.stamp[i, j] >= 0 else 0.0
        window.log_odds[i, j] = min(max(before + log_odds, window.l_min), window.l_max)
        window.stamp[i, j] = now

    def free_around(self, points: FloatArray, radius_m: float) -> None:
        """Make the cells within a distance of points (n, 2) [m] free where they are not occupied."""
        self._put_all_aside()
        cells = _cells_around(points, radius_m, self.config.resolution_m)
        if not len(cells):
            return
        free = np.float32(0.5 * (self.window.l_free + self.window.l_min))
        tile_of = cells // TILE
        order = np.lexsort((tile_of[:, 1], tile_of[:, 0]))
        cells, tile_of = cells[order], tile_of[order]
        first = np.flatnonzero(np.any(np.diff(tile_of, axis=0, prepend=tile_of[:1] - 1) != 0, axis=1))
        for key, group in zip(tile_of[first].tolist(), np.split(cells, first[1:]), strict=True):
            tile = self._tiles.setdefault((key[0], key[1]), _unseen_tile())
            i, j = (group % TILE).T
            value = tile[i, j]
            tile[i, j] = np.where(value > self.window.l_occupied, value, np.fmin(value, free))

    def to_map(self, most_cells: int = MOST_CELLS) -> GridMap:
        """Give the map of all that was seen; with larger cells where it would have more than `most_cells`.

        Raises
        ------
        PartialMapError
            It would have more than `most_cells` cells, and what was seen is not connected: the part of which most was
            seen is given.
        """
        self._put_all_aside()
        if not self._tiles:
            nothing = np.full((1, 1), np.nan)
            return GridMap(p_occupied=nothing, resolution_m=self.config.resolution_m, origin=np.zeros(2))
        keys = np.array(sorted(self._tiles), dtype=np.int64)
        if _n_cells(keys) <= most_cells:
            return self._dense(keys, 1)
        extent_m = (np.ptp(keys, axis=0)[::-1] + 1) * TILE * self.config.resolution_m
        parts = _connected(keys)
        seen = [sum(int(np.isfinite(self._tiles[i, j]).sum()) for i, j in part.tolist()) for part in parts]
        part = parts[int(np.argmax(seen))]
        factor = 1
        while _n_cells(part) > most_cells * factor**2:
            factor *= 2
        grid = self._dense(part, factor)
        if len(parts) == 1:
            return grid
        share = max(seen) / sum(seen)
        raise PartialMapError(
            f"what was seen spans {extent_m[0]:.0f} x {extent_m[1]:.0f} m, too much for one picture of cells of"
            f" {self.config.resolution_m:g} m: the map holds the connected part of which most was seen ({share:.0%} of"
            f" all), in cells of {grid.resolution_m:g} m; look for a leap in the trajectory, or take a larger"
            " grid.resolution_m",
            grid,
        )

    def _dense(self, keys: IntArray, factor: int) -> GridMap:
        """Put tiles together, `factor` x `factor` cells to one: the most occupied of those that were seen."""
        side = TILE // factor if factor < TILE else 1
        factor = TILE // side
        low = keys.min(axis=0)
        p = np.full(tuple((np.ptp(keys, axis=0) + 1) * side), np.nan)
        for i, j in keys.tolist():
            tile = self._tiles[i, j].astype(np.float64)
            if factor > 1:
                tile = np.fmax.reduce(tile.reshape(side, factor, side, factor), axis=(1, 3))
            row, col = (i - low[0]) * side, (j - low[1]) * side
            p[row : row + side, col : col + side] = 1.0 / (1.0 + np.exp(-tile))
        is_seen = np.isfinite(p)
        rows, cols = np.flatnonzero(is_seen.any(axis=1)), np.flatnonzero(is_seen.any(axis=0))
        resolution_m = self.config.resolution_m * factor
        corner = np.array([cols[0] + low[1] * side, rows[0] + low[0] * side], dtype=np.float64)
        return GridMap(
            p_occupied=p[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1],
            resolution_m=resolution_m,
            origin=corner * resolution_m,
        )

    def _hold(self, x_low: float, y_low: float, x_high: float, y_high: float) -> None:
        """Bring the tiles of a rectangle [m] into the window, with a cell of margin."""
        scale = self.window.inv_resolution
        low = (math.floor(y_low * scale) - 1) // TILE, (math.floor(x_low * scale) - 1) // TILE
        high = (math.floor(y_high * scale) + 1) // TILE, (math.floor(x_high * scale) + 1) // TILE
        held_low, held_high = self._held
        if (
            held_low[0] <= low[0]
            and held_low[1] <= low[1]
            and high[0] <= held_high[0]
            and high[1] <= held_high[1]
        ):
            return
        n_slots = len(self._owner)
        span = max(high[0] - low[0], high[1] - low[1])
        if span >= n_slots:
            self._put_all_aside()
            while span >= n_slots:
                n_slots *= 2
            self.window = OccupancyGrid(
                self.config, window_m=n_slots * TILE * self.config.resolution_m * 0.99
            )
            self._owner = self._no_owners()
        i, j = np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)
        mask = len(self._owner) - 1
        owner = self._owner[(i & mask)[:, None], (j & mask)[None]]
        is_other = (owner[..., 0] != i[:, None]) | (owner[..., 1] != j[None])
        for a, b in np.argwhere(is_other).tolist():
            self._swap_in((int(i[a]), int(j[b])))
        self._held = low, high

    def _swap_in(self, key: _TileKey) -> None:
        """Give a tile its place in the window, in which another may lie."""
        mask = len(self._owner) - 1
        slot = key[0] & mask, key[1] & mask
        self._put_aside(slot)
        self._owner[slot] = key
        tile = self._tiles.pop(key, None)
        if tile is not None:
            window = self._place(slot)
            is_seen = np.isfinite(tile)
            self.window.stamp[window] = np.where(is_seen, 0, -1)
            self.window.log_odds[window] = np.where(is_seen, tile, 0.0)

    def _put_aside(self, slot: _TileKey) -> None:
        """Take the tile out of a place of the window, and keep it if anything of it was seen."""
        owner = self._owner[slot]
        if owner[0] == _NOBODY:
            return
        window = self._place(slot)
        is_seen = self.window.stamp[window] >= 0
        if is_seen.any():
            tile = np.where(is_seen, self.window.log_odds[window], np.float32(np.nan))
            self._tiles[int(owner[0]), int(owner[1])] = tile
            self.window.stamp[window] = -1
        self._owner[slot] = _NOBODY

    def _put_all_aside(self) -> None:
        for a, b in np.argwhere(self._owner[..., 0] != _NOBODY).tolist():
            self._put_aside((a, b))
        self._held = _NOTHING_HELD

    def _place(self, slot: _TileKey) -> tuple[slice, slice]:
        row, col = slot[0] * TILE, slot[1] * TILE
        return slice(row, row + TILE), slice(col, col + TILE)

    def _no_owners(self) -> IntArray:
        n_slots = len(self.window.stamp) // TILE
        return np.full((n_slots, n_slots, 2), _NOBODY, dtype=np.int64)


def _unseen_tile() -> npt.NDArray[np.float32]:
    return np.full((TILE, TILE), np.nan, dtype=np.float32)


def _n_cells(keys: IntArray) -> int:
    """Cells of the rectangle that holds all tiles."""
    rows, cols = (np.ptp(keys, axis=0) + 1).tolist()
    return int(rows) * int(cols) * TILE**2


def _connected(keys: IntArray) -> list[IntArray]:
    """Parts of tiles (n, 2) that touch each other, corners included."""
    pairs = cKDTree(keys).query_pairs(1.5, output_type="ndarray")
    n = len(keys)
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    n_parts, part = connected_components(links, directed=False)
    return [keys[part == k] for k in range(n_parts)]


def _cells_around(points: FloatArray, radius_m: float, resolution_m: float) -> IntArray:
    """(m, 2) rows and columns of the cells that lie within a distance of the cells of points (n, 2), each once."""
    reach = int(np.ceil(radius_m / resolution_m))
    steps = np.arange(-reach, reach + 1)
    offsets = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    offsets = offsets[np.hypot(*offsets.T) * resolution_m <= radius_m + 0.75 * resolution_m]
    own = _unique_rows(np.floor(points[:, ::-1] / resolution_m).astype(np.int64))
    return _unique_rows((own[:, None] + offsets[None]).reshape(-1, 2))


def _unique_rows(rows: IntArray) -> IntArray:
    """Each of some rows (n, 2) once."""
    if not len(rows):
        return rows
    low, span = rows.min(axis=0), np.ptp(rows, axis=0) + 1
    flat = np.unique((rows[:, 0] - low[0]) * span[1] + (rows[:, 1] - low[1]))
    unique: IntArray = np.column_stack(np.divmod(flat, span[1])) + low
    return unique
