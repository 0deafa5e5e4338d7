"""What is computed at the end of a run from all of it; where a part fails, what is known without it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from slammot_graph.baselines.kiss_icp import KissIcpPipeline
from slammot_graph.core.errors import InputError
from slammot_graph.core.results import GridMap
from slammot_graph.core.saved_map import SavedMap
from slammot_graph.core.saved_map_parts import points_in_map, with_submaps, without_points
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization import FinalEstimate
from slammot_graph.mapping.changes import Changes, covering_all, find_changes, joint_map
from slammot_graph.mapping.saved_grid import render_saved_map
from slammot_graph.mapping.tiled_grid import PartialMapError
from slammot_graph.pipeline import Pipeline
from slammot_graph.tracking.smoothing import SmoothedTracks

T = TypeVar("T")
_Comparison = tuple[Changes | None, list[BoolArray] | None, GridMap]


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
    changes: Changes | None
    is_changed: list[BoolArray] | None
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
        changes=None,
        is_changed=None,
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

    all_labels = labels
    tracks = attempt("final tracks", lambda: _tracks(pipeline, T_map_base[:n], all_labels), lambda: None)
    labels = attempt(
        "labels by tracks",
        lambda: _with_tracks(pipeline, T_map_base[:n], all_labels, tracks),
        lambda: all_labels,
    )

    def render_map() -> GridMap:
        if not isinstance(pipeline, Pipeline):
            return pipeline.render_map()
        try:
            return pipeline.render_map(T_map_base[:n], labels)
        except PartialMapError as error:
            failures["map"] = error
            return error.grid

    seen = attempt("map", render_map, lambda: _no_map(pipeline.config.grid.resolution_m))
    compared: _Comparison = (None, None, seen)
    if "map" not in failures:
        compared = attempt(
            "changes", lambda: _compared(pipeline, final, labels, seen, n), lambda: (None, None, seen)
        )
    changes, is_changed, grid = compared
    final = replace(final, saved_map=_kept_map(final, changes))

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
        changes=changes,
        is_changed=is_changed,
        moving_points=moving_points,
        tracks=tracks,
        failures=failures,
    )


def _tracks(
    pipeline: Pipeline | KissIcpPipeline, T_map_base: FloatArray, labels: list[BoolArray] | None
) -> SmoothedTracks | None:
    return pipeline.final_tracks(T_map_base, labels) if isinstance(pipeline, Pipeline) else None


def _with_tracks(
    pipeline: Pipeline | KissIcpPipeline,
    T_map_base: FloatArray,
    labels: list[BoolArray] | None,
    tracks: SmoothedTracks | None,
) -> list[BoolArray] | None:
    """Take back the labels that no track supports."""
    if not isinstance(pipeline, Pipeline) or labels is None or tracks is None:
        return labels
    return pipeline.labels_with_tracks(T_map_base, labels, tracks)


def _compared(
    pipeline: Pipeline | KissIcpPipeline,
    final: FinalEstimate,
    labels: list[BoolArray] | None,
    grid: GridMap,
    n: int,
) -> _Comparison:
    """Find what has changed since the map that the run started from was made; gives the map of both, too."""
    if not isinstance(pipeline, Pipeline) or final.earlier is None:
        return None, None, grid
    before = render_saved_map(final.earlier, pipeline.config.grid, pipeline.config.final_map)
    changes = find_changes(before, grid)
    is_changed = pipeline.changed_points(final.T_map_base[:n], changes, labels)
    return changes, is_changed, joint_map(before, grid)


def _kept_map(final: FinalEstimate, changes: Changes | None) -> SavedMap | None:
    """Leave out what is gone, and the local maps of known places that show nothing new."""
    saved = final.saved_map
    if saved is None:
        return None
    is_kept = np.arange(len(saved.submaps)) < len(saved.submaps) - final.n_spare
    if changes is None or final.earlier is None:
        return with_submaps(saved, is_kept)
    points, n = points_in_map(saved), len(saved.keyframe_sizes)
    owner = np.repeat(np.arange(n), saved.keyframe_sizes)
    cells = changes.new_cells(points)
    cells_of = [np.unique(cells[np.isin(owner, rows) & (cells >= 0)]) for rows in saved.submaps]
    is_kept |= covering_all(cells_of, is_kept)
    is_earlier = np.zeros(n, dtype=np.bool_)
    for rows in saved.submaps[: len(final.earlier.submaps)]:
        is_earlier[rows] = True
    return without_points(saved, changes.are_gone(points) & is_earlier[owner], is_kept)


def _no_map(resolution_m: float) -> GridMap:
    return GridMap(p_occupied=np.full((1, 1), np.nan), resolution_m=resolution_m, origin=np.zeros(2))
