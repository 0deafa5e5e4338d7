"""The recording of a run for the rerun viewer: the observer, which keeps steps and hands them to the panels.

Everything in the map frame lies at z = 0 but for small offsets that order the layers.
"""

import errno
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GraphEdge, GridMap, RunResult, StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.observer import Observer, RunInfo, RunView, TestGrid
from slammot_graph.viz.rerun.cells import CELLS_HALF_SIDE_M, CellPanel
from slammot_graph.viz.rerun.columns import Columns
from slammot_graph.viz.rerun.graph import GraphPanel
from slammot_graph.viz.rerun.layout import NIS_SHOWN, log_style, make_blueprint, plot_tops
from slammot_graph.viz.rerun.maps import MapPanel
from slammot_graph.viz.rerun.paths import PathPanel
from slammot_graph.viz.rerun.plots import PlotPanel
from slammot_graph.viz.rerun.primitives import Frame, Sink, at_height, view_of
from slammot_graph.viz.rerun.scans import ScanPanel
from slammot_graph.viz.rerun.texts import LEGEND, TextPanel, config_table, summary_text
from slammot_graph.viz.rerun.tracks import TrackPanel

SCANS_PER_SEND = 100
SCANS_PER_SEND_LIVE = 10
FIRST_BYTES = 1 << 16
"""So many are written before anything else, to see whether that is possible."""
RESERVE_BYTES, RESERVE_BYTES_PER_BEAM = 64 << 20, 10
"""So much of the disk is left to the results: at all events, and for each beam of all scans."""


class RerunRecording(Observer):
    """Records a run with rerun, into a file or a live viewer.

    Steps are kept and sent as columns, many scans at a time. Maps, graphs and cells of the test are asked for only as
    long as they stay a small share of the recording.

    Where it cannot go on, as on a disk that is nearly full, it ends and the run does not: `close` tells of it, after
    the run. What the results need of the disk is left to them.

    Parameters
    ----------
    path : Path or None
        The recording to write (``run.rrd``); it is opened when the run starts.
    spawn : bool
        Open a viewer and stream to it instead; exactly one of `path` and `spawn`.
    recording_id : str, optional
        The viewer joins recordings that have the same: of a run that went on after an interruption.

    Raises
    ------
    InputError
        From `on_start`: the file cannot be made or no viewer can be opened. From `close`: it ended before the run.
    """

    def __init__(
        self, *, path: Path | None = None, spawn: bool = False, recording_id: str | None = None
    ) -> None:
        if (path is None) != spawn:
            raise ValueError("give either a path or spawn=True")
        self._path = path
        self._spawn = spawn
        self._recording_id = recording_id
        self._sink: Sink | None = None
        self._panels: _Panels | None = None
        self._steps: list[StepResult] = []
        self._last_step: StepResult | None = None
        self._n_scans = 0
        self._n_expected = 0
        self._failure: InputError | None = None

    # ------------------------------------------------------------------------------------------------ hooks

    def on_start(self, info: RunInfo) -> None:
        """Open the recording; a run that is started again is recorded anew."""
        self._steps, self._last_step, self._n_scans = [], None, 0
        self._n_expected, self._failure = info.n_scans or 0, None
        with self._ending_alone():
            self._check_space(0)
            self._try_to_write()
        if self._failure is not None:
            return
        self._sink = Sink(
            f"slammot_graph {info.method}",
            path=self._path,
            spawn=self._spawn,
            recording_id=self._recording_id,
        )
        self._panels = _Panels.on(Columns(self._sink.rec))
        with self._sink.errors():
            log_style(self._sink.rec)
            self._sink.log_text(
                "/doc/config", f"{LEGEND}\n## Configuration of {info.method}\n{config_table(info.config)}"
            )

    def on_step(self, step: StepResult, view: RunView) -> None:
        """Keep a step, and the cells and the graph where they are due."""
        with self._ending_alone() as goes_on:
            if goes_on:
                self.log_step(step, view.test_grid(CELLS_HALF_SIDE_M) if self.wants_cells() else None)
                if self.wants_graph():
                    self.log_graph(view.nodes(), view.edges())

    def on_closure(self, step: StepResult, view: RunView) -> None:
        """Log what a closure did to the nodes, where the graph has not just been logged."""
        with self._ending_alone() as goes_on:
            if goes_on and self.wants_nodes():
                self.log_nodes(view.nodes())

    def wants_map(self) -> bool:
        """Tell whether a map is due now."""
        return self._failure is None and self._opened.map.wants(self._n_scans)

    def on_map(self, step: StepResult, grid: GridMap) -> None:
        """Log the map as it is after the last step."""
        with self._ending_alone() as goes_on:
            if goes_on:
                self.log_map(grid)

    def on_finish(self, result: RunResult) -> None:
        """Log the final trajectory, map, graph and figures, and a layout that fits the final map."""
        with self._ending_alone() as goes_on:
            if goes_on:
                self._log_result(result)

    def on_checkpoint(self) -> None:
        """Write all that is kept."""
        with self._ending_alone() as goes_on:
            if goes_on and self._sink is not None:
                self._send_steps()
                self._sink.flush()

    def _log_result(self, result: RunResult) -> None:
        import rerun as rr

        self._send_steps()
        self.log_map(result.grid)
        self.log_graph(result.nodes, result.edges)
        with self._now() as sink:
            if len(result.stamps):
                path = at_height(result.T_map_base[None, :, :2], 0.03)
                sink.rec.log("/world/final/path", rr.LineStrips3D(path))
                has_truth = self._last_step is not None and _has_truth(self._last_step)
                frame = view_of(result.T_map_base, result.grid)
                of_graph = _frame_of(result.nodes) if len(result.nodes) else frame
                self._send_blueprint(frame, of_graph, has_truth=has_truth, tops=plot_tops(result))
            sink.log_text("/doc/summary", summary_text(result))

    def close(self) -> None:
        """Send what is still kept, wait until it is written, and close; may be called twice."""
        if self._sink is not None:
            with self._ending_alone() as goes_on:
                if goes_on:
                    self._send_steps()
                    self._sink.flush()
            self._disconnect()
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    @contextmanager
    def _ending_alone(self) -> Iterator[bool]:
        """Give whether the recording still goes on; where it cannot, the run does."""
        try:
            yield self._failure is None
        except (
            Exception
        ) as error:  # whatever it is: nobody looks at a recording of a run that was lost with it
            n = self._n_scans
            self._failure = InputError(
                f"the recording ends after {n} scans, all else is as without it: {error}"
            )
            self._failure.__cause__ = error
            self._steps = []
            self._disconnect()

    def _disconnect(self) -> None:
        if self._sink is not None:
            self._sink.rec.disconnect()
        self._sink = self._panels = None

    def _try_to_write(self) -> None:
        """Refuse to begin where the file cannot grow: rerun waits for ever for its first bytes to be written."""
        if self._path is None or not self._path.parent.is_dir():
            return
        try:
            self._path.write_bytes(bytes(FIRST_BYTES))
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                raise
            self._path.unlink(missing_ok=True)
            raise InputError(
                f"{self._path}: {error.strerror}; free some space or pass --rerun off"
            ) from error

    def _check_space(self, n_beams: int) -> None:
        """Refuse to write where the results would not find the space that they need."""
        if self._path is None:
            return
        needed = RESERVE_BYTES + RESERVE_BYTES_PER_BEAM * n_beams * max(self._n_expected, self._n_scans)
        free = shutil.disk_usage(self._path.parent).free if self._path.parent.exists() else needed
        if free < needed:
            raise InputError(
                f"{self._path}: {free >> 20} MB are free, which the results may need ({needed >> 20} MB); free some"
                " space, choose another folder or pass --rerun off"
            )

    # ---------------------------------------------------------------------------------------- what is logged

    def wants_cells(self) -> bool:
        """Tell whether the cells of the moving-point test are due with the next step."""
        return self._opened.cells.wants(self._n_scans)

    def wants_graph(self) -> bool:
        """Tell whether the graph is due now."""
        return self._opened.graph.wants_graph(self._n_scans)

    def wants_nodes(self) -> bool:
        """Tell whether a closure has moved the nodes and nobody has said where to."""
        return self._opened.graph.wants_nodes

    def log_step(self, step: StepResult, cells: TestGrid | None = None) -> None:
        """Keep one step, and the test's grid around the robot as it left it; a batch of them is sent at a time."""
        panels = self._opened
        if self._last_step is None:
            self._check_space(len(step.is_valid))
            panels.scans.start(step)
            frame = Frame(step.T_map_base[:2], 15.0, 15.0)
            with self._now():
                self._send_blueprint(frame, frame, has_truth=_has_truth(step), tops={"nis": max(NIS_SHOWN)})
        panels.graph.follow(step)
        panels.cells.keep(step, cells, self._n_scans)
        self._steps.append(step)
        self._last_step = step
        self._n_scans += 1
        if len(self._steps) >= (SCANS_PER_SEND_LIVE if self._spawn else SCANS_PER_SEND):
            self._send_steps()

    def log_map(self, grid: GridMap) -> None:
        """Log the map as it is after the last step."""
        if grid.p_occupied.size == 0:
            return
        with self._now():
            self._opened.map.log(grid, self._n_scans)

    def log_graph(self, nodes: FloatArray, edges: Sequence[GraphEdge]) -> None:
        """Log the graph as it is after the last step: node poses (m, 3) in the map frame, and edges."""
        with self._now():
            self._opened.graph.log_graph(nodes, edges, self._n_scans)

    def log_nodes(self, nodes: FloatArray) -> None:
        """Log what the last closure did to the nodes: their poses (m, 3) as they are after the last step."""
        with self._now():
            self._opened.graph.log_nodes(nodes)

    @property
    def _opened(self) -> "_Panels":
        if self._panels is None:
            raise ValueError("the recording is not open: it begins with on_start and ends with close")
        return self._panels

    @contextmanager
    def _now(self) -> Iterator[Sink]:
        """Log at the time of the last step; errors become one line."""
        if self._sink is None:
            raise ValueError("the recording is not open: it begins with on_start and ends with close")
        with self._sink.errors():
            if self._last_step is not None:
                self._sink.rec.set_time("scan", sequence=self._last_step.scan.index)
                self._sink.rec.set_time("stamp", timestamp=self._last_step.scan.stamp)
            yield self._sink

    def _send_steps(self) -> None:
        """Send all kept steps as columns."""
        if not self._steps:
            return
        steps, self._steps = self._steps, []
        self._check_space(len(steps[-1].is_valid))
        with self._now():
            self._opened.send(steps)

    def _send_blueprint(
        self, of_map: Frame, of_graph: Frame, *, has_truth: bool, tops: Mapping[str, float]
    ) -> None:
        panels = self._opened
        of_scan = panels.scans.frame()
        blueprint = make_blueprint(of_map, of_scan, of_graph, has_truth=has_truth, tops=tops)
        panels.out.rec.send_blueprint(blueprint)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Panels:
    """What a recording consists of; each panel has its own state, and all send by the same `out`."""

    out: Columns
    scans: ScanPanel
    cells: CellPanel
    paths: PathPanel
    tracks: TrackPanel
    plots: PlotPanel
    texts: TextPanel
    graph: GraphPanel
    map: MapPanel

    @classmethod
    def on(cls, out: Columns) -> "_Panels":
        return cls(
            out=out,
            scans=ScanPanel(out),
            cells=CellPanel(out),
            paths=PathPanel(out),
            tracks=TrackPanel(out),
            plots=PlotPanel(out),
            texts=TextPanel(out),
            graph=GraphPanel(out),
            map=MapPanel(out),
        )

    def send(self, steps: list[StepResult]) -> None:
        """Send what all panels have to say of a batch of steps."""
        for panel in (self.scans, self.cells, self.paths, self.tracks, self.plots, self.texts, self.graph):
            panel.send(steps)


def _frame_of(poses: FloatArray) -> Frame:
    """Frame poses (n, 3) of at least one."""
    return Frame.around(np.array([poses[:, :2].min(axis=0), poses[:, :2].max(axis=0)]))


def _has_truth(step: StepResult) -> bool:
    return step.scan.truth is not None and step.scan.truth.T_world_base is not None
