"""The recording of a run for the rerun viewer; rerun is imported only when recording.

Steps are kept and sent as columns, many scans at a time: one call per scan and entity would cost more than
the step itself. Everything in the map frame lies at z = 0 but for small offsets that order the layers.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, get_args

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.results import (
    ClosureStatus,
    EdgeKind,
    GraphEdge,
    GridMap,
    RunResult,
    StepResult,
    TrackState,
)
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
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
    track_color,
)
from slammot_graph.viz.rerun.primitives import (
    MIN_FRAME_M,
    Frame,
    Sink,
    Times,
    at_all_times,
    at_height,
    cell_colors,
    cell_columns,
    collapsed_panels,
    grid_map,
    plot_pair,
    plot_view,
    until_cursor,
    view_from_above,
    view_of,
    yaw_quaternion,
)

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

SCANS_PER_SEND = 100
SCANS_PER_SEND_LIVE = 10
STATIC_ELLIPSE_EVERY = 10
"""Of the static beams only one in so many shows its ellipse; every moving one does."""
TRAIL_SCANS = 150
"""How long tracks stay visible behind the cursor [scans]."""
MOVING_SCANS = 40
"""How long moving points stay visible behind the cursor [scans]."""
RECENT_SCANS = 600
"""How long what the nodes saw stays visible behind the cursor [scans]: the map is drawn anew less often."""
SHIFT_SCANS = 30
"""How long a closure, and the graph as it was before, stay visible behind the cursor [scans]."""
MAX_WAY_NODES = 1000
"""Longer graphs are thinned to about so many nodes where they are drawn as a line."""
MAX_VIEW_NODES = 300
"""The graph view shows the shape of the graph, thinned to about so many nodes."""
GRAPH_VIEW_SCALE = 20.0
"""Units of the graph view in a metre, so that its nodes do not cover each other."""
LABELS_BELOW_M = 30.0
"""In a larger map the tracks' numbers would cover each other; beside the robot they are always shown."""
MAP_SHARE, GRAPH_SHARE = 0.15, 0.10
"""What maps and graphs may add to the bytes of the scans: the larger they grow, the rarer they are logged."""
MAP_HEAD_START, GRAPH_HEAD_START = 1 << 20, 1 << 18
"""How many bytes more, so that a run's beginning has its maps and graphs before its first scans are sent."""
CELLS_HALF_SIDE_M = 10.0
"""How far to each side of the robot cells of the test can be shown, along the axes of the local frame."""
CELLS_MARGIN_M = 1.0
"""How far around the moving points they are shown."""
CELLS_HEIGHT_M = -0.045
"""Above the map, below all else."""
CELLS_SHARE, CELLS_HEAD_START = 1.0, 4 << 20
"""What they may add to the bytes of the scans, neither compressed, and how many bytes more."""
RENEWAL_SHARE = 0.1
"""Maps and graphs are logged when the run has grown by this share: all of them together cost a fixed time a scan."""
NIS_BOUND_95 = 7.81
"""95% of a chi-square with 3 degrees of freedom."""
NIS_SHOWN = (10.0, 20.0)
"""The plot of the NIS ends between these; a few matches lie far above."""
SIGMAS_95 = 2.448
"""Semi-axis of a 95% ellipse in the plane, in standard deviations."""

ATTEMPT_COLORS: Mapping[ClosureStatus, int] = {
    "accepted": 0x2CA02CFF,
    "waiting": 0xFFA000FF,
    "refused": 0x8C8C8CFF,
    "outlier": 0xD62728FF,
}

STATIC, MOVING, DOUBTFUL = 1, 2, 3
"""Classes of points; doubtful are those called static although they more probably moved."""
COLOR_DOUBTFUL, COLOR_RECENT = 0xF2A900FF, 0x4A4A4AFF
COLOR_POSE_COV = 0x003A70FF
COLOR_CELLS = (0xCFC4E6FF, 0xD5EFD0FF, 0xD0B080FF)
"""Of cells of the test: unknown, free, occupied; light, so that points and ellipses stand out."""

LEGEND = """
| in the map | |
|---|---|
| white to grey, black | free, the whiter the surer; occupied |
| grey-green | not known |
| small dark points | what the graph's nodes saw lately, also where the map is not yet drawn |
| blue points | the scan's static points |
| amber points | static by the decision, though `p_moving` is above one half |
| red points, red ellipses | points that move, with the 95% covariance that the test used |
| light red points | those of the last scans |
| pale green, tan, lilac squares | around moving points: free, occupied, unknown cells of the test's own grid |
| | as the scan before left them, so the test saw them; in the view of the scan only |
| thin blue ellipses | the same covariance of every tenth static point |
| blue line | the way through the graph's nodes as they are now |
| thin blue line, dark blue ellipse | each scan's place as it was estimated then, 95% of the robot's position |
| dark blue dot on the path | the scan that the local map hangs on |
| orange line | raw odometry, started at the same place |
| green line | truth, where it is known |
| points with arrows | tracks with their velocity and 95% ellipse, numbered where there is room |
| pink lines | loop closures of the graph |
| green, amber, red lines | those just accepted, held back, taken back, for some scans |
| grey lines | those last refused, hidden unless you switch `closures/refused` on |
| brown line | for some scans: the graph before a closure |

Zoom in on a red ellipse in the scan's view to see the cells that it covers. Click a point, or an ellipse, twice to
read its `beam`, `p_moving`, the `reason` of the decision and the semi-axes of its 95% ellipse; click a loop closure to
read why. The panel for it opens with the button at the top right.
"""


class RunLog(Protocol):
    """Where a run shows what it does, step by step."""

    @property
    def wants_map(self) -> bool:
        """Whether a map is due now; ask before making one."""

    @property
    def wants_cells(self) -> bool:
        """Whether the cells of the moving-point test are due; ask before each `log_step`, also for the one after it."""

    @property
    def wants_graph(self) -> bool:
        """Whether the graph is due now; ask before collecting it."""

    @property
    def wants_nodes(self) -> bool:
        """Whether a closure has moved the nodes; ask before collecting them, and after a graph that is due."""

    def log_step(self, step: StepResult) -> None:
        """Log one scan's outcome, of every scan from the first; its arrays must not change afterwards."""

    def log_cells(self, cells: GridMap, T_map_local: FloatArray, limits: tuple[float, float]) -> None:
        """Keep the test's grid around the robot as a step left it; call it before that step's `log_step`.

        The test of a scan sees the grid as the scan before left it. So `log_step` shows the cells that were kept
        with the step before, where its own `T_map_local` places them.

        Parameters
        ----------
        cells : GridMap
            In the local frame.
        T_map_local : (3,) array
            Pose of the local frame in the map.
        limits : (float, float)
            Below the first probability a cell is free, above the second occupied, between them unknown.
        """

    def log_map(self, grid: GridMap) -> None:
        """Log the map as it is after the last step."""

    def log_graph(self, nodes: FloatArray, edges: Sequence[GraphEdge]) -> None:
        """Log the graph as it is after the last step: node poses (m, 3) in the map frame, and edges."""

    def log_nodes(self, nodes: FloatArray) -> None:
        """Log what the last closure did to the nodes: their poses (m, 3) as they are after the last step."""

    def finish(self, result: RunResult) -> None:
        """Log the whole run's outcome: final trajectory, map, graph and figures."""

    def close(self) -> None:
        """Send what is still kept and close; may be called twice."""


class NoRunLog:
    """The log of a run that is not recorded: does nothing and does not import rerun."""

    wants_cells = False
    wants_map = False
    wants_graph = False
    wants_nodes = False

    def log_step(self, step: StepResult) -> None:
        """Do nothing."""

    def log_cells(self, cells: GridMap, T_map_local: FloatArray, limits: tuple[float, float]) -> None:
        """Do nothing."""

    def log_map(self, grid: GridMap) -> None:
        """Do nothing."""

    def log_graph(self, nodes: FloatArray, edges: Sequence[GraphEdge]) -> None:
        """Do nothing."""

    def log_nodes(self, nodes: FloatArray) -> None:
        """Do nothing."""

    def finish(self, result: RunResult) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class RerunLog:
    """Records a run with rerun, into a file or a live viewer.

    Parameters
    ----------
    path : Path or None
        The recording to write (``run.rrd``).
    spawn : bool
        Open a viewer and stream to it instead; exactly one of `path` and `spawn`.
    method : str
    config : mapping
        The run's configuration, shown as a text.

    Raises
    ------
    InputError
        If the file cannot be written or no viewer can be opened; later also from any other method.
    """

    def __init__(
        self, *, path: Path | None = None, spawn: bool = False, method: str, config: Mapping[str, Any]
    ) -> None:
        self._sink = Sink(f"slammot_graph {method}", path=path, spawn=spawn)
        self._rec = self._sink.rec
        self._scans_per_send = SCANS_PER_SEND_LIVE if spawn else SCANS_PER_SEND
        self._steps: list[StepResult] = []
        self._patches: list[_Patch | None] = []  # one a step
        self._cells: _Cells | None = None  # as the step that comes next left them
        self._cells_before: _Cells | None = None  # as the last step left them
        self._tried: list[_Tried] = []
        self._nodes: list[FloatArray] = []  # as they were last told, or else as each was when it was added
        self._nodes_before: FloatArray | None = None
        self._closures: dict[tuple[int, int], None] = {}  # between which nodes, as far as was told
        self._last_step: StepResult | None = None
        self._sent = _Sent()
        self._budget = {
            "map": _Budget(MAP_SHARE, 20, head_start=MAP_HEAD_START),
            "graph": _Budget(GRAPH_SHARE, 20, head_start=GRAPH_HEAD_START),
            "cells": _Budget(CELLS_SHARE, 1, renewal=0.0, head_start=CELLS_HEAD_START),
        }
        self._scan_boxes: list[FloatArray] = []
        self._n_scans = 0
        self._is_open = True
        with self._sink.errors():
            _log_style(self._rec)
            self._sink.log_text(
                "/doc/config", f"{LEGEND}\n## Configuration of {method}\n{_config_table(config)}"
            )

    @property
    def wants_map(self) -> bool:
        """Whether a map is due now."""
        return self._budget["map"].is_due(self._n_scans, self._sent.n_bytes)

    @property
    def wants_cells(self) -> bool:
        """Whether the cells of the moving-point test are due."""
        return self._budget["cells"].is_due(self._n_scans, self._sent.n_bytes)

    @property
    def wants_graph(self) -> bool:
        """Whether the graph is due now."""
        return self._budget["graph"].is_due(self._n_scans, self._sent.n_bytes)

    @property
    def wants_nodes(self) -> bool:
        """Whether a closure has moved the nodes and nobody has said where to."""
        return self._nodes_before is not None

    def log_step(self, step: StepResult) -> None:
        """Keep one step; a batch of them is sent at a time."""
        if self._last_step is None:
            with self._sink.errors():
                self._scan_boxes.append(_box(step.scan.points_base()[step.is_valid]))
                frame = Frame(step.T_map_base[:2], 15.0, 15.0)
                self._send_blueprint(frame, frame, has_truth=_has_truth(step), tops={"nis": max(NIS_SHOWN)})
        self._follow_graph(step)
        self._steps.append(step)
        self._patches.append(self._cut_patch(step))
        self._last_step = step
        self._n_scans += 1
        if len(self._steps) >= self._scans_per_send:
            self._send_steps()

    def log_cells(self, cells: GridMap, T_map_local: FloatArray, limits: tuple[float, float]) -> None:
        """Keep the test's grid around the robot as the step that is logged next left it."""
        self._cells = _Cells(cells, T_map_local, limits)

    def log_map(self, grid: GridMap) -> None:
        """Log the map as it is after the last step."""
        if grid.p_occupied.size == 0:
            return
        with self._sink.errors():
            self._set_time()
            self._rec.log("/world/map/grid", grid_map(grid))
        self._budget["map"].spend(self._n_scans, grid.p_occupied.size / 8)

    def log_graph(self, nodes: FloatArray, edges: Sequence[GraphEdge]) -> None:
        """Log the graph as it is after the last step."""
        import rerun as rr

        ends = {
            kind: [(e.from_node, e.to_node) for e in edges if e.kind == kind] for kind in get_args(EdgeKind)
        }
        self._closures = dict.fromkeys(ends.pop("closure"))
        with self._sink.errors():
            self._set_time()
            self._rec.log("/world/graph/nodes", rr.Points3D(at_height(nodes[:, :2], 0.01)))
            for kind, pairs in ends.items():
                self._rec.log(f"/world/graph/{kind}", _edges(nodes, pairs))
            self._log_graph_view(nodes, edges)
        self._budget["graph"].spend(self._n_scans, 12.0 * len(nodes) + 24.0 * len(edges))
        self.log_nodes(nodes)

    def log_nodes(self, nodes: FloatArray) -> None:
        """Log the way through the nodes and the closures between them, and what the last closure did to them."""
        import rerun as rr

        self._nodes = list(nodes)
        before, self._nodes_before = self._nodes_before, None
        ways = [("/world/estimate/way", nodes, 0.024)]
        if before is not None:
            # below the way, so that it shows where that has moved
            ways.append(("/world/closures/graph_before", before, 0.017))
        with self._sink.errors():
            self._set_time()
            for path, poses, z in ways:
                if len(poses) > 1:
                    way = at_height(poses[None, _thinned(len(poses), MAX_WAY_NODES), :2], z)
                    self._rec.log(path, rr.LineStrips3D(way))
            self._rec.log("/world/graph/closure", _edges(nodes, list(self._closures)))

    def finish(self, result: RunResult) -> None:
        """Log the final trajectory, map, graph and figures, and a layout that fits the final map."""
        import rerun as rr

        self._send_steps()
        self.log_map(result.grid)
        self.log_graph(result.nodes, result.edges)
        with self._sink.errors():
            self._set_time()
            if len(result.stamps):
                path = at_height(result.T_map_base[None, :, :2], 0.03)
                self._rec.log("/world/final/path", rr.LineStrips3D(path))
                has_truth = self._last_step is not None and _has_truth(self._last_step)
                frame = view_of(result.T_map_base, result.grid)
                of_graph = _frame_of(result.nodes) if len(result.nodes) else frame
                self._send_blueprint(frame, of_graph, has_truth=has_truth, tops=_tops(result))
            self._sink.log_text("/doc/summary", _summary(result))

    def close(self) -> None:
        """Send what is still kept, wait until it is written, and close."""
        if not self._is_open:
            return
        self._is_open = False
        try:
            self._send_steps()
            self._sink.flush()
        finally:
            self._rec.disconnect()

    def _follow_graph(self, step: StepResult) -> None:
        """Keep the nodes' poses, and between which of them a closure was tried.

        The pose of a step that closes a loop is the corrected one already; its node is put where it was before.
        """
        has_closed = any(attempt.status == "accepted" for attempt in step.closures)
        if step.node is not None:
            last = self._last_step
            self._nodes.append(_uncorrected(last, step) if has_closed and last else step.T_map_base)
        for attempt in step.closures:
            if attempt.status == "accepted":
                self._closures[attempt.target_node, attempt.source_node] = None
            elif attempt.status == "outlier":
                self._closures.pop((attempt.target_node, attempt.source_node), None)
        if step.closures:
            ends = [
                (self._nodes[attempt.target_node], self._nodes[attempt.source_node])
                for attempt in step.closures
            ]
            self._tried.append(_Tried(step, np.array(ends)[..., :2]))
        if has_closed and self._nodes_before is None:
            self._nodes_before = np.array(self._nodes)

    def _cut_patch(self, step: StepResult) -> "_Patch | None":
        """Cut out the cells that the test saw around a step's moving points; None where there are none of either."""
        before, now = self._cells_before, self._cells
        self._cells_before, self._cells = now, None
        if before is None or now is None or self._last_step is None or not step.is_moving.any():
            return None
        points = step.scan.points(se2.between(now.T_map_local, step.T_map_base))[step.is_moving]
        cells = _around(before.grid, points)
        if cells.p_occupied.size == 0:
            return None
        corner = se2.transform(now.T_map_local, cells.origin[None])[0]
        patch = _Patch(
            colors=cell_colors(cells, before.limits, COLOR_CELLS),
            T_map_corner=np.append(corner, now.T_map_local[2]),
            resolution_m=cells.resolution_m,
            after_scan=self._last_step.scan.index,
        )
        self._budget["cells"].spend(self._n_scans, patch.colors.nbytes)
        return patch

    # ---------------------------------------------------------------- sending

    def _send_steps(self) -> None:
        """Send all kept steps as columns."""
        if not self._steps:
            return
        steps, self._steps = self._steps, []
        patches, self._patches = self._patches, []
        with self._sink.errors():
            self._send_scans(steps)
            self._send_cells(patches, _times(steps))
            self._send_paths(steps)
            self._send_tracks([step.tracks for step in steps], _times(steps))
            self._send_plots(steps)
            self._send_texts(steps)
            self._send_closures()

    def _send_scans(self, steps: list[StepResult]) -> None:
        """Send end points, ellipses and the robot's place."""
        import rerun as rr

        times = _times(steps)
        T_map_base = np.stack([step.T_map_base for step in steps])
        n_valid = np.array([np.count_nonzero(step.is_valid) for step in steps])
        row = np.repeat(np.arange(len(steps)), n_valid)
        points_base = np.concatenate([step.scan.points_base()[step.is_valid] for step in steps])
        points_map = se2.transform(T_map_base[row], points_base[:, None, :])[:, 0]
        is_moving = np.concatenate([step.is_moving[step.is_valid] for step in steps])
        p_moving = np.concatenate([step.p_moving[step.is_valid] for step in steps])
        packed_cov = np.concatenate([step.packed_cov[step.is_valid] for step in steps])
        half_sizes, angle = _ellipses(packed_cov)
        angle += np.array([step.local_yaw for step in steps])[row]
        why = _Why(
            beam=np.concatenate([np.flatnonzero(step.is_valid) for step in steps]),
            p_moving=p_moving,
            reason=np.concatenate([step.reason[step.is_valid] for step in steps]),
            half_sizes=half_sizes,
        )

        self._send(
            "/world/robot",
            times,
            rr.Transform3D.columns(
                translation=at_height(T_map_base[:, :2], 0.0),
                quaternion=yaw_quaternion(T_map_base[:, 2]),
            ),
        )
        class_ids = np.where(is_moving, MOVING, np.where(p_moving > 0.5, DOUBTFUL, STATIC))
        points = rr.Points3D.columns(
            positions=at_height(points_base, 0.06), class_ids=class_ids.astype(np.uint16)
        )
        self._send(
            "/world/robot/scan", times, [*points.partition(n_valid), *why.columns().partition(n_valid)]
        )
        self._sent.n_bytes += 20 * len(row)
        if len(row):
            self._scan_boxes.append(_box(points_base))

        n_rows = len(steps)
        n_moving = np.bincount(row[is_moving], minlength=n_rows)
        moving = rr.Points3D.columns(positions=at_height(points_map[is_moving], 0.04))
        self._send_batches("/world/moving/points", times, moving, n_moving)
        is_shown = ~is_moving & (why.beam % STATIC_ELLIPSE_EVERY == 0)
        for name, chosen, z in (("moving", is_moving, 0.05), ("static", is_shown, 0.045)):
            self._send_ellipses(
                f"/world/ellipses/{name}",
                times,
                points_map[chosen],
                (half_sizes[chosen], angle[chosen]),
                np.bincount(row[chosen], minlength=n_rows),
                z,
                why[chosen],
            )
        rows_of_nodes = [k for k, step in enumerate(steps) if step.node is not None]
        if rows_of_nodes:
            is_seen = ~is_moving & np.isin(row, rows_of_nodes)
            seen = rr.Points3D.columns(positions=at_height(points_map[is_seen], -0.04))
            lengths = np.bincount(row[is_seen], minlength=n_rows)[rows_of_nodes]
            self._send("/world/map/recent", times[rows_of_nodes], seen.partition(lengths))
            self._sent.n_bytes += 12 * int(lengths.sum())

        # two numbers a row need no more than this: covariance of the robot's place, in map axes
        pose_cov = se2.body_to_world_covariance(np.stack([step.cov_map for step in steps]), T_map_base[:, 2])
        ellipses = _ellipses(_packed(pose_cov))
        one = np.ones(n_rows, dtype=np.int64)
        self._send_ellipses("/world/estimate/cov", times, T_map_base[:, :2], ellipses, one, 0.02)
        self._send_anchors(steps)

    def _send_cells(self, patches: "list[_Patch | None]", times: Times) -> None:
        """Send the cells that the test saw; where there are none, what was shown before goes."""
        import pyarrow as pa  # type: ignore[import-untyped]
        import rerun as rr

        kept = [patch for patch in patches if patch is not None]
        columns = cell_columns(
            [patch.colors for patch in kept],
            np.array([patch.T_map_corner for patch in kept]).reshape(-1, 3),
            [patch.resolution_m for patch in kept],
            CELLS_HEIGHT_M,
        )
        after = rr.AnyValues.columns(after_scan=pa.array([patch.after_scan for patch in kept], pa.int64()))
        lengths = np.array([patch is not None for patch in patches], dtype=np.int64)
        self._send_batches("/world/cells", times, rr.ComponentColumnList([*columns, *after]), lengths)

    def _send_anchors(self, steps: list[StepResult]) -> None:
        """Send the place of the scan that the local map hangs on, where it changes."""
        import rerun as rr

        anchors = [step.anchor_scan for step in steps]
        before = [self._sent.anchor, *anchors[:-1]]
        self._sent.anchor = anchors[-1]
        changed = [row for row, anchor in enumerate(anchors) if anchor != before[row]]
        if not changed:
            return
        of_steps = [steps[row] for row in changed]
        T_map_anchor = se2.compose(
            np.stack([step.T_map_base for step in of_steps]),
            se2.inverse(np.stack([step.T_anchor_base for step in of_steps])),
        )
        has_anchor = np.array([step.anchor_scan >= 0 for step in of_steps])
        points = rr.Points3D.columns(
            positions=at_height(T_map_anchor[has_anchor, :2], 0.026),
            labels=[f"scan {step.anchor_scan}" for step in of_steps if step.anchor_scan >= 0],
        )
        self._send_batches("/world/anchor", _times(of_steps), points, has_anchor.astype(np.int64))

    def _send_paths(self, steps: list[StepResult]) -> None:
        """Send one segment per scan of each path."""
        import rerun as rr

        poses: dict[str, list[FloatArray]] = {
            "estimate": [step.T_map_base for step in steps],
            "odom": [step.scan.T_odom_base for step in steps],
        }
        truth = [step.scan.truth.T_world_base for step in steps if step.scan.truth is not None]
        known = [pose for pose in truth if pose is not None]
        if len(known) == len(steps):
            poses["truth"] = known
        times = _times(steps)
        for z, (name, list_of_poses) in enumerate(poses.items()):
            T = np.stack(list_of_poses)
            # odom and world are moved so that all paths start where the estimate does
            T_map = self._sent.T_map_frame.setdefault(
                name, se2.compose(steps[0].T_map_base, se2.inverse(T[0]))
            )
            T_map_base = se2.compose(T_map, T)
            if name == "truth":
                self._send_errors(T_map_base, steps)
            xy = T_map_base[:, :2]
            start = self._sent.last_xy.get(name, xy[0])
            segments = np.stack([np.concatenate([start[None], xy[:-1]]), xy], axis=1)
            self._sent.last_xy[name] = xy[-1]
            strips = rr.LineStrips3D.columns(strips=at_height(segments, 0.022 - 0.002 * z))
            self._send(f"/world/{name}/path", times, strips)

    def _send_errors(self, T_map_base_true: FloatArray, steps: list[StepResult]) -> None:
        error = se2.between(T_map_base_true, np.stack([step.T_map_base for step in steps]))
        times = _times(steps)
        self._send_scalars("error_m/distance", times, np.hypot(error[:, 0], error[:, 1]))
        self._send_scalars("error_deg/turn", times, np.degrees(np.abs(error[:, 2])))

    def _send_tracks(self, tracks: list[tuple[TrackState, ...]], times: Times) -> None:
        """Send one batch per scan of all tracks, an empty one when there are none."""
        import rerun as rr

        n_tracks = np.array([len(states) for states in tracks], dtype=np.int64)
        states = list(chain.from_iterable(tracks))
        centre = np.array([state.position for state in states]).reshape(-1, 2)
        velocity = np.array([state.velocity for state in states]).reshape(-1, 2)
        cov = np.array([state.position_cov for state in states]).reshape(-1, 2, 2)
        colors = np.array([track_color(state.track_id) for state in states], dtype=np.uint32)
        places = at_height(centre, 0.08)
        before = []
        for of_scan in tracks:
            before += [self._sent.last_track_xy.get(state.track_id, state.position) for state in of_scan]
            self._sent.last_track_xy = {state.track_id: state.position for state in of_scan}
        segments = np.stack([np.array(before).reshape(-1, 2), centre], axis=1)

        points = rr.Points3D.columns(positions=places, colors=colors)
        labels = [str(state.track_id) for state in states]
        numbers = rr.Points3D.columns(positions=places, labels=labels)
        arrows = rr.Arrows3D.columns(vectors=at_height(velocity, 0.0), origins=places, colors=colors)
        trail = rr.LineStrips3D.columns(strips=at_height(segments, 0.07), colors=colors)
        self._send_batches("/world/tracks/centre", times, points, n_tracks)
        self._send_batches("/world/tracks/number", times, numbers, n_tracks)
        self._send_batches("/world/tracks/velocity", times, arrows, n_tracks)
        self._send_batches("/world/tracks/trail", times, trail, n_tracks)
        self._send_ellipses("/world/tracks/cov", times, centre, _ellipses(_packed(cov)), n_tracks, 0.075)

    def _send_closures(self) -> None:
        """Send one batch per status and step that tried any; an empty one clears those tried before."""
        import rerun as rr

        tried, self._tried = self._tried, []
        if not tried:
            return
        times = _times([of_step.step for of_step in tried])
        attempts = [attempt for of_step in tried for attempt in of_step.step.closures]
        segments = np.concatenate([of_step.segments for of_step in tried])
        row = np.repeat(np.arange(len(tried)), [len(of_step.segments) for of_step in tried])
        for status in get_args(ClosureStatus):
            rows = [k for k, attempt in enumerate(attempts) if attempt.status == status]
            lines = rr.LineStrips3D.columns(
                strips=at_height(segments[rows], 0.036), labels=[attempts[k].text for k in rows]
            )
            self._send_batches(
                _closure_path(status), times, lines, np.bincount(row[rows], minlength=len(tried))
            )

    def _send_plots(self, steps: list[StepResult]) -> None:
        times = _times(steps)
        for stage in dict.fromkeys(chain.from_iterable(step.stage_ms for step in steps)):
            took = np.array([step.stage_ms.get(stage, np.nan) for step in steps])
            self._send_scalars(f"timing/{stage}", times, took)
        n_valid = np.array([np.count_nonzero(step.is_valid) for step in steps], dtype=np.float64)
        n_moving = np.array([np.count_nonzero(step.is_moving) for step in steps], dtype=np.float64)
        self._send_scalars("count/valid", times, n_valid)
        self._send_scalars("count/moving", times, n_moving)
        self._send_scalars("count/static", times, n_valid - n_moving)
        self._send_scalars("tracks/tracks", times, np.array([float(len(step.tracks)) for step in steps]))
        self._send_scalars("nis/nis", times, np.array([step.innovation_nis for step in steps]))
        ends = np.full(len(steps), np.nan)
        ends[[0, -1]] = NIS_BOUND_95
        self._send_scalars("nis/bound_95", times, ends)
        for name, cov in (
            ("in_map", np.stack([step.cov_map for step in steps])),
            ("relative", np.stack([step.cov_relative for step in steps])),
        ):
            semi_axis = _ellipses(_packed(cov))[0][:, 0] / SIGMAS_95
            self._send_scalars(f"std_m/{name}", times, semi_axis)
            heading = np.degrees(np.sqrt(np.maximum(cov[:, 2, 2], 0.0)))
            self._send_scalars(f"std_deg/{name}", times, heading)
        for group, name in (("residual", "residual_m"), ("inliers", "inlier_ratio")):
            values = [np.nan if step.match is None else getattr(step.match, name) for step in steps]
            self._send_scalars(f"{group}/{name}", times, np.array(values, dtype=np.float64))

    def _send_texts(self, steps: list[StepResult]) -> None:
        """Send events, and the match's state where it changes."""
        import rerun as rr

        times = _times(steps)
        row_of = [row for row, step in enumerate(steps) for _ in step.events]
        if row_of:
            events = [(step.scan.index, event.text) for step in steps for event in step.events]
            texts = [f"scan {index}: {event}" for index, event in events]  # the view cuts its own column
            levels = ["WARN" if _is_warning(event) else "INFO" for _, event in events]
            self._send("/log/events", times[row_of], rr.TextLog.columns(text=texts, level=levels))
        states = ["none" if step.match is None else step.match.status for step in steps]
        before = [self._sent.state, *states[:-1]]
        changes = [row for row, state in enumerate(states) if state != before[row]]
        if changes:
            changed = rr.StateChange.columns(state=[states[row] for row in changes])
            self._send("/state/match", times[changes], changed)
        self._sent.state = states[-1]

    def _send_ellipses(
        self,
        path: str,
        times: Times,
        centres: FloatArray,
        ellipses: tuple[FloatArray, FloatArray],
        lengths: IntArray,
        z: float,
        why: "_Why | None" = None,
    ) -> None:
        """Send ellipses: their centres, and semi-axes and angles as of `_ellipses`, in map axes."""
        import rerun as rr

        half_sizes, angle = ellipses
        columns = rr.Ellipsoids3D.columns(
            centers=at_height(centres, z),
            half_sizes=at_height(half_sizes, 0.002),
            quaternions=yaw_quaternion(angle),
        )
        if why is not None:
            columns = rr.ComponentColumnList([*columns, *why.columns()])
        self._send_batches(path, times, columns, lengths)

    def _send_batches(
        self, path: str, times: Times, columns: "rr.ComponentColumnList", lengths: IntArray
    ) -> None:
        """Send batches of changing size; nothing at all while there is nothing to show or to clear."""
        n_instances = int(lengths.sum())
        if n_instances or self._sent.last_length.get(path, 0):
            self._send(path, times, columns.partition(lengths))
        self._sent.last_length[path] = int(lengths[-1])
        self._sent.n_bytes += 40 * n_instances

    def _send_scalars(self, name: str, times: Times, values: FloatArray) -> None:
        """Send the finite values of a plot `name`: its group and its line."""
        import rerun as rr

        rows = np.flatnonzero(np.isfinite(values))
        if not len(rows):
            return
        path = f"/plots/{name}"
        if path not in self._sent.named:
            self._sent.named.add(path)
            line = rr.SeriesLines(
                names=name.split("/")[1].replace("_", " "),
                colors=_LINE_COLORS.get(name),
                widths=_LINE_WIDTHS.get(name, 1.5),
                # the mean of those that share a pixel would hide that one of them was high
                aggregation_policy=rr.components.AggregationPolicy.MinMax,
            )
            self._rec.log(path, line, static=True)
        self._send(path, times[rows], rr.Scalars.columns(scalars=values[rows]))

    def _send(self, path: str, times: Times, columns: "Sequence[Any] | rr.ComponentColumnList") -> None:
        self._rec.send_columns(path, indexes=times.columns(), columns=columns)

    # ---------------------------------------------------------------- single entries

    def _set_time(self) -> None:
        if self._last_step is not None:
            self._rec.set_time("scan", sequence=self._last_step.scan.index)
            self._rec.set_time("stamp", timestamp=self._last_step.scan.stamp)

    def _log_graph_view(self, nodes: FloatArray, edges: Sequence[GraphEdge]) -> None:
        """Log the shape of the graph: a thinned chain, and the closures with their ends."""
        import rerun as rr

        closures = [(edge.from_node, edge.to_node) for edge in edges if edge.kind == "closure"]
        ends = set(chain.from_iterable(closures))
        kept = sorted(ends | set(_thinned(len(nodes), MAX_VIEW_NODES)))
        names = [str(node) for node in kept]
        self._rec.log(
            "/graph/chain",
            rr.GraphNodes(
                node_ids=names,
                positions=(nodes[kept, :2] * [GRAPH_VIEW_SCALE, -GRAPH_VIEW_SCALE]).astype(
                    np.float32
                ),  # the view's y points down
                colors=np.array(
                    [COLOR_CLOSURE if node in ends else COLOR_ESTIMATE for node in kept], np.uint32
                ),
                radii=np.full(len(kept), 4.0, dtype=np.float32),
                show_labels=False,
            ),
            rr.GraphEdges(
                # of this entity, since an edge finds no nodes of another one
                [*pairwise(names), *((str(a), str(b)) for a, b in closures)],
                graph_type="undirected",
            ),
        )

    def _send_blueprint(
        self, of_map: Frame, of_graph: Frame, *, has_truth: bool, tops: Mapping[str, float]
    ) -> None:
        of_scan = Frame.around(np.median(self._scan_boxes, axis=0))
        self._rec.send_blueprint(_blueprint(of_map, of_scan, of_graph, has_truth=has_truth, tops=tops))


@dataclass(frozen=True, eq=False)
class _Tried:
    """A step that tried closures, and the places (k, 2, 2) of their nodes just before."""

    step: StepResult
    segments: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class _Why:
    """What is told of a point that is selected: beam number, probability, reason, semi-axes of the 95% ellipse [m]."""

    beam: IntArray
    p_moving: FloatArray
    reason: IntArray
    half_sizes: FloatArray

    def __getitem__(self, chosen: BoolArray) -> "_Why":
        return _Why(
            beam=self.beam[chosen],
            p_moving=self.p_moving[chosen],
            reason=self.reason[chosen],
            half_sizes=self.half_sizes[chosen],
        )

    def columns(self) -> "rr.ComponentColumnList":
        """Give them as columns; rerun would turn anything but arrow arrays into lists, number by number."""
        import pyarrow as pa
        import rerun as rr

        from slammot_graph.detection.reasons import REASONS

        semi_mm = np.minimum(np.round(1000.0 * self.half_sizes), 65535).astype(np.uint16)
        reason = pa.DictionaryArray.from_arrays(pa.array(self.reason.astype(np.int8)), pa.array(REASONS))
        return rr.AnyValues.columns(
            beam=pa.array(self.beam.astype(np.uint16)),
            p_moving=pa.array(np.round(self.p_moving, 3).astype(np.float32)),
            reason=reason,
            ellipse_long_mm=pa.array(semi_mm[:, 0]),
            ellipse_short_mm=pa.array(semi_mm[:, 1]),
        )


@dataclass(frozen=True, eq=False)
class _Cells:
    """The test's grid around the robot in the local frame, where that lies in the map, and the limits of its states."""

    grid: GridMap
    T_map_local: FloatArray
    limits: tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Patch:
    """Cells to be shown, uint8 (rows, cols, 3), where their lower left corner lies, and which scan left them so."""

    colors: Any
    T_map_corner: FloatArray
    resolution_m: float
    after_scan: int


class _Sent:
    """What earlier batches left for the next one."""

    def __init__(self) -> None:
        self.n_bytes = 0
        self.T_map_frame: dict[str, FloatArray] = {}
        self.last_xy: dict[str, FloatArray] = {}
        self.last_track_xy: dict[int, FloatArray] = {}
        self.last_length: dict[str, int] = {}
        self.named: set[str] = set()
        self.state = ""
        self.anchor = -1


class _Budget:
    """Says when something big is due, so that all of it stays a share of the scans' bytes."""

    def __init__(
        self,
        share: float,
        n_scans_between: int,
        *,
        renewal: float = RENEWAL_SHARE,
        head_start: float = 0.0,
    ) -> None:
        self._share = share
        self._n_scans_between = n_scans_between
        self._renewal = renewal
        self._head_start = head_start
        self._n_bytes = 0.0
        self._last_n_bytes = 0.0
        self._last_n_scans = -n_scans_between

    def is_due(self, n_scans: int, scan_bytes: int) -> bool:
        if n_scans - self._last_n_scans < max(self._n_scans_between, self._renewal * n_scans):
            return False
        return self._n_bytes + self._last_n_bytes <= self._share * scan_bytes + self._head_start

    def spend(self, n_scans: int, n_bytes: float) -> None:
        self._n_bytes += n_bytes
        self._last_n_bytes = n_bytes
        self._last_n_scans = n_scans


def _times(steps: Sequence[StepResult]) -> Times:
    index = np.array([step.scan.index for step in steps], dtype=np.int64)
    return Times(index, np.array([step.scan.stamp for step in steps]))


# -------------------------------------------------------------------- style and layout

_LINE_COLORS = {
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

_LINE_WIDTHS = {"timing/step": 0.6}
"""It lies above those of its stages and must not hide them."""


def _log_style(rec: "rr.RecordingStream") -> None:
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
    line("/world/estimate/way", COLOR_ESTIMATE, 2.0)
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
        line(_closure_path(status), color, 1.0 if status == "refused" else 2.5)
        style(_closure_path(status), rr.LineStrips3D.from_fields(show_labels=False))
    line("/world/closures/graph_before", COLOR_BEFORE, 1.5)
    states = {"converged": 0x4CAF50FF, "degenerate": 0xF2A900FF, "failed": COLOR_MOVING, "none": 0x777777FF}
    style(
        "/state/match",
        rr.StateConfiguration(values=list(states), colors=np.array(list(states.values()), np.uint32)),
    )


def _blueprint(
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
        _closure_path("accepted"): until_cursor(SHIFT_SCANS),
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
            _closure_path("refused"): rrb.EntityBehavior(visible=False),
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
            _closure_path("refused"): rrb.EntityBehavior(visible=False),
            "/world/estimate/way": rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(0.6)),
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
                rrb.StateTimelineView(origin="/state", name="State of the match", time_view=at_all_times()),
                rrb.Tabs(*texts, active_tab=0),
                row_shares=[10, 8, 3, 6],
            ),
            column_shares=[3, 2],
        ),
        *collapsed_panels(),
    )


# -------------------------------------------------------------------- small things


def _closure_path(status: ClosureStatus) -> str:
    return f"/world/closures/{status.replace(' ', '_')}"


def _edges(nodes: FloatArray, pairs: Sequence[tuple[int, int]]) -> "rr.LineStrips3D":
    """Make lines between nodes (m, 3)."""
    import rerun as rr

    ends = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return rr.LineStrips3D(at_height(nodes[ends][..., :2], 0.015))


def _thinned(n: int, n_most: int) -> range:
    """Evenly spaced indices below n, about so many at most."""
    return range(0, n, max(1, math.ceil(n / n_most)))


def _uncorrected(last: StepResult, step: StepResult) -> FloatArray:
    """(3,) pose of a step that closed a loop, as it would have been without."""
    increment = se2.between(last.scan.T_odom_base, step.scan.T_odom_base)
    innovation = se2.between(step.T_map_base_predicted, step.T_map_base)
    return se2.compose(se2.compose(last.T_map_base, increment), innovation)


def _packed(cov: FloatArray) -> FloatArray:
    """xx, xy, yy (k, 3) of covariances (k, 2, 2) or (k, 3, 3)."""
    return np.column_stack([cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]])


def _ellipses(packed_cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Semi-axes (k, 2) of the 95% ellipses of covariances xx, xy, yy (k, 3), the longer first; its angle [rad]."""
    a, b, c = packed_cov.T
    mean, spread = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    variances = np.maximum(np.column_stack([mean + spread, mean - spread]), 0.0)
    return SIGMAS_95 * np.sqrt(variances), 0.5 * np.arctan2(2.0 * b, a - c)


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


def _box(points: FloatArray) -> FloatArray:
    """Low and high corner (2, 2) of the robot and most of the points (n, 2) around it [m]."""
    low, high = np.percentile(points, [10.0, 90.0], axis=0) if len(points) else np.zeros((2, 2))
    return np.array([np.minimum(low, -1.0), np.maximum(high, 1.0)])


def _frame_of(poses: FloatArray) -> Frame:
    """Frame poses (n, 3) of at least one."""
    return Frame.around(np.array([poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)]))


def _tops(result: RunResult) -> dict[str, float]:
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


def _has_truth(step: StepResult) -> bool:
    return step.scan.truth is not None and step.scan.truth.T_world_base is not None


def _is_warning(event: str) -> bool:
    return any(word in event for word in ("fail", "reject", "degenerate", "skip", "interrupt"))


def _config_table(config: Mapping[str, Any]) -> str:
    """Lay a nested configuration out as a Markdown table."""

    def rows(values: Mapping[str, Any], prefix: str) -> Iterator[str]:
        for key, value in values.items():
            if isinstance(value, Mapping):
                yield from rows(value, f"{prefix}{key}.")
            else:
                yield f"| `{prefix}{key}` | {value} |"

    return "\n".join(["| key | value |", "|---|---|", *rows(config, "")])


def _summary(result: RunResult) -> str:
    """Say a run's figures in Markdown."""
    n_closures = sum(edge.kind == "closure" for edge in result.edges)
    lines = [
        f"# {result.method}{'' if result.is_complete else ' (interrupted)'}",
        "| | |",
        "|---|---|",
        f"| scans | {len(result.stamps)} ({result.n_skipped} skipped) |",
        f"| graph | {len(result.nodes)} nodes, {n_closures} loop closures |",
        f"| failed matches | {result.n_failed_matches} |",
    ]
    for stage, took in result.stage_ms.items():
        if np.isfinite(took).any():
            lines.append(f"| {stage} | {np.nanmedian(took):.3f} ms in the median |")
    return "\n".join(lines)
