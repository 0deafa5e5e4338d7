"""What the overview and the animation share: the page around the map, the map itself, scale bar and legend.

Drawn with matplotlib's objects alone: no pyplot, no window, no state that others share.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from slammot_graph.result_types import GridMap
from slammot_graph.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LONG_SIDE_IN = 10.0
"""Long side of the map on the page [inch]."""
SHORT_SIDE_IN = 2.0
LEGEND_ENTRY_IN = 1.4
PAD_IN, TITLE_IN, SCALE_BAR_IN, LEGEND_ROW_IN = 0.15, 0.62, 0.4, 0.24
MARGIN_M = 0.5
MIN_EXTENT_M = 4.0
UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""States of a cell; of several cells in one pixel the highest shows."""
STATE_COLORS = np.array([[222, 225, 228], [255, 255, 255], [25, 25, 30]], dtype=np.uint8)


@dataclass(frozen=True, kw_only=True)
class Page:
    """What part of the world is shown, and where it lies on the page.

    Attributes
    ----------
    x_m, y_m : (float, float)
        Limits of the map [m].
    map_in : (float, float)
        Width and height of the map on the page [inch].
    width_in : float
    n_legend_columns, n_legend_rows : int
    """

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    map_in: tuple[float, float]
    width_in: float
    n_legend_columns: int
    n_legend_rows: int

    @property
    def legend_in(self) -> float:
        """Height of the legend [inch]."""
        return self.n_legend_rows * LEGEND_ROW_IN + PAD_IN

    @property
    def height_in(self) -> float:
        """Height of the page [inch]."""
        return TITLE_IN + self.map_in[1] + SCALE_BAR_IN + self.legend_in

    @property
    def left_in(self) -> float:
        """Left edge of the map [inch]."""
        return 0.5 * (self.width_in - self.map_in[0])

    def map_box(self) -> tuple[float, float, float, float]:
        """Left, bottom, width and height of the map as shares of the page."""
        width, height = self.width_in, self.height_in
        bottom = SCALE_BAR_IN + self.legend_in
        return self.left_in / width, bottom / height, self.map_in[0] / width, self.map_in[1] / height

    def title_place(self, above_in: float) -> tuple[float, float]:
        """Where a line of the title starts, `above_in` [inch] over the map, as shares of the page."""
        return self.left_in / self.width_in, (self.height_in - TITLE_IN + above_in) / self.height_in


def lay_out(T_map_base: FloatArray, grid: GridMap, *, n_entries: int) -> Page:
    """Lay out the page around the known map and a trajectory (n, 3), with so many entries in the legend."""
    corners = [finite(T_map_base[:, :2])]
    rows, cols = np.nonzero(np.isfinite(grid.p_occupied))
    if len(rows):
        cells = np.array([[cols.min(), rows.min()], [cols.max() + 1, rows.max() + 1]])
        corners.append(grid.origin + grid.resolution_m * cells)
    points = np.vstack(corners)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.zeros(2))
    extent = np.maximum(high - low + 2.0 * MARGIN_M, MIN_EXTENT_M)
    extent = np.maximum(extent, extent.max() * SHORT_SIDE_IN / LONG_SIDE_IN)
    (x0, y0), (x1, y1) = 0.5 * (low + high - extent), 0.5 * (low + high + extent)
    width, height = (LONG_SIDE_IN * extent / extent.max()).tolist()
    page_width = max(width, 4.0 * LEGEND_ENTRY_IN) + 2.0 * PAD_IN
    n_columns = int((page_width - 2.0 * PAD_IN) / LEGEND_ENTRY_IN)
    return Page(
        x_m=(float(x0), float(x1)),
        y_m=(float(y0), float(y1)),
        map_in=(width, height),
        width_in=page_width,
        n_legend_columns=n_columns,
        n_legend_rows=math.ceil(n_entries / n_columns),
    )


def add_map_axes(figure: "Figure", page: Page, background: npt.NDArray[np.uint8]) -> "Axes":
    """Make the axes of the map on a page."""
    axes = figure.add_axes(page.map_box())
    axes.set(xlim=page.x_m, ylim=page.y_m, xticks=[], yticks=[], facecolor=to_rgb(background))
    for spine in axes.spines.values():
        spine.set(color="0.6", linewidth=0.6)
    return axes


def draw_map(
    axes: "Axes", grid: GridMap, *, max_cells: float, colors: npt.NDArray[np.uint8] = STATE_COLORS
) -> None:
    """Draw the map's three states in `colors` (3, 3), with at most `max_cells` along a side."""
    if grid.p_occupied.size == 0:
        return
    with np.errstate(invalid="ignore"):
        states = np.where(grid.p_occupied > 0.8, OCCUPIED, np.where(grid.p_occupied < 0.2, FREE, UNKNOWN))
    factor = math.ceil(max(1, *states.shape) / max_cells)
    shown = _pool(states.astype(np.uint8), factor)
    size_m = factor * grid.resolution_m * np.array(shown.shape[::-1])
    (x0, y0), (x1, y1) = grid.origin.tolist(), (grid.origin + size_m).tolist()
    limits = axes.get_xlim(), axes.get_ylim()
    axes.imshow(
        colors[shown],
        origin="lower",
        extent=(x0, x1, y0, y1),
        interpolation="nearest",
        aspect="auto",  # the box has the world's shape already
        zorder=0,
    )
    axes.set(xlim=limits[0], ylim=limits[1])


def _pool(states: npt.NDArray[np.uint8], factor: int) -> npt.NDArray[np.uint8]:
    """Shrink by keeping the highest state of each block, so that no wall is lost."""
    n_rows, n_cols = (math.ceil(n / factor) for n in states.shape)
    padded = np.full((n_rows * factor, n_cols * factor), UNKNOWN, dtype=np.uint8)
    padded[: states.shape[0], : states.shape[1]] = states
    return np.asarray(padded.reshape(n_rows, factor, n_cols, factor).max(axis=(1, 3)), dtype=np.uint8)


def draw_scale_bar(axes: "Axes", page: Page) -> None:
    """Draw a bar of a round length below the map's lower left corner."""
    per_in = (page.x_m[1] - page.x_m[0]) / page.map_in[0]
    length_m = _round_below(1.6 * per_in)
    x, y, tick = page.x_m[0], page.y_m[0] - 0.2 * per_in, 0.05 * per_in
    axes.plot(
        [x, x, x, x + length_m, x + length_m, x + length_m],
        [y - tick, y + tick, y, y, y + tick, y - tick],
        color="black",
        linewidth=1.2,
        clip_on=False,
        solid_joinstyle="miter",
    )
    axes.text(x + length_m + 0.08 * per_in, y, f"{length_m:g} m", va="center", fontsize=9, clip_on=False)


def draw_legend(figure: "Figure", page: Page, handles: "Sequence[Artist]") -> None:
    """Draw the legend at the foot of the page."""
    figure.legend(
        handles=list(handles),
        loc="lower center",
        bbox_to_anchor=(0.5, 0.0),
        ncols=min(page.n_legend_columns, len(handles)),
        frameon=False,
        fontsize=9,
        handlelength=1.6,
        columnspacing=1.4,
        borderaxespad=0.3,
    )


def finite(points: FloatArray) -> FloatArray:
    """Keep the points (n, 2) that are known."""
    return points[np.isfinite(points).all(axis=1)]


def to_rgb(color: npt.NDArray[np.uint8]) -> tuple[float, float, float]:
    """Write a colour as matplotlib reads it."""
    red, green, blue = (color / 255.0).tolist()
    return red, green, blue


def _round_below(length: float) -> float:
    """Give the largest of 1, 2, 5 times a power of ten that is not above `length`."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= length * (1.0 + 1e-9))
