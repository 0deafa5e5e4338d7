"""Observers of a run: they see each step as it is made, and cannot change the estimate.

A few lines are enough for one; `Run` drives as many as it is given::

    class Progress(Observer):
        def on_step(self, step: StepResult, view: RunView) -> None:
            print(step.scan.index, step.T_map_base)

    Run(log, observers=[Progress()]).complete()
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from slammot_graph.baselines.kiss_icp import KissIcpPipeline
from slammot_graph.core.results import GraphEdge, GridMap, RunResult, StepResult
from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import FloatArray
from slammot_graph.pipeline import Pipeline

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class RunInfo:
    """What is known of a run before its first scan.

    Attributes
    ----------
    method : str
    config : mapping
        The configuration as nested plain values.
    log_path : Path or None
        The file of the scans; None for a live source.
    n_scans : int or None
        How many scans the log has, usable or not, or the run's limit where that is lower; None if not known.
    """

    method: str
    config: Mapping[str, Any]
    log_path: Path | None = None
    n_scans: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class TestGrid:
    """Cells of the moving-point test around the robot, as the test of the next scan will see them.

    Attributes
    ----------
    cells : GridMap
        In the local frame.
    T_map_local : (3,) array
        Pose of the local frame in the map.
    p_free, p_occupied : float
        Below the first probability a cell is free, above the second occupied, between them unknown.
    """

    __test__ = False  # not a test, whatever pytest makes of its name

    cells: GridMap
    T_map_local: FloatArray
    p_free: float
    p_occupied: float


class RunView:
    """What an observer may ask about a run between two scans; valid until the hook that got it returns.

    Nothing is computed unless it is asked for, and nothing twice for the same scan. Answers are read-only copies: they
    are the same whoever asks, and asking does not change the estimate.
    """

    def __init__(self, pipeline: Pipeline | KissIcpPipeline, step: StepResult) -> None:
        self._pipeline = pipeline
        self._step = step
        self._graph: tuple[FloatArray, tuple[GraphEdge, ...]] | None = None
        self._map: GridMap | None = None

    def nodes(self) -> FloatArray:
        """(m, 3) optimised poses of the graph's nodes, map frame; without a graph m is 0.

        Costs a copy of the graph, which is solved: about a millisecond per 500 nodes, nothing where it has not changed
        since it was asked for.
        """
        return self._nodes_and_edges()[0]

    def edges(self) -> tuple[GraphEdge, ...]:
        """Factors of the graph; costs what `nodes` does, and a few microseconds an edge."""
        return read_only(self._nodes_and_edges()[1])

    def map(self) -> GridMap:
        """Render the map as it is now.

        Costs the optimised trajectory and three updates of a grid per viewpoint of the run, 0.1 ms each and more: ask
        rarely, and less often the longer the run is, or let `Observer.wants_map` share one map among all observers.
        """
        if self._map is None:
            self._map = read_only(self._pipeline.render_map())
        return self._map

    def test_grid(self, half_side_m: float) -> TestGrid | None:
        """Give the cells of the moving-point test that a square around the robot touches; None without a test.

        Costs a copy of so many cells.
        """
        pipeline = self._pipeline
        if not isinstance(pipeline, Pipeline) or pipeline.detector.grid is None:
            return None
        cells, T_map_local = pipeline.crop_test_grid(self._step.T_map_base[:2], half_side_m)
        config = pipeline.detector.grid.config
        return TestGrid(
            cells=read_only(cells),
            T_map_local=read_only(T_map_local),
            p_free=config.p_free,
            p_occupied=config.p_occupied,
        )

    def _nodes_and_edges(self) -> tuple[FloatArray, tuple[GraphEdge, ...]]:
        if self._graph is None:
            nodes, edges = self._pipeline.nodes_and_edges()
            self._graph = read_only(nodes), edges
        return self._graph


class Observer:
    """Base of all observers: every hook does nothing, so override those that you need.

    The hooks are called in the thread of the run, so the run waits for them. What they are given is read-only: writing
    into an array of it raises ValueError. An exception ends the run; what was computed until then is kept.
    """

    def on_start(self, info: RunInfo) -> None:
        """Begin: called before the first scan is read."""

    def on_step(self, step: StepResult, view: RunView) -> None:
        """See the outcome of a scan, and ask `view` for more."""

    def on_closure(self, step: StepResult, view: RunView) -> None:
        """See that a loop closure has just moved the graph; comes after `on_step` of the same scan."""

    def wants_map(self) -> bool:
        """Tell whether the map is due now; asked after each `on_step`. Rendering it takes long."""
        return False

    def on_map(self, step: StepResult, grid: GridMap) -> None:
        """See the map as it is after a step; comes only where `wants_map` said so."""

    def on_checkpoint(self) -> None:
        """Put what was seen where it outlives the process: a run that goes on from here does not show it again."""

    def on_finish(self, result: RunResult) -> None:
        """See the outcome of the whole run, complete or not."""

    def close(self) -> None:
        """Release files and the like; called once, last, also where the run or another hook has failed."""


class Observers:
    """All observers of a run, called in the order in which they were given."""

    def __init__(self, observers: Iterable[Observer]) -> None:
        self._observers = tuple(observers)

    def on_start(self, info: RunInfo) -> None:
        """See `Observer`."""
        for observer in self._observers:
            observer.on_start(info)

    def on_step(self, step: StepResult, pipeline: Pipeline | KissIcpPipeline) -> None:
        """Show a step, and what it brought, to all."""
        if not self._observers:
            return
        step, view = read_only(step), RunView(pipeline, step)
        for observer in self._observers:
            observer.on_step(step, view)
        if any(attempt.status == "accepted" for attempt in step.closures):
            for observer in self._observers:
                observer.on_closure(step, view)
        for observer in [observer for observer in self._observers if observer.wants_map()]:
            observer.on_map(step, view.map())

    def on_checkpoint(self) -> None:
        """See `Observer`."""
        for observer in self._observers:
            observer.on_checkpoint()

    def on_finish(self, result: RunResult) -> list[Exception]:
        """Show the result to all, whatever becomes of some of them; returns what went wrong."""
        if not self._observers:
            return []
        result = read_only(result)
        return self._each(lambda observer: observer.on_finish(result))

    def close(self) -> list[Exception]:
        """Close all, whatever becomes of some of them; returns what went wrong."""
        return self._each(lambda observer: observer.close())

    def _each(self, call: Callable[[Observer], None]) -> list[Exception]:
        errors = []
        for observer in self._observers:
            try:
                call(observer)
            except Exception as error:  # the others must have their turn
                errors.append(error)
        return errors


def read_only(value: T) -> T:
    """Give a copy that cannot be written to: views of arrays, copies of dataclasses, tuples and dicts; no deeper."""
    frozen: T = _read_only(value)
    return frozen


def _read_only(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        view = value.view()
        view.flags.writeable = False
        return view
    if isinstance(value, tuple):
        return tuple(map(_read_only, value)) if value else value
    if isinstance(value, dict):
        return MappingProxyType({key: _read_only(item) for key, item in value.items()})
    if not dataclasses.is_dataclass(value) or isinstance(value, LaserModel | type):
        return value
    other = copy(value)
    # also what the instance has computed once and keeps, which is no field
    names = vars(other) if hasattr(other, "__dict__") else [f.name for f in dataclasses.fields(other)]
    for name in list(names):
        item = getattr(value, name)
        frozen = _read_only(item)
        if frozen is not item:
            object.__setattr__(other, name, frozen)
    return other
