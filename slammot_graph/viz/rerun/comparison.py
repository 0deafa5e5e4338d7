"""The recording of several runs over one log, for the rerun viewer.

Each run is an entity below ``/world/runs`` that carries its own map frame into that of the first run.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slammot_graph.core.types import FloatArray
from slammot_graph.evaluation import ComparedRun
from slammot_graph.viz.colors import COLOR_TRUTH, RUN_COLORS
from slammot_graph.viz.rerun.primitives import (
    Sink,
    Times,
    at_height,
    collapsed_panels,
    grid_map,
    plot_view,
    until_cursor,
    view_from_above,
    view_of,
    yaw_quaternion,
)

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

TRAIL_SCANS = 30
"""How long moving points stay visible behind the cursor [scans]."""
PLOTS = {
    "truth_m": "Distance from the truth [m]",
    "truth_deg": "Turn from the truth [degrees]",
    "distance_m": "Distance from the first run [m]",
    "turn_deg": "Turn from the first run [degrees]",
    "moving": "Moving points",
    "position_std_m": "Uncertainty of the position [m]",
}
"""Groups of plots, a line per run in each, and their titles."""


def record_comparison(
    runs: Sequence[ComparedRun],
    *,
    T_ref_base_true: FloatArray | None = None,
    moving: Mapping[str, Sequence[FloatArray]],
    summary: str = "",
    path: Path | None = None,
    spawn: bool = False,
) -> None:
    """Record several runs together.

    Parameters
    ----------
    runs : sequence of ComparedRun
    T_ref_base_true : (n, 3) array, optional
        The true path, in the map of the first run.
    moving : mapping
        Of the runs whose log is known, by name: the moving points (k, 2) of each scan, in the run's own map [m].
    summary : str
        A Markdown text with the runs' figures.
    path : Path or None
        The recording to write.
    spawn : bool
        Open a viewer and stream to it instead; exactly one of `path` and `spawn`.

    Raises
    ------
    InputError
        The file cannot be written or no viewer can be opened.
    """
    sink = Sink("slammot_graph comparison", path=path, spawn=spawn)
    shown_plots: dict[str, None] = {}
    try:
        with sink.errors():
            _log_style(sink.rec, T_ref_base_true)
            for run, color in zip(runs, _colors(len(runs)), strict=True):
                _log_run(sink.rec, run, color)
                _send_moving(sink.rec, run, moving.get(run.name))
                shown_plots |= dict.fromkeys(_send_plots(sink.rec, run, color))
            sink.log_text("/doc/summary", f"{summary}\n\n{_LEGEND}")
            sink.rec.send_blueprint(_blueprint(runs, [group for group in PLOTS if group in shown_plots]))
        sink.flush()
    finally:
        sink.rec.disconnect()


_LEGEND = """
| in the map | |
|---|---|
| line and arrow in a run's colour | its path, and where it is now |
| points in that colour | what it says moves, of the last scans |
| green line | the truth, where it is known |
| white, black, grey-green | free, occupied, not known in the first run's map |

All runs are laid onto the start of the first. To see another run's map, switch `runs/NAME/map` on.
"""


def _colors(n_runs: int) -> list[int]:
    return [RUN_COLORS[k % len(RUN_COLORS)] for k in range(n_runs)]


def _entity(run: ComparedRun, *below: str) -> str:
    import rerun as rr

    return rr.new_entity_path(["world", "runs", run.name, *below])


def _log_style(rec: "rr.RecordingStream", T_ref_base_true: FloatArray | None) -> None:
    import rerun as rr

    rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    if T_ref_base_true is not None:
        path = at_height(T_ref_base_true[None, :, :2], 0.01)
        width = rr.Radius.ui_points(3.0)  # it shows beside a run that lies on it
        rec.log("/world/truth", rr.LineStrips3D(path, colors=COLOR_TRUTH, radii=width), static=True)


def _log_run(rec: "rr.RecordingStream", run: ComparedRun, color: int) -> None:
    """Log what holds at all times, and where the robot is at each."""
    import rerun as rr

    def log(what: "rr.AsComponents", *below: str) -> None:
        rec.log(_entity(run, *below), what, static=True)

    frame = run.T_ref_map
    turn = yaw_quaternion(frame[None, 2])[0]
    log(rr.Transform3D(translation=at_height(frame[:2], 0.0), quaternion=rr.Quaternion(xyzw=turn)))
    if run.folder.grid.p_occupied.size:
        log(grid_map(run.folder.grid), "map")
    path = at_height(run.folder.T_map_base[None, :, :2], 0.03)
    log(rr.LineStrips3D(path, colors=color, radii=rr.Radius.ui_points(1.5)), "path")
    nose = rr.Arrows3D(
        vectors=[[0.6, 0.0, 0.0]],
        origins=[[0.0, 0.0, 0.09]],
        colors=color,
        radii=0.05,
    )
    log(nose, "robot")
    # a label has the colour of its point, and a run's own cannot be read on the label's grey
    label = rr.Points3D(
        [[0.0, 0.0, 0.1]],
        colors=0xFFFFFFFF,
        radii=rr.Radius.ui_points(0.5),
        labels=[run.name],
        show_labels=True,
    )
    log(label, "robot", "name")
    log(rr.Points3D.from_fields(colors=color, radii=rr.Radius.ui_points(2.5)), "moving")
    T_map_base = run.folder.T_map_base
    columns = rr.Transform3D.columns(
        translation=at_height(T_map_base[:, :2], 0.0), quaternion=yaw_quaternion(T_map_base[:, 2])
    )
    rec.send_columns(_entity(run, "robot"), indexes=_times(run).columns(), columns=columns)


def _send_moving(rec: "rr.RecordingStream", run: ComparedRun, of_scans: Sequence[FloatArray] | None) -> None:
    import rerun as rr

    if of_scans is None:
        return
    lengths = [len(points) for points in of_scans]
    columns = rr.Points3D.columns(positions=at_height(np.concatenate(of_scans), 0.05)).partition(lengths)
    rec.send_columns(_entity(run, "moving"), indexes=_times(run).columns(), columns=columns)


def _send_plots(rec: "rr.RecordingStream", run: ComparedRun, color: int) -> list[str]:
    """Send a run's line of every plot that it has figures for, and say which."""
    import rerun as rr

    lines: dict[str, Any] = {
        "truth_m": run.truth_error_m,
        "truth_deg": run.truth_error_deg,
        "distance_m": run.distance_m,
        "turn_deg": run.turn_deg,
        "moving": None,
        "position_std_m": None,
    }
    folder = run.folder
    if folder.points is not None:
        lines["moving"] = np.count_nonzero(folder.points.is_moving & folder.points.is_valid, axis=1)
    if folder.cov_map is not None:
        largest = np.linalg.eigvalsh(folder.cov_map[:, :2, :2])[:, -1]
        lines["position_std_m"] = np.sqrt(np.maximum(largest, 0.0))
    known = {group: np.asarray(values, float) for group, values in lines.items() if values is not None}
    for group, values in known.items():
        entity = rr.new_entity_path(["plots", group, run.name])
        # the mean of those that share a pixel would hide that one of them was high
        extremes = rr.components.AggregationPolicy.MinMax
        rec.log(
            entity, rr.SeriesLines(names=run.name, colors=color, aggregation_policy=extremes), static=True
        )
        rows = np.flatnonzero(np.isfinite(values))
        columns = rr.Scalars.columns(scalars=values[rows])
        rec.send_columns(entity, indexes=_times(run)[rows].columns(), columns=columns)
    return list(known)


def _times(run: ComparedRun) -> Times:
    return Times(np.arange(len(run.folder.stamps)), run.folder.stamps)


def _blueprint(runs: Sequence[ComparedRun], plots: Sequence[str]) -> "rrb.Blueprint":
    import rerun.blueprint as rrb

    # the first run's map is in the frame of all
    frame = view_of(np.concatenate([run.T_ref_base for run in runs]), runs[0].folder.grid)
    overrides: dict[Any, Any] = {_entity(run, "moving"): until_cursor(TRAIL_SCANS) for run in runs}
    overrides |= {_entity(run, "map"): rrb.EntityBehavior(visible=False) for run in runs[1:]}
    map_view = view_from_above("Map", "/world", ["+ /world/**"], frame.eye(1.1), overrides)
    views = [plot_view(PLOTS[group], group) for group in plots]
    summary = rrb.TextDocumentView(origin="/doc/summary", name="Runs and legend")
    return rrb.Blueprint(
        rrb.Horizontal(
            map_view,
            rrb.Vertical(*(rrb.Tabs(*some, active_tab=0) for some in _halves(views)), summary),
            column_shares=[3, 2],
        ),
        *collapsed_panels(),
    )


def _halves(views: "list[rrb.TimeSeriesView]") -> "list[list[rrb.TimeSeriesView]]":
    """Deal the plots out over two places, so that two show at once."""
    return [some for some in (views[::2], views[1::2]) if some]
