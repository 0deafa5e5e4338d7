"""What is computed at the end of a run from all of it; where a part fails, what is known without it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from slammot_graph.baselines.kiss_icp import KissIcpPipeline
from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GridMap
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization import FinalEstimate
from slammot_graph.mapping.tiled_grid import PartialMapError
from slammot_graph.pipeline import Pipeline
from slammot_graph.tracking.smoothing import SmoothedTracks

T = TypeVar("T")


class KeptSteps(Protocol):
    """What a run keeps of its steps."""

    def __len__(self) -> int: ...

    def online_estimate(self) -> FinalEstimate:
        """Give the poses as they were estimated at the time, without a graph."""

    def moving_points(self, T_map_base: FloatArray) -> FloatArray:
        """(m, 2) moving points of all scans by the labels of the time, map frame."""


@dataclass(kw_only=True, eq=False)
class Outcome:
    """What is computed at the end of a run from all of it, and what of that failed and why."""

    final: FinalEstimate
    labels: list[BoolArray] | None
    grid: GridMap
    moving_points: FloatArray
    tracks: SmoothedTracks | None
    failures: dict[str, Exception]


NOT_YET = "labels, tracks and map"
"""What a checkpoint leaves out, as `RunResult.failures` names it."""


def conclude_trajectory(pipeline: Pipeline | KissIcpPipeline, kept: KeptSteps) -> Outcome:
    """Compute the optimised trajectory alone, while the run goes on."""
    why = InputError("this is a checkpoint; `slammot-graph run LOG --output DIR --resume` goes on from it")
    failures: dict[str, Exception] = {NOT_YET: why}
    try:
        final = pipeline.final()
    except Exception as error:  # the poses of the time are still worth having
        final = kept.online_estimate()
        failures["optimised trajectory"] = error
    return Outcome(
        final=final,
        labels=None,
        grid=_no_map(pipeline.config.grid.resolution_m),
        moving_points=np.empty((0, 2)),
        tracks=None,
        failures=failures,
    )


def conclude(pipeline: Pipeline | KissIcpPipeline, kept: KeptSteps) -> Outcome:
    """Compute the optimised trajectory, the final labels and the map; where one fails, what is known without it."""
    failures: dict[str, Exception] = {}

    def attempt(what: str, compute: Callable[[], T], fallback: Callable[[], T]) -> T:
        try:
            return compute()
        except Exception as error:  # what was computed before must not be lost with it
            failures[what] = error
            return fallback()

    final = attempt("optimised trajectory", pipeline.final, kept.online_estimate)
    T_map_base = final.T_map_base
    labels = attempt("final labels", lambda: pipeline.final_labels(T_map_base), lambda: None)
    n = len(kept)
    # a step that was cut short may have left a pose or a label more
    labels = None if labels is None else labels[:n]

    def find_tracks() -> SmoothedTracks | None:
        return pipeline.final_tracks(T_map_base[:n], labels) if isinstance(pipeline, Pipeline) else None

    tracks = attempt("final tracks", find_tracks, lambda: None)

    def render_map() -> GridMap:
        if not isinstance(pipeline, Pipeline):
            return pipeline.render_map()
        try:
            return pipeline.render_map(T_map_base[:n], labels)
        except PartialMapError as error:
            failures["map"] = error
            return error.grid

    grid = attempt("map", render_map, lambda: _no_map(pipeline.config.grid.resolution_m))

    def find_moving() -> FloatArray:
        if isinstance(pipeline, Pipeline) and labels is not None:
            return pipeline.moving_points(T_map_base, labels)
        return kept.moving_points(T_map_base)

    moving_points = attempt("moving points", find_moving, lambda: kept.moving_points(T_map_base))
    final = replace(final, T_map_base=T_map_base[:n], cov_map=final.cov_map[:n])
    return Outcome(
        final=final,
        labels=labels,
        grid=grid,
        moving_points=moving_points,
        tracks=tracks,
        failures=failures,
    )


def _no_map(resolution_m: float) -> GridMap:
    return GridMap(p_occupied=np.full((1, 1), np.nan), resolution_m=resolution_m, origin=np.zeros(2))
