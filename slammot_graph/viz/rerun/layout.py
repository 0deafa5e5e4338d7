"""How a recording of a run looks: styles, logged once, and the layout of the views."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from slammot_graph.core.results import ClosureStatus, RunResult
from slammot_graph.viz.colors import (
    COLOR_BEFORE,
    COLOR_CLOSURE,
    COLOR_ESTIMATE,
    COLOR_MATCH,
    COLOR_MOVED,
    COLOR_MOVING,
    COLOR_ODOMETRY,
    COLOR_STATIC,
    COLOR_TRUTH,
)
from slammot_graph.viz.rerun.primitives import (
    MIN_FRAME_M,
    Frame,
    at_all_times,
    collapsed_panels,
    plot_pair,
    plot_view,
    until_cursor,
    view_from_above,
)

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

TRAIL_SCANS = 150
"""How long tracks stay visible behind the cursor [scans]."""
MOVING_SCANS = 40
"""How long moving points stay visible behind the cursor [scans]."""
RECENT_SCANS = 600
"""How long what the nodes saw stays visible behind the cursor [scans]: the map is drawn anew less often."""
SHIFT_SCANS = 30
"""How long a closure, and the graph as it was before, stay visible behind the cursor [scans]."""
GRAPH_VIEW_SCALE = 20.0
"""Units of the graph view in a metre, so that its nodes do not cover each other."""
LABELS_BELOW_M = 30.0
"""In a larger map the tracks' numbers would cover each other; beside the robot they are always shown."""
NIS_SHOWN = (10.0, 20.0)
"""The plot of the NIS ends between these; a few matches lie far above."""
ATTEMPT_COLORS: Mapping[ClosureStatus, int] = {
    "accepted": 0x2CA02CFF,
    "waiting": 0xFFA000FF,
    "refused": 0x8C8C8CFF,
    "outlier": 0xD62728FF,
}

STATE_COLORS: Mapping[str, Mapping[str, int]] = {
    "match": {"converged": 0x4CAF50FF, "degenerate": 0xF2A900FF, "failed": COLOR_MOVING, "none": 0x777777FF},
    "health": {
        "healthy": 0x4CAF50FF,
        "degenerate": 0xF2A900FF,
        "contradiction": 0xC2185BFF,
        "lost": COLOR_MOVING,
        "recovered": 0x2196F3FF,
    },
}

STATIC, MOVING, DOUBTFUL = 1, 2, 3
"""Classes of points; doubtful are those called static although they more probably moved."""
COLOR_DOUBTFUL, COLOR_RECENT = 0xF2A900FF, 0x4A4A4AFF
COLOR_POSE_COV = 0x003A70FF

LINE_COLORS = {
    "count/moving": COLOR_MOVING,
    "count/static": COLOR_STATIC,
    "count/valid": 0x999999FF,
    "tracks/tracks": COLOR_ODOMETRY,
    "nis/nis": COLOR_MATCH,
    "nis/bound_95": COLOR_MOVING,
    "timing/step": 0xEEEEEE50,
    "timing/predict": 0xF0E442FF,
    "timing/match": COLOR_MATCH,
    "timing/detect": COLOR_MOVING,
    "timing/graph": COLOR_ODOMETRY,
    "timing/map": COLOR_TRUTH,
    "timing/objects": COLOR_CLOSURE,
    "error_m/distance": COLOR_TRUTH,
    "error_deg/turn": COLOR_TRUTH,
    **{f"{group}/in_map": COLOR_ESTIMATE for group in ("std_m", "std_deg")},
    **{f"{group}/relative": COLOR_ODOMETRY for group in ("std_m", "std_deg")},
    "residual/residual_m": COLOR_MATCH,
    "inliers/inlier_ratio": COLOR_MATCH,
}

LINE_WIDTHS = {"timing/step": 0.6}
"""It lies above those of its stages and must not hide them."""


def log_style(rec: "rr.RecordingStream") -> None:
    """Log once what never changes: classes, colours, sizes, the robot's body."""
    import rerun as rr

    def style(path: str, *what: "rr.AsComponents") -> None:
        rec.log(path, what[0], *what[1:], static=True)

    def line(path: str, color: int, width: float) -> None:
        style(path, rr.LineStrips3D.from_fields(colors=color, radii=rr.Radius.ui_points(width)))

    def ellipses(path: str, color: int | None, mode: "rr.components.FillMode", width: float = 0.7) -> None:
        width_ui = rr.Radius.ui_points(width)
        style(path, rr.Ellipsoids3D.from_fields(colors=color, line_radii=width_ui, fill_mode=mode))

    classes = [
        (STATIC, "static", COLOR_STATIC),
        (MOVING, "moving", COLOR_MOVING),
        (DOUBTFUL, "static, p_moving above one half", COLOR_DOUBTFUL),
    ]
    style("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, rr.AnnotationContext(classes))
    style("/world/robot/scan", rr.Points3D.from_fields(radii=rr.Radius.ui_points(2.5)))
    body = rr.Arrows3D(
        vectors=[[0.6, 0.0, 0.0]], origins=[[0.0, 0.0, 0.09]], colors=COLOR_ESTIMATE, radii=0.05
    )
    style("/world/robot/body", body)
    line("/world/estimate/graph_path", COLOR_ESTIMATE, 2.0)
    line("/world/estimate/path", COLOR_ESTIMATE, 0.8)
    line("/world/odom/path", COLOR_ODOMETRY, 1.0)
    line("/world/truth/path", COLOR_TRUTH, 3.0)  # it shows beside an estimate that lies on it
    line("/world/final/path", COLOR_ESTIMATE, 2.0)
    wire = rr.components.FillMode.MajorWireframe
    ellipses("/world/estimate/cov", COLOR_POSE_COV, wire, 1.2)
    ellipses("/world/ellipses/moving", COLOR_MOVING, wire)
    ellipses("/world/ellipses/static", COLOR_STATIC, wire, 0.5)
    ellipses("/world/tracks/cov", COLOR_DOUBTFUL, wire)
    for path, color, size in (
        ("/world/moving/points", COLOR_MOVED, 1.2),
        ("/world/map/recent", COLOR_RECENT, 1.0),
        ("/world/anchor", COLOR_POSE_COV, 5.0),
    ):
        radii = rr.Radius.ui_points(size)
        style(path, rr.Points3D.from_fields(colors=color, radii=radii, show_labels=False))
    style("/world/tracks/centre", rr.Points3D.from_fields(radii=rr.Radius.ui_points(5.0)))
    # of their own, since a label has the colour of its point, and a dark one cannot be read
    number = rr.Points3D.from_fields(colors=0xFFFFFFFF, radii=rr.Radius.ui_points(0.5), show_labels=True)
    style("/world/tracks/number", number)
    style("/world/tracks/velocity", rr.Arrows3D.from_fields(radii=rr.Radius.ui_points(1.2)))
    style("/world/tracks/trail", rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(1.5)))
    style(
        "/world/graph/nodes",
        rr.Points3D.from_fields(colors=COLOR_ESTIMATE, radii=rr.Radius.ui_points(2.5)),
    )
    line("/world/graph/odometry", COLOR_ODOMETRY, 0.8)
    line("/world/graph/match", COLOR_MATCH, 1.2)
    line("/world/graph/closure", COLOR_CLOSURE, 1.5)
    for status, color in ATTEMPT_COLORS.items():
        line(closure_path(status), color, 1.0 if status == "refused" else 2.5)
        style(closure_path(status), rr.LineStrips3D.from_fields(show_labels=False))
    line("/world/closures/graph_before", COLOR_BEFORE, 1.5)
    for name, states in STATE_COLORS.items():
        colors = np.array(list(states.values()), np.uint32)
        style(f"/state/{name}", rr.StateConfiguration(values=list(states), colors=colors))


def make_blueprint(
    of_map: Frame, of_scan: Frame, of_graph: Frame, *, has_truth: bool, tops: Mapping[str, float]
) -> "rrb.Blueprint":
    """Lay out the views; the map, the scan and the graph are seen from above, each within its frame.

    `tops` is where plots end, by their group; the others, and those not named yet, show all.
    """
    import rerun as rr
    import rerun.blueprint as rrb

    trails = {
        "/world/estimate/path": until_cursor(),
        "/world/odom/path": until_cursor(),
        "/world/truth/path": until_cursor(),
        "/world/tracks/trail": until_cursor(TRAIL_SCANS),
        "/world/moving/points": until_cursor(MOVING_SCANS),
        "/world/map/recent": until_cursor(RECENT_SCANS),
    }
    of_closures = {
        closure_path("accepted"): until_cursor(SHIFT_SCANS),
        "/world/closures/graph_before": until_cursor(SHIFT_SCANS),
    }
    map_view = view_from_above(
        "Map",
        "/world",
        ["+ /world/**", "- /world/graph/**", "+ /world/graph/closure", "- /world/final/**", "- /world/cells"],
        of_map.eye(1.1),
        overrides={
            **trails,
            **of_closures,
            closure_path("refused"): rrb.EntityBehavior(visible=False),
            "/world/tracks/number": rr.Points3D.from_fields(show_labels=of_map.extent_m < LABELS_BELOW_M),
        },
    )
    graph_map = view_from_above(
        "Graph on the map",
        "/world",
        [f"/world/{name}" for name in ("map/grid", "graph/**", "closures/**", "estimate/way", "final/**")],
        of_map.eye(1.1),
        {
            **of_closures,
            closure_path("refused"): rrb.EntityBehavior(visible=False),
            "/world/estimate/graph_path": rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(0.6)),
        },
    )
    scan_view = view_from_above(
        "Scan, robot's frame",
        "/world/robot",
        [f"/world/{name}/**" for name in ("robot", "ellipses", "tracks", "moving", "map", "cells")],
        of_scan.eye(1.7, ahead_is_up=True),
        {path: what for path, what in trails.items() if "path" not in path},
    )
    across = 0.55 * GRAPH_VIEW_SCALE * max(of_graph.width_m, MIN_FRAME_M)
    up = 0.55 * GRAPH_VIEW_SCALE * max(of_graph.height_m, MIN_FRAME_M)
    x, y = (GRAPH_VIEW_SCALE * of_graph.centre).tolist()
    graph_view = rrb.GraphView(
        origin="/graph",
        name="Graph",
        visual_bounds=rrb.VisualBounds2D(x_range=(x - across, x + across), y_range=(-y - up, -y + up)),
    )
    plots: list[rrb.View | rrb.Container] = [
        plot_view("NIS of the match, 95% bound", "nis", top=tops.get("nis")),
        rrb.Horizontal(
            plot_view("Points", "count", top=tops.get("count")),
            plot_view("Tracks", "tracks", has_legend=False),
            name="Points and tracks",
        ),
        plot_view("Time per stage [ms]", "timing", top=tops.get("timing")),
        plot_pair(
            "Uncertainty (relative: of the test)",
            ("Position std [m]", "std_m"),
            ("Heading std [degrees]", "std_deg"),
        ),
        plot_pair("Match", ("Residual [m]", "residual"), ("Share of inliers", "inliers"), has_legend=False),
    ]
    if has_truth:
        plots.append(
            plot_pair(
                "Error",
                ("Distance from the truth [m]", "error_m"),
                ("Turn [degrees]", "error_deg"),
                has_legend=False,
            )
        )
    texts = [
        rrb.TextDocumentView(origin="/doc/config", name="Legend and configuration"),
        rrb.TextLogView(
            origin="/log",
            name="Events",
            columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"]),
        ),
        rrb.TextDocumentView(origin="/doc/summary", name="Summary"),
    ]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Tabs(map_view, graph_map, active_tab=0),
            rrb.Vertical(
                rrb.Tabs(scan_view, graph_view, active_tab=0),
                rrb.Tabs(*plots, active_tab=0),
                rrb.StateTimelineView(
                    origin="/state", name="State of match and health", time_view=at_all_times()
                ),
                rrb.Tabs(*texts, active_tab=0),
                row_shares=[10, 8, 3, 6],
            ),
            column_shares=[3, 2],
        ),
        *collapsed_panels(),
    )


def closure_path(status: ClosureStatus) -> str:
    """Name the entity of the closures of a status."""
    return f"/world/closures/{status.replace(' ', '_')}"


def plot_tops(result: RunResult) -> dict[str, float]:
    """Say where plots end, by their group, so that a few scans do not squeeze all others."""
    step_ms = result.stage_ms.get("step", np.empty(0))
    # the first scans take long, since kernels are loaded
    slow_ms = float(np.nanpercentile(step_ms, 99.0)) if np.isfinite(step_ms).any() else 0.0
    nis = np.max(result.nis, where=np.isfinite(result.nis), initial=0.0)
    n_points = np.count_nonzero(result.is_valid, axis=1).max(initial=0)
    tops = {
        "timing": 1.2 * slow_ms,
        "nis": float(np.clip(1.1 * nis, *NIS_SHOWN)),
        "count": 1.4 * float(n_points),  # the legend is above the lines
    }
    return {group: top for group, top in tops.items() if top > 0.0}
