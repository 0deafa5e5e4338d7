"""Cells of the moving-point test, shown around what moves, as the test saw them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import GridMap, StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.observer import TestGrid
from slammot_graph.viz.rerun.budget import Budget
from slammot_graph.viz.rerun.columns import Columns, times_of
from slammot_graph.viz.rerun.primitives import cell_colors, cell_columns

CELLS_HALF_SIDE_M = 10.0
"""How far to each side of the robot cells of the test can be shown, along the axes of the local frame."""
CELLS_MARGIN_M = 1.0
"""How far around the moving points they are shown."""
CELLS_HEIGHT_M = -0.045
"""Above the map, below all else."""
CELLS_SHARE, CELLS_HEAD_START = 1.0, 4 << 20
"""What they may add to the bytes of the scans, neither compressed, and how many bytes more."""
COLOR_CELLS = (0xCFC4E6FF, 0xD5EFD0FF, 0xD0B080FF)
"""Of cells of the test: unknown, free, occupied; light, so that points and ellipses stand out."""


class CellPanel:
    """Keeps the test's grid as each step left it, and shows it with the next one.

    The test of a scan sees the grid as the scan before left it.
    """

    def __init__(self, out: Columns) -> None:
        self._out = out
        self._patches: list[_Patch | None] = []  # one a step
        self._before: TestGrid | None = None  # as the last step left it
        self._last_scan = -1
        self._budget = Budget(CELLS_SHARE, 1, renewal=0.0, head_start=CELLS_HEAD_START)

    def wants(self, n_scans: int) -> bool:
        """Tell whether the cells are due with the next step, after so many."""
        return self._budget.is_due(n_scans, self._out.n_bytes)

    def keep(self, step: StepResult, now: TestGrid | None, n_scans: int) -> None:
        """Keep the next step: `now` is the grid as it left it, if that was due; `n_scans` came before it."""
        before, self._before = self._before, now
        patch = self._cut(step, before, now) if before is not None and now is not None else None
        if patch is not None:
            self._budget.spend(n_scans, patch.colors.nbytes)
        self._patches.append(patch)
        self._last_scan = step.scan.index

    def _cut(self, step: StepResult, before: TestGrid, now: TestGrid) -> "_Patch | None":
        """Cut out the cells that the test saw around a step's moving points; None where there are none of either."""
        if not step.is_moving.any():
            return None
        points = step.scan.points(se2.between(now.T_map_local, step.T_map_base))[step.is_moving]
        cells = _around(before.cells, points)
        if cells.p_occupied.size == 0:
            return None
        corner = se2.transform(now.T_map_local, cells.origin[None])[0]
        return _Patch(
            colors=cell_colors(cells, (before.p_free, before.p_occupied), COLOR_CELLS),
            T_map_corner=np.append(corner, now.T_map_local[2]),
            resolution_m=cells.resolution_m,
            after_scan=self._last_scan,
        )

    def send(self, steps: list[StepResult]) -> None:
        """Send the cells that the test saw; where there are none, what was shown before goes."""
        import pyarrow as pa
        import rerun as rr

        patches, self._patches = self._patches, []
        kept = [patch for patch in patches if patch is not None]
        columns = cell_columns(
            [patch.colors for patch in kept],
            np.array([patch.T_map_corner for patch in kept]).reshape(-1, 3),
            [patch.resolution_m for patch in kept],
            CELLS_HEIGHT_M,
        )
        after = rr.AnyValues.columns(after_scan=pa.array([patch.after_scan for patch in kept], pa.int64()))
        lengths = np.array([patch is not None for patch in patches], dtype=np.int64)
        self._out.send_batches(
            "/world/cells", times_of(steps), rr.ComponentColumnList([*columns, *after]), lengths
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Patch:
    """Cells to be shown, uint8 (rows, cols, 3), where their lower left corner lies, and which scan left them so."""

    colors: Any
    T_map_corner: FloatArray
    resolution_m: float
    after_scan: int


def _around(grid: GridMap, points: FloatArray) -> GridMap:
    """Cut out the part of a grid around points (n, 2) of its frame; may be without any cell."""
    corners = np.array([points.min(axis=0) - CELLS_MARGIN_M, points.max(axis=0) + CELLS_MARGIN_M])
    low, high = np.floor((corners - grid.origin) / grid.resolution_m).astype(np.int64)
    low, high = np.maximum(low, 0), np.maximum(high + 1, 0)
    return GridMap(
        p_occupied=grid.p_occupied[low[1] : high[1], low[0] : high[0]],
        resolution_m=grid.resolution_m,
        origin=grid.origin + grid.resolution_m * low,
    )
