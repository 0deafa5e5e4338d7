"""The picture of a run: map, trajectory, loop closures and moving objects, fit for a paper.

Drawn with matplotlib's objects alone: no pyplot, no window, no state that others share.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slammot_graph.colors import (
    COLOR_CLOSURE,
    COLOR_ESTIMATE,
    COLOR_ODOMETRY,
    TRACK_COLORS,
    to_hex,
    track_color,
)
from slammot_graph.drawing import (
    FREE,
    LONG_SIDE_IN,
    OCCUPIED,
    STATE_COLORS,
    UNKNOWN,
    Page,
    add_map_axes,
    draw_legend,
    draw_map,
    draw_scale_bar,
    finite,
    lay_out,
    to_rgb,
)
from slammot_graph.result_types import RunResult

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 200
MAX_NAMED_TRACKS = 12
"""With more tracks than these their numbers would hide the map."""
MAX_HANDLES = 8


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

    page = lay_out(result.T_map_base, result.grid, n_entries=MAX_HANDLES)
    figure = Figure(figsize=(page.width_in, page.height_in), dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    axes = add_map_axes(figure, page, STATE_COLORS[UNKNOWN])
    draw_map(axes, result.grid, max_cells=LONG_SIDE_IN * DPI)
    handles = [
        *_draw_paths(axes, result),
        *_draw_closures(axes, result),
        *_draw_tracks(axes, result),
        *_state_handles(),
    ]
    _draw_title(figure, page, result)
    draw_scale_bar(axes, page)
    draw_legend(figure, page, handles)
    canvas.print_png(str(path))  # type: ignore[no-untyped-call]


# ----------------------------------------------------------------------------------------------- what is drawn


def _draw_paths(axes: "Axes", result: RunResult) -> "list[Artist]":
    odometry, path = finite(result.T_map_odom_base[:, :2]), finite(result.T_map_base[:, :2])
    handles: list[Artist] = []
    if len(path):
        color = to_hex(COLOR_ESTIMATE)
        handles += axes.plot(*path.T, color=color, linewidth=1.1, zorder=4, label="trajectory")
        axes.plot(*path[0], "o", color="white", markeredgecolor=color, markersize=5, zorder=6)
        axes.plot(*path[-1], "s", color=color, markeredgecolor="white", markersize=5, zorder=6)
    if len(odometry):
        handles += axes.plot(
            *odometry.T,
            color=to_hex(COLOR_ODOMETRY),
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
        list(segments), colors=to_hex(COLOR_CLOSURE), linewidths=0.8, zorder=5, label="loop closures"
    )
    axes.add_collection(lines, autolim=False)
    return [lines]


def _draw_tracks(axes: "Axes", result: RunResult) -> "list[Artist]":
    from matplotlib.lines import Line2D

    ids = np.unique(result.tracks[:, 1]).astype(np.int64)
    for track_id in ids.tolist():
        xy = finite(result.tracks[result.tracks[:, 1] == track_id, 2:4])
        if not len(xy):
            continue
        color = to_hex(track_color(track_id))
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
    return [Line2D([], [], color=to_hex(TRACK_COLORS[0]), linewidth=0.9, marker=".", label="moving objects")]


def _state_handles() -> "list[Artist]":
    from matplotlib.patches import Patch

    names = ((OCCUPIED, "occupied"), (FREE, "free"), (UNKNOWN, "unknown"))
    return [
        Patch(facecolor=to_rgb(STATE_COLORS[state]), edgecolor="0.6", linewidth=0.5, label=name)
        for state, name in names
    ]


# ------------------------------------------------------------------------------------------- around the map


def _draw_title(figure: "Figure", page: Page, result: RunResult) -> None:
    def write(text: str, above_in: float, **style: Any) -> None:
        x, y = page.title_place(above_in)
        figure.text(x, y, text, ha="left", va="baseline", **style)

    state = "" if result.is_complete else " (interrupted)"
    write(f"{result.method}{state}", 0.33, fontsize=12, fontweight="bold", parse_math=False)
    n_closures = sum(edge.kind == "closure" for edge in result.edges)
    path_m = float(np.hypot(*np.diff(finite(result.T_map_base[:, :2]), axis=0).T).sum())
    counts = [
        _counted(len(result.stamps), "scan"),
        f"{path_m:,.0f} m",
        *([_counted(len(result.nodes), "node")] if len(result.nodes) else []),
        *([_counted(n_closures, "loop closure")] if len(result.nodes) else []),
        _counted(len(np.unique(result.tracks[:, 1])), "moving object"),
    ]
    write(" · ".join(counts), 0.11, fontsize=9, color="0.3")


# ------------------------------------------------------------------------------------------------ small things


def _counted(n: int, what: str) -> str:
    return f"{n:,} {what}{'' if n == 1 else 's'}"
