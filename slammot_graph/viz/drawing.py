"""What the overview and the animation share: the page around the map, the map itself, scale bar and legend.

Drawn with matplotlib's objects alone: no pyplot, no window, no state that others share.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from slammot_graph.core.results import FREE_BELOW, OCCUPIED_ABOVE, GridMap
from slammot_graph.core.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Text

MAX_MAP_IN = (6.0, 7.2)
"""Largest width and height of the map on the page [inch]: its text can be read in a column of a paper too."""
MIN_SHAPE = 0.25
"""Least ratio of the map's short side to its long one."""
MIN_WIDTH_IN = 5.0
"""Least width of title and legend [inch]; a longer entry of the legend has no place on a narrow page."""
PAD_IN, TITLE_IN, SCALE_BAR_IN, LEGEND_LINE_IN = 0.1, 0.44, 0.27, 0.19
TITLE_PT, TEXT_PT, LEGEND_PT = 10.0, 8.0, 8.0
HANDLE_EM, HANDLE_GAP_EM, ENTRY_GAP_EM = 2.0, 0.5, 1.5
"""Of the legend, in units of its font size."""
ORIGIN_IN = 0.3
"""Length of the axes at the map's origin [inch]."""
MARGIN_M = 0.5
MIN_EXTENT_M = 4.0
STRAY_SHARE = 2e-4
"""On each side this share of the known cells may lie outside: a few seen far off through a window make no picture."""
UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""States of a cell; of several cells in one pixel the highest shows."""
STATE_COLORS = np.array([[222, 225, 228], [255, 255, 255], [25, 25, 30]], dtype=np.uint8)


class Entry(NamedTuple):
    """An entry of the legend: what is drawn, and what it says; a tuple is drawn side by side."""

    handle: "Artist | tuple[Artist, ...]"
    label: str


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What part of the world is shown [m]."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height."""
        return self.x_m[1] - self.x_m[0], self.y_m[1] - self.y_m[0]

    def contain(self, points: FloatArray) -> BoolArray:
        """(k,) which of the points (k, 2) are shown."""
        low, high = np.array([self.x_m, self.y_m]).T
        return np.asarray(((low <= points) & (points <= high)).all(axis=1))


@dataclass(frozen=True, kw_only=True)
class Page:
    """Where the map and what is around it lie on the page.

    Attributes
    ----------
    limits : Limits
    map_in : (float, float)
        Width and height of the map on the page [inch].
    legend : tuple of lines, each a tuple of Entry
    """

    limits: Limits
    map_in: tuple[float, float]
    legend: tuple[tuple[Entry, ...], ...]

    @property
    def inner_in(self) -> float:
        """Width of title and legend [inch]."""
        return max(self.map_in[0], MIN_WIDTH_IN)

    @property
    def width_in(self) -> float:
        """Width of the page [inch]."""
        return self.inner_in + 2.0 * PAD_IN

    @property
    def legend_in(self) -> float:
        """Height of the legend [inch]."""
        return len(self.legend) * LEGEND_LINE_IN + PAD_IN

    @property
    def height_in(self) -> float:
        """Height of the page [inch]."""
        return TITLE_IN + self.map_in[1] + SCALE_BAR_IN + self.legend_in

    @property
    def m_per_in(self) -> float:
        """Scale of the map [m/inch]."""
        return self.limits.size_m[0] / self.map_in[0]

    def place(self, x_in: float, y_in: float) -> tuple[float, float]:
        """Where a place, from the page's lower left corner [inch], lies as shares of the page."""
        return x_in / self.width_in, y_in / self.height_in

    def map_box(self) -> tuple[float, float, float, float]:
        """Left, bottom, width and height of the map as shares of the page."""
        left_in = 0.5 * (self.width_in - self.map_in[0])
        return *self.place(left_in, SCALE_BAR_IN + self.legend_in), *self.place(*self.map_in)


def find_limits(T_map_base: FloatArray, grid: GridMap) -> Limits:
    """Find the limits around a trajectory (n, 3) and the known map, but for a few stray cells."""
    corners = [finite(T_map_base[:, :2])]
    rows_cols = np.sort(np.nonzero(states_of(grid) != UNKNOWN), axis=1)
    n_cells = rows_cols.shape[1]
    if n_cells:
        n_stray = int(STRAY_SHARE * n_cells)
        cells = rows_cols[::-1, [n_stray, n_cells - 1 - n_stray]].T + np.array([[0], [1]])
        corners.append(grid.origin + grid.resolution_m * cells)
    points = np.vstack(corners)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.zeros(2))
    extent = np.maximum(high - low + 2.0 * MARGIN_M, MIN_EXTENT_M)
    extent = np.maximum(extent, extent.max() * MIN_SHAPE)
    (x0, y0), (x1, y1) = (0.5 * (low + high - extent)).tolist(), (0.5 * (low + high + extent)).tolist()
    return Limits(x_m=(x0, x1), y_m=(y0, y1))


def lay_out(limits: Limits, legend: Sequence[Sequence[Entry]]) -> Page:
    """Lay out the page; each group of the legend begins a line, and goes on in the next where it is too long."""
    (width_m, height_m), (max_width_in, max_height_in) = limits.size_m, MAX_MAP_IN
    in_per_m = min(max_width_in / width_m, max_height_in / height_m)
    page = Page(limits=limits, map_in=(in_per_m * width_m, in_per_m * height_m), legend=())
    lines = tuple(line for group in legend for line in _lines(group, page.inner_in))
    return Page(limits=limits, map_in=page.map_in, legend=lines)


def _lines(group: Sequence[Entry], width_in: float) -> list[tuple[Entry, ...]]:
    lines: list[list[Entry]] = []
    used_in = math.inf
    for entry in group:
        ems = HANDLE_EM + HANDLE_GAP_EM + ENTRY_GAP_EM
        entry_in = text_width_in(entry.label, LEGEND_PT) + ems * LEGEND_PT / 72.0
        if used_in + entry_in - ENTRY_GAP_EM * LEGEND_PT / 72.0 > width_in:
            lines.append([])
            used_in = 0.0
        lines[-1].append(entry)
        used_in += entry_in
    return [tuple(line) for line in lines]


def text_width_in(text: str, size_pt: float, *, weight: str = "normal") -> float:
    """Width of a line of text on the page [inch]."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextToPath

    font = FontProperties(weight=weight, size=size_pt)
    return float(TextToPath().get_text_width_height_descent(text, font, False)[0]) / 72.0


def draw_title(
    figure: "Figure", page: Page, text: str, *, above_in: float, size_pt: float, weight: str = "normal"
) -> "Text":
    """Draw a line of the title, so far over the map; it ends in dots where it is too long for the page.

    The text may hold any name of a file: what the font cannot write becomes a question mark.
    """
    from matplotlib.font_manager import FontProperties, findfont, get_font

    font = get_font(findfont(FontProperties(weight=weight)))
    whole = "".join(sign if font.get_char_index(ord(sign)) else "?" for sign in " ".join(text.split()))
    text = whole
    while len(whole) > 1 and text_width_in(text, size_pt, weight=weight) > page.inner_in:
        whole = whole[:-1]
        text = whole.rstrip() + "…"
    x, y = page.place(PAD_IN, page.height_in - TITLE_IN + above_in)
    return figure.text(x, y, text, fontsize=size_pt, fontweight=weight, parse_math=False)


# --------------------------------------------------------------------------------------------------- the map


def add_map_axes(figure: "Figure", page: Page, background: npt.NDArray[np.uint8]) -> "Axes":
    """Make the axes of the map on a page."""
    axes = figure.add_axes(page.map_box())
    limits = page.limits
    axes.set(xlim=limits.x_m, ylim=limits.y_m, xticks=[], yticks=[], facecolor=to_rgb(background))
    for spine in axes.spines.values():
        spine.set(color="0.6", linewidth=0.5)
    return axes


def states_of(grid: GridMap) -> IntArray:
    """(rows, cols) states of the cells: UNKNOWN, FREE or OCCUPIED."""
    with np.errstate(invalid="ignore"):
        is_free, is_occupied = grid.p_occupied < FREE_BELOW, grid.p_occupied > OCCUPIED_ABOVE
    return np.where(is_occupied, OCCUPIED, np.where(is_free, FREE, UNKNOWN))


def draw_map(
    axes: "Axes", grid: GridMap, *, max_cells: float, colors: npt.NDArray[np.uint8] = STATE_COLORS
) -> None:
    """Draw the map's three states in `colors` (3, 3), with at most `max_cells` along a side."""
    if grid.p_occupied.size == 0:
        return
    states = states_of(grid)
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
    per_in = page.m_per_in
    length_m = _round_below(page.map_in[0] / 5.0 * per_in)
    x, y, tick = page.limits.x_m[0], page.limits.y_m[0] - 0.14 * per_in, 0.035 * per_in
    axes.plot(
        [x, x, x, x + length_m, x + length_m, x + length_m],
        [y - tick, y + tick, y, y, y + tick, y - tick],
        color="black",
        linewidth=1.0,
        clip_on=False,
        solid_joinstyle="miter",
    )
    text_x = x + length_m + 0.06 * per_in
    axes.text(text_x, y, f"{length_m:g} m", va="center_baseline", fontsize=TEXT_PT, clip_on=False)


def draw_origin(axes: "Axes", page: Page) -> None:
    """Draw the axes of the map's frame at its origin."""
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.patheffects import withStroke

    length = ORIGIN_IN * page.m_per_in
    for name, x, y in (("x", length, 0.0), ("y", 0.0, length)):
        arrow = FancyArrowPatch(
            (0.0, 0.0), (x, y), arrowstyle="->", mutation_scale=5.0, shrinkA=0.0, shrinkB=0.0, linewidth=0.8
        )
        arrow.set(zorder=5, color="black", path_effects=[withStroke(linewidth=2.0, foreground="white")])
        axes.add_patch(arrow)
        axes.text(
            1.2 * x,
            1.2 * y,
            name,
            ha="center",
            va="center",
            fontsize=6.5,
            zorder=5,
            clip_on=True,
            path_effects=[withStroke(linewidth=1.5, foreground="white")],
        )


# ------------------------------------------------------------------------------------------------ the legend


def draw_legend(figure: "Figure", page: Page) -> None:
    """Draw the legend at the foot of the page, flush with its left."""
    from matplotlib.legend_handler import HandlerTuple

    for number, line in enumerate(page.legend):
        figure.legend(
            handles=[entry.handle for entry in line],
            labels=[entry.label for entry in line],
            loc="center left",
            bbox_to_anchor=page.place(PAD_IN, page.legend_in - (number + 0.5) * LEGEND_LINE_IN),
            ncols=len(line),
            frameon=False,
            fontsize=LEGEND_PT,
            handlelength=HANDLE_EM,
            handletextpad=HANDLE_GAP_EM,
            columnspacing=ENTRY_GAP_EM,
            borderpad=0.0,
            borderaxespad=0.0,
            handler_map={tuple: HandlerTuple(ndivide=None, pad=0.0)},
        )


def line_artist(**style: Any) -> "Artist":
    """Make a line or a marker for the legend, in the style of `axes.plot`."""
    from matplotlib.lines import Line2D

    return Line2D([], [], **style)


def line_entry(label: str, **style: Any) -> Entry:
    """Make an entry of the legend for a line or a marker, in the style of `axes.plot`."""
    return Entry(line_artist(**style), label)


def state_entries(colors: npt.NDArray[np.uint8] = STATE_COLORS, *, map_name: str = "") -> list[Entry]:
    """Make the entries of the map's three states."""
    from matplotlib.patches import Patch

    names = ((FREE, "free"), (UNKNOWN, "unknown"), (OCCUPIED, "occupied"))
    return [
        Entry(Patch(facecolor=to_rgb(colors[state]), edgecolor="0.6", linewidth=0.5), f"{map_name}{name}")
        for state, name in names
    ]


def origin_entry(label: str) -> Entry:
    """Make the entry of the axes at the map's origin."""
    from matplotlib.path import Path

    tips = [(0.0, 1.0), (-0.25, 0.7), (0.25, 0.7), (1.0, 0.0), (0.7, 0.25), (0.7, -0.25)]
    marker = Path(
        [(0.0, 1.0), (0.0, 0.0), (1.0, 0.0), tips[1], tips[0], tips[2], tips[4], tips[3], tips[5]],
        [Path.MOVETO, Path.LINETO, Path.LINETO, *(2 * [Path.MOVETO, Path.LINETO, Path.LINETO])],
    )
    return line_entry(
        label,
        linestyle="",
        marker=marker,
        markersize=9.0,
        markerfacecolor="none",
        markeredgecolor="black",
        markeredgewidth=0.8,
    )


# -------------------------------------------------------------------------------------------------- small things


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
