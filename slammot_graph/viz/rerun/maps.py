"""The map of a recording."""

from slammot_graph.core.results import GridMap
from slammot_graph.viz.rerun.budget import Budget
from slammot_graph.viz.rerun.columns import Columns
from slammot_graph.viz.rerun.primitives import grid_map

MAP_SHARE, MAP_HEAD_START = 0.15, 1 << 20
"""What maps may add to the bytes of the scans, and how many bytes more: the larger they grow, the rarer they are."""


class MapPanel:
    """The map, now and then."""

    def __init__(self, out: Columns) -> None:
        self._out = out
        self._budget = Budget(MAP_SHARE, 20, head_start=MAP_HEAD_START)

    def wants(self, n_scans: int) -> bool:
        """Tell whether the map is due after so many scans."""
        return self._budget.is_due(n_scans, self._out.n_bytes)

    def log(self, grid: GridMap, n_scans: int) -> None:
        """Log the map as it is after so many scans."""
        self._out.rec.log("/world/map/grid", grid_map(grid))
        self._budget.spend(n_scans, grid.p_occupied.size / 8)
