"""The picture of a run: map, trajectory, loop closures and moving objects, fit for a paper.

Drawn with matplotlib's objects alone: no pyplot, no window, no state that others share.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from slammot_graph.recording import COLOR_CLOSURE, COLOR_ESTIMATE, COLOR_ODOMETRY, TRACK_COLORS
from slammot_graph.result_types import GridMap, RunResult
from slammot_graph.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 200
LONG_SIDE_IN = 10.0
"""Long side of the map on the page [inch]; with `DPI` it is also the most cells that are shown."""
SHORT_SIDE_IN = 2.0
LEGEND_ENTRY_IN = 1.4
PAD_IN, TITLE_IN, SCALE_BAR_IN, LEGEND_ROW_IN = 0.15, 0.62, 0.4, 0.24
MARGIN_M = 0.5
MIN_EXTENT_M = 4.0
MAX_NAMED_TRACKS = 12
"""With more tracks than these their numbers would hide the map."""
UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""States of a cell; of several cells in one pixel the highest shows."""
STATE_COLORS = np.array([[222, 225, 228], [255, 255, 255], [25, 25, 30]], dtype=np.uint8)


def draw_overview(result: RunResult, path: str | Path) -> None:
    """Draw a run as a PNG file.

    Shown are the map in its three states, the optimised trajectory, raw odometry, loop closures and the tracks of
    moving objects, seen from above with x to the right; the picture ends where the known map and the trajectory
    do.

    Parameters
    ----------
    result : RunResult
        May be of a run without tracks, nodes or map, or of one that was interrupted.
    path : str or Path
        The file, whatever its suffix.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    page = _page(result)
    figure = Figure(figsize=(page.width_in, page.height_in), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes(page.map_box())
    axes.set(xlim=page.x_m, ylim=page.y_m, xticks=[], yticks=[], facecolor=_rgb(STATE_COLORS[UNKNOWN]))
    for spine in axes.spines.values():
        spine.set(color="0.6", linewidth=0.6)
    _draw_map(axes, result.grid)
    handles = [
        *_draw_paths(axes, result),
        *_draw_closures(axes, result),
        *_draw_tracks(axes, result),
        *_state_handles(),
    ]
    _draw_title(figure, page, result)
    _draw_scale_bar(axes, page)
    _draw_legend(figure, page, handles)
    canvas.print_png(str(path))  # type: ignore[no-untyped-call]


@dataclass(frozen=True, kw_only=True)
class _Page:
    """What part of the world is shown, and where it lies on the page."""

    x_m: tuple[float, float]
    y_m: tuple[float, float]
    map_in: tuple[float, float]
    width_in: float
    n_legend_columns: int
    n_legend_rows: int

    @property
    def legend_in(self) -> float:
        return self.n_legend_rows * LEGEND_ROW_IN + PAD_IN

    @property
    def height_in(self) -> float:
        return TITLE_IN + self.map_in[1] + SCALE_BAR_IN + self.legend_in

    @property
    def left_in(self) -> float:
        return 0.5 * (self.width_in - self.map_in[0])

    def map_box(self) -> tuple[float, float, float, float]:
        """Left, bottom, width and height of the map as shares of the page."""
        width, height = self.width_in, self.height_in
        bottom = SCALE_BAR_IN + self.legend_in
        return self.left_in / width, bottom / height, self.map_in[0] / width, self.map_in[1] / height


def _page(result: RunResult) -> _Page:
    """Lay out the page around the known map and the trajectory."""
    corners = [_finite(result.T_map_base[:, :2])]
    rows, cols = np.nonzero(np.isfinite(result.grid.p_occupied))
    if len(rows):
        cells = np.array([[cols.min(), rows.min()], [cols.max() + 1, rows.max() + 1]])
        corners.append(result.grid.origin + result.grid.resolution_m * cells)
    points = np.vstack(corners)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.zeros(2))
    extent = np.maximum(high - low + 2.0 * MARGIN_M, MIN_EXTENT_M)
    extent = np.maximum(extent, extent.max() * SHORT_SIDE_IN / LONG_SIDE_IN)
    (x0, y0), (x1, y1) = 0.5 * (low + high - extent), 0.5 * (low + high + extent)
    width, height = (LONG_SIDE_IN * extent / extent.max()).tolist()
    page_width = max(width, 4.0 * LEGEND_ENTRY_IN) + 2.0 * PAD_IN
    n_columns = int((page_width - 2.0 * PAD_IN) / LEGEND_ENTRY_IN)
    return _Page(
        x_m=(float(x0), float(x1)),
        y_m=(float(y0), float(y1)),
        map_in=(width, height),
        width_in=page_width,
        n_legend_columns=n_columns,
        n_legend_rows=math.ceil(_MAX_HANDLES / n_columns),
    )


# ----------------------------------------------------------------------------------------------- what is drawn

_MAX_HANDLES = 8


def _draw_map(axes: "Axes", grid: GridMap) -> None:
    with np.errstate(invalid="ignore"):
        states = np.where(grid.p_occupied > 0.8, OCCUPIED, np.where(grid.p_occupied < 0.2, FREE, UNKNOWN))
    factor = math.ceil(max(1, *states.shape) / (LONG_SIDE_IN * DPI))
    shown = _pool(states.astype(np.uint8), factor)
    size_m = factor * grid.resolution_m * np.array(shown.shape[::-1])
    (x0, y0), (x1, y1) = grid.origin.tolist(), (grid.origin + size_m).tolist()
    limits = axes.get_xlim(), axes.get_ylim()
    axes.imshow(
        STATE_COLORS[shown],
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


def _draw_paths(axes: "Axes", result: RunResult) -> "list[Artist]":
    odometry, path = _finite(result.T_map_odom_base[:, :2]), _finite(result.T_map_base[:, :2])
    handles: list[Artist] = []
    if len(path):
        color = _hex(COLOR_ESTIMATE)
        handles += axes.plot(*path.T, color=color, linewidth=1.1, zorder=4, label="trajectory")
        axes.plot(*path[0], "o", color="white", markeredgecolor=color, markersize=5, zorder=6)
        axes.plot(*path[-1], "s", color=color, markeredgecolor="white", markersize=5, zorder=6)
    if len(odometry):
        handles += axes.plot(
            *odometry.T,
            color=_hex(COLOR_ODOMETRY),
            alpha=0.55,
            linewidth=0.8,
            zorder=2,
            label="raw odometry",
        )
    return handles


def _draw_closures(axes: "Axes", result: RunResult) -> "list[Artist]":
    from matplotlib.collections import LineCollection

    ends = [(edge.from_node, edge.to_node) for edge in result.edges if edge.kind == "closure"]
    if not ends:
        return []
    segments = result.nodes[np.array(ends)][..., :2]
    lines = LineCollection(
        list(segments), colors=_hex(COLOR_CLOSURE), linewidths=0.8, zorder=5, label="loop closures"
    )
    axes.add_collection(lines, autolim=False)
    return [lines]


def _draw_tracks(axes: "Axes", result: RunResult) -> "list[Artist]":
    from matplotlib.lines import Line2D

    ids = np.unique(result.tracks[:, 1]).astype(np.int64)
    for track_id in ids.tolist():
        xy = _finite(result.tracks[result.tracks[:, 1] == track_id, 2:4])
        if not len(xy):
            continue
        color = _hex(TRACK_COLORS[track_id % len(TRACK_COLORS)])
        axes.plot(*xy.T, color=color, linewidth=0.9, zorder=3)
        axes.plot(*xy[-1], ".", color=color, markersize=3.5, zorder=3)
        if len(ids) <= MAX_NAMED_TRACKS:
            axes.annotate(
                str(track_id),
                xy[-1].tolist(),
                xytext=(3, 3),
                textcoords="offset points",
                color=color,
                fontsize=7,
                zorder=7,
                annotation_clip=True,
                clip_on=True,
            )
    if not len(ids):
        return []
    return [Line2D([], [], color=_hex(TRACK_COLORS[0]), linewidth=0.9, marker=".", label="moving objects")]


def _state_handles() -> "list[Artist]":
    from matplotlib.patches import Patch

    names = ((OCCUPIED, "occupied"), (FREE, "free"), (UNKNOWN, "unknown"))
    return [
        Patch(facecolor=_rgb(STATE_COLORS[state]), edgecolor="0.6", linewidth=0.5, label=name)
        for state, name in names
    ]


# ------------------------------------------------------------------------------------------- around the map


def _draw_title(figure: "Figure", page: _Page, result: RunResult) -> None:
    def write(text: str, above_in: float, **style: Any) -> None:
        y = (page.height_in - TITLE_IN + above_in) / page.height_in
        figure.text(page.left_in / page.width_in, y, text, ha="left", va="baseline", **style)

    state = "" if result.is_complete else " (interrupted)"
    write(f"{result.method}{state}", 0.33, fontsize=12, fontweight="bold", parse_math=False)
    n_closures = sum(edge.kind == "closure" for edge in result.edges)
    path_m = float(np.hypot(*np.diff(_finite(result.T_map_base[:, :2]), axis=0).T).sum())
    counts = [
        _counted(len(result.stamps), "scan"),
        f"{path_m:,.0f} m",
        *([_counted(len(result.nodes), "node")] if len(result.nodes) else []),
        *([_counted(n_closures, "loop closure")] if len(result.nodes) else []),
        _counted(len(np.unique(result.tracks[:, 1])), "moving object"),
    ]
    write(" · ".join(counts), 0.11, fontsize=9, color="0.3")


def _draw_scale_bar(axes: "Axes", page: _Page) -> None:
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


def _draw_legend(figure: "Figure", page: _Page, handles: "Sequence[Artist]") -> None:
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


# ------------------------------------------------------------------------------------------------ small things


def _finite(points: FloatArray) -> FloatArray:
    return points[np.isfinite(points).all(axis=1)]


def _round_below(length: float) -> float:
    """Give the largest of 1, 2, 5 times a power of ten that is not above `length`."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= length * (1.0 + 1e-9))


def _counted(n: int, what: str) -> str:
    return f"{n:,} {what}{'' if n == 1 else 's'}"


def _hex(rgba: int) -> str:
    return f"#{rgba:08x}"


def _rgb(color: npt.NDArray[np.uint8]) -> tuple[float, float, float]:
    red, green, blue = (color / 255.0).tolist()
    return red, green, blue
