"""The occupancy map that a saved map shows: from the points of its keyframes, as the scans themselves are gone."""

from dataclasses import replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import GridMap
from slammot_graph.core.saved_map import SavedMap
from slammot_graph.core.saved_map_parts import joined_keyframes, keyframe_places
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.mapping.final_map import FinalMapConfig
from slammot_graph.mapping.occupancy_grid import GridConfig
from slammot_graph.mapping.tiled_grid import TiledGrid


def render_saved_map(saved: SavedMap, grid: GridConfig, config: FinalMapConfig) -> GridMap:
    """Render the map of all local maps whose place is known; each keyframe counts as a viewpoint does in a run's map.

    Raises
    ------
    PartialMapError
        Not all that was seen fits into one map.
    """
    tiled = TiledGrid(replace(grid, fill_gaps=False))  # the points of a keyframe are thinned: no neighbours
    places = keyframe_places(saved)
    is_shown = joined_keyframes(saved) & (saved.keyframe_sizes > 0)
    ends = np.cumsum(saved.keyframe_sizes)
    for number, k in enumerate(np.flatnonzero(is_shown).tolist()):
        T_map_base = places[k]
        points = se2.transform(T_map_base, saved.points[ends[k] - saved.keyframe_sizes[k] : ends[k]])
        origin = se2.transform(T_map_base, saved.keyframe_origins[k][None, :])
        is_beam = np.ones(len(points), dtype=np.bool_)
        tiled.update(number, origin, points, is_beam, is_beam, ~is_beam, config.n_votes, config.n_hit_votes)
    if is_shown.any() and config.path_m > 0.0:
        tiled.free_around(places[is_shown, :2], config.path_m)
    return tiled.to_map()


def aligned(*grids: GridMap) -> tuple[list[FloatArray], IntArray]:
    """Give the cells of maps of one resolution in one window, NaN where a map has none.

    Returns
    -------
    cells : list of (rows, cols) arrays
        `p_occupied` of each.
    low : (2,) int array
        Column and row of the window's first cell, counted from the map frame's origin.
    """
    shown = [grid for grid in grids if np.isfinite(grid.p_occupied).any()] or list(grids)
    corners = [np.round(grid.origin / grid.resolution_m).astype(np.int64) for grid in grids]
    sizes = [np.array(grid.p_occupied.shape[::-1]) for grid in grids]
    is_shown = [any(grid is one for one in shown) for grid in grids]
    low = np.min([corner for corner, is_one in zip(corners, is_shown, strict=True) if is_one], axis=0)
    high = np.max(
        [corner + size for corner, size, is_one in zip(corners, sizes, is_shown, strict=True) if is_one],
        axis=0,
    )
    cells = []
    for grid, corner, is_one in zip(grids, corners, is_shown, strict=True):
        p = np.full((high - low)[::-1], np.nan)
        if is_one:
            (x, y), (rows, cols) = corner - low, grid.p_occupied.shape
            p[y : y + rows, x : x + cols] = grid.p_occupied
        cells.append(p)
    return cells, low
