"""The picture of a run: map, trajectory, loop closures and moving objects, fit for a paper.

Drawn with matplotlib's objects alone: no pyplot, no window, no state that others share.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slammot_graph.core.results import RunResult
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.viz.colors import (
    COLOR_CLOSURE,
    COLOR_ESTIMATE,
    COLOR_GONE,
    COLOR_MOVED,
    COLOR_NEW,
    COLOR_ODOMETRY,
    to_hex,
    track_color,
)
from slammot_graph.viz.drawing import (
    MAX_MAP_IN,
    STATE_COLORS,
    TEXT_PT,
    TITLE_PT,
    UNKNOWN,
    Entry,
    Limits,
    Page,
    add_map_axes,
    draw_legend,
    draw_map,
    draw_origin,
    draw_scale_bar,
    draw_title,
    find_limits,
    finite,
    lay_out,
    line_artist,
    line_entry,
    origin_entry,
    state_entries,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 330
MAX_NAMED_TRACKS = 12
"""With more tracks than these their numbers would hide the map."""
MANY_CLOSURES = 50
"""More closures than these are drawn as a haze; as plain lines they would hide the map."""
POINT_IN = 0.02
"""Of the moving points within a square of this side on the page [inch] one is drawn."""

PATH: dict[str, Any] = {"color": to_hex(COLOR_ESTIMATE), "linewidth": 1.0}
START: dict[str, Any] = {
    "marker": "o",
    "markersize": 5.5,
    "color": "white",
    "markeredgecolor": to_hex(COLOR_ESTIMATE),
}
END: dict[str, Any] = {
    "marker": "s",
    "markersize": 4.0,
    "color": to_hex(COLOR_ESTIMATE),
    "markeredgecolor": "white",
}
ODOMETRY: dict[str, Any] = {
    "color": to_hex(COLOR_ODOMETRY),
    "linewidth": 0.65,
    "dashes": (4.0, 1.5),
    "alpha": 0.8,
}
POINTS: dict[str, Any] = {
    "color": to_hex(COLOR_MOVED),
    "linestyle": "",
    "marker": ".",
    "markeredgewidth": 0.0,
}
CHANGED: dict[str, dict[str, Any]] = {
    "changed: new": {**POINTS, "color": to_hex(COLOR_NEW)},
    "changed: gone": {**POINTS, "color": to_hex(COLOR_GONE)},
}
TRACK: dict[str, Any] = {"linewidth": 0.8}
LAST_SEEN: dict[str, Any] = {"marker": "o", "markersize": 2.5, "markeredgewidth": 0.0}


def draw_overview(
    result: RunResult,
    path: str | Path,
    *,
    log_name: str | None = None,
    moving_points: FloatArray | None = None,
) -> None:
    """Draw a run as a PNG file.

    Shown are the map in its three states, the optimised trajectory, raw odometry, loop closures, moving points, the
    tracks of moving objects and what has changed since a saved map, seen from above with x to the right. The picture
    ends where the trajectory and the known map do, but for a few stray cells. A track is drawn through the places
    where its object was seen; what the tracker only predicted, between them and after the last, is not.

    Parameters
    ----------
    result : RunResult
        May be of a run without tracks, nodes or map, or of one that was interrupted.
    path : str or Path
        The file, whatever its suffix.
    log_name : str, optional
        For the title.
    moving_points : (k, 2) array, optional
        The end points of all beams that moved by the final labels, at the optimised poses [m, map frame]; a
        `RunResult` does not hold them. Where they lie close, only some are drawn.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    figure = compose_overview(result, log_name=log_name, moving_points=moving_points)
    figure.canvas.print_png(str(path))  # type: ignore[attr-defined]


def compose_overview(
    result: RunResult, *, log_name: str | None = None, moving_points: FloatArray | None = None
) -> "Figure":
    """Compose the figure that `draw_overview` writes, of the same parameters; its canvas is that of Agg."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    limits = find_limits(result.T_map_base, result.grid)
    points = np.empty((0, 2)) if moving_points is None else finite(moving_points)
    points = points[limits.contain(points)]
    page = lay_out(limits, _legend(result, limits, has_points=len(points) > 0))
    figure = Figure(figsize=(page.width_in, page.height_in), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axes = add_map_axes(figure, page, STATE_COLORS[UNKNOWN])
    draw_map(axes, result.grid, max_cells=max(MAX_MAP_IN) * DPI)
    _draw_closures(axes, result)
    _draw_points(axes, page, points)
    for label, places in _changes(result).items():
        axes.plot(*places.T, **CHANGED[label], markersize=3.0, zorder=2, label=label)
    _draw_tracks(axes, result)
    _draw_paths(axes, result)
    if _shows_origin(limits):
        draw_origin(axes, page)
    _draw_title(figure, page, result, log_name)
    draw_scale_bar(axes, page)
    draw_legend(figure, page)
    return figure


# ----------------------------------------------------------------------------------------------- what is drawn


def _draw_closures(axes: "Axes", result: RunResult) -> None:
    from matplotlib.collections import LineCollection

    ends = _closures(result)
    if len(ends):
        lines = LineCollection(list(result.nodes[ends][..., :2]), **_closure_style(len(ends)), zorder=1)
        lines.set_label("loop closures")
        axes.add_collection(lines, autolim=False)


def _draw_points(axes: "Axes", page: Page, points: FloatArray) -> None:
    _, first = np.unique(np.floor(points / (POINT_IN * page.m_per_in)), axis=0, return_index=True)
    axes.plot(*points[np.sort(first)].T, **POINTS, markersize=2.2, zorder=2, label="moving points")


def _draw_tracks(axes: "Axes", result: RunResult) -> None:
    from matplotlib.patheffects import withStroke

    tracks = _tracks(result)
    for track_id, xy in tracks.items():
        color = to_hex(track_color(track_id))
        axes.plot(*xy.T, **TRACK, color=color, zorder=4, label=f"track {track_id}")
        axes.plot(*xy[-1], **LAST_SEEN, color=color, zorder=4)
        if len(tracks) <= MAX_NAMED_TRACKS:
            axes.annotate(
                str(track_id),
                xy[-1].tolist(),
                xytext=(2.5, 2.0),
                textcoords="offset points",
                color=color,
                fontsize=7.0,
                zorder=8,
                annotation_clip=True,
                clip_on=True,
                path_effects=[withStroke(linewidth=1.2, foreground="white")],
            )


def _draw_paths(axes: "Axes", result: RunResult) -> None:
    odometry, path = finite(result.T_map_odom_base[:, :2]), finite(result.T_map_base[:, :2])
    if len(odometry):
        axes.plot(*odometry.T, **ODOMETRY, zorder=3, label="odometry")
    if len(path):
        axes.plot(*path.T, **PATH, zorder=5, label="trajectory")
        axes.plot(*path[0], **START, zorder=7, label="start")
        axes.plot(*path[-1], **END, zorder=7, label="end")


# ------------------------------------------------------------------------------------------------ the legend


def _legend(result: RunResult, limits: Limits, *, has_points: bool) -> list[list[Entry]]:
    """Say what everything in the picture is: the robot, what moves, the map."""
    robot: list[Entry] = []
    if len(finite(result.T_map_base)):
        robot += [
            line_entry("trajectory", **PATH),
            line_entry("start", linestyle="", **START),
            line_entry("end", linestyle="", **END),
        ]
    odometry = finite(result.T_map_odom_base[:, :2])
    if len(odometry):
        is_whole = bool(limits.contain(odometry).all())
        robot.append(line_entry("raw odometry" + ("" if is_whole else " (leaves the picture)"), **ODOMETRY))
    n_closures = len(_closures(result))
    if n_closures:
        style = {**_closure_style(n_closures), "linewidth": 0.6, "alpha": 0.8}  # a line alone must be seen
        robot.append(line_entry("loop closures", **style))
    tracks = _tracks(result)
    moving = [line_entry("moving points", markersize=4.5, **POINTS)] if has_points else []
    moving += [line_entry(label, markersize=4.5, **CHANGED[label]) for label in _changes(result)]
    if tracks:
        moving.append(_track_entry(list(tracks)))
    origin = [origin_entry("map's origin, x and y")] if _shows_origin(limits) else []
    return [robot, moving, [*state_entries(), *origin]]


def _track_entry(ids: list[int]) -> Entry:
    colors = list(dict.fromkeys(track_color(track_id) for track_id in ids))
    shown = [to_hex(color) for color in colors[:3]]
    lines = [line_artist(**TRACK, color=color) for color in shown]
    what = "1 track of a moving object" if len(ids) == 1 else f"{len(ids):,} tracks of moving objects"
    notes = ["a colour each"] if 1 < len(ids) == len(colors) else []
    notes.append("dot and number where last seen" if len(ids) <= MAX_NAMED_TRACKS else "dot where last seen")
    return Entry(tuple(lines), f"{what} ({'; '.join(notes)})")


def _closure_style(n_closures: int) -> dict[str, Any]:
    is_haze = n_closures > MANY_CLOSURES
    return {
        "color": to_hex(COLOR_CLOSURE),
        "linewidth": 0.3 if is_haze else 0.6,
        "alpha": 0.4 if is_haze else 0.7,
    }


# ------------------------------------------------------------------------------------------- around the map


def _draw_title(figure: "Figure", page: Page, result: RunResult, log_name: str | None) -> None:
    on = "" if log_name is None else f" on {log_name}"
    draw_title(figure, page, f"{result.method}{on}", above_in=0.24, size_pt=TITLE_PT, weight="bold")
    path_m = float(np.hypot(*np.diff(finite(result.T_map_base[:, :2]), axis=0).T).sum())
    has_graph = len(result.nodes) > 0
    counts = [
        ("" if result.is_complete else "interrupted after ") + _counted(len(result.stamps), "scan"),
        f"{path_m:,.0f} m",
        *([_counted(len(result.nodes), "node")] if has_graph else []),
        *([_counted(len(_closures(result)), "loop closure")] if has_graph else []),
        _counted(len(_tracks(result)), "track"),
    ]
    draw_title(figure, page, " · ".join(counts), above_in=0.08, size_pt=TEXT_PT).set_color("0.3")


# ------------------------------------------------------------------------------------------------ small things


def _closures(result: RunResult) -> IntArray:
    """(k, 2) nodes that closures join."""
    ends = [(edge.from_node, edge.to_node) for edge in result.edges if edge.kind == "closure"]
    return np.array(ends, dtype=np.int64).reshape(-1, 2)


def _changes(result: RunResult) -> dict[str, FloatArray]:
    """Give the places (k, 2) [m] of what has changed since the map that the run started from, where anything has."""
    places = dict(zip(CHANGED, (result.new_points, result.gone_points), strict=True))
    return {label: points for label, points in places.items() if len(points)}


def _tracks(result: RunResult) -> dict[int, FloatArray]:
    """Give for each track the places (k, 2) [m] where its object was seen; those only predicted are left out."""
    tracks: dict[int, FloatArray] = {}
    seen = result.tracks[result.is_track_seen]
    for track_id in np.unique(seen[:, 1]).astype(np.int64).tolist():
        xy = finite(seen[seen[:, 1] == track_id, 2:4])
        if len(xy):
            tracks[track_id] = xy
    return tracks


def _shows_origin(limits: Limits) -> bool:
    return bool(limits.contain(np.zeros((1, 2))).all())


def _counted(n: int, what: str) -> str:
    return f"{n:,} {what}{'' if n == 1 else 's'}"
