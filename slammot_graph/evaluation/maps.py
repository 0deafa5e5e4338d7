"""Ghosts and lost walls of a map, against the map of the same log without people."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GridMap
from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation.stats import ratio


@dataclass(frozen=True, kw_only=True)
class MapScores:
    """Differences of a map from its reference; the rates are NaN if the reference has seen nothing.

    Attributes
    ----------
    n_ghost_cells : int
        Occupied here, free in the reference, and no wall of the reference within the tolerance.
    n_lost_wall_cells : int
        Occupied in the reference and nothing occupied here within the tolerance.
    n_unseen_wall_cells : int
        Those of the lost ones that this map has never seen.
    n_wall_cells : int
        Occupied cells of the reference.
    area_m2 : float
        What the reference has seen [m^2].
    """

    n_ghost_cells: int
    n_lost_wall_cells: int
    n_unseen_wall_cells: int
    n_wall_cells: int
    area_m2: float

    @property
    def n(self) -> int:
        """Occupied cells of the reference: what the map is compared with."""
        return self.n_wall_cells

    @property
    def ghosts_per_m2(self) -> float:
        """Ghost cells per square metre that the reference has seen [1/m^2]."""
        return ratio(self.n_ghost_cells, self.area_m2)

    @property
    def lost_walls_per_m2(self) -> float:
        """Lost wall cells per square metre that the reference has seen [1/m^2]."""
        return ratio(self.n_lost_wall_cells, self.area_m2)


def evaluate_map(
    grid: GridMap,
    reference: GridMap,
    *,
    occupied_above: float = 0.8,
    free_below: float = 0.2,
    tolerance_cells: int = 1,
) -> MapScores:
    """Count ghost cells and lost wall cells of a map.

    Parameters
    ----------
    grid : GridMap
        The map to evaluate.
    reference : GridMap
        The map of the same log without people, in the same frame and resolution; the origins may differ, by
        whole cells or not (cells are then paired by the nearest centre).
    occupied_above, free_below : float
        The paper's thresholds of the three states.
    tolerance_cells : int
        A wall may be off by so many cells in each direction (a square neighbourhood).

    Raises
    ------
    InputError
        The resolutions differ.
    """
    if not np.isclose(grid.resolution_m, reference.resolution_m, rtol=1e-6):
        raise InputError(
            "maps to compare need one resolution,"
            f" not {grid.resolution_m:g} m and {reference.resolution_m:g} m"
        )
    p, p_reference = _common_frame(grid, reference)
    with np.errstate(invalid="ignore"):
        is_occupied, is_wall = p > occupied_above, p_reference > occupied_above
        is_reference_free = p_reference < free_below
    square = np.ones((2 * tolerance_cells + 1, 2 * tolerance_cells + 1), dtype=np.bool_)
    is_ghost = is_occupied & is_reference_free & ~ndimage.binary_dilation(is_wall, square)
    is_lost = is_wall & ~ndimage.binary_dilation(is_occupied, square)
    return MapScores(
        n_ghost_cells=int(is_ghost.sum()),
        n_lost_wall_cells=int(is_lost.sum()),
        n_unseen_wall_cells=int((is_lost & np.isnan(p)).sum()),
        n_wall_cells=int(is_wall.sum()),
        area_m2=float(np.isfinite(p_reference).sum() * reference.resolution_m**2),
    )


def _common_frame(grid: GridMap, reference: GridMap) -> tuple[FloatArray, FloatArray]:
    """Both probability arrays on the smallest grid that holds them, in the reference's raster."""
    offset = np.rint((grid.origin - reference.origin) / reference.resolution_m).astype(np.int64)[::-1]
    low = np.minimum(offset, 0)
    high = np.maximum(offset + grid.p_occupied.shape, reference.p_occupied.shape)
    frames = []
    for start, p in ((offset - low, grid.p_occupied), (-low, reference.p_occupied)):
        frame = np.full(tuple(high - low), np.nan)
        frame[start[0] : start[0] + p.shape[0], start[1] : start[1] + p.shape[1]] = p
        frames.append(frame)
    return frames[0], frames[1]
