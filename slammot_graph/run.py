"""A whole run: a log through a method, step by step, and its result at any time."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import islice

import numpy as np

from slammot_graph.baselines.kiss_icp import KissIcpConfig, KissIcpPipeline
from slammot_graph.core import se2
from slammot_graph.core.config import to_plain
from slammot_graph.core.errors import ConfigError, InputError, SlammotError
from slammot_graph.core.results import RunResult, StepResult
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.localization import FinalEstimate
from slammot_graph.logs import LaserLog
from slammot_graph.methods import Config, get_method
from slammot_graph.pipeline import Pipeline


def make_pipeline(config: Config) -> Pipeline | KissIcpPipeline:
    """Build what a method's configuration describes."""
    return KissIcpPipeline(config) if isinstance(config, KissIcpConfig) else Pipeline(config)


class Run:
    """Iterate it to run; ask for the `result` when the iteration has ended, early or not.

    Parameters
    ----------
    log : LaserLog
    method : str
        A name of the ladder.
    config : PipelineConfig or KissIcpConfig, optional
        In place of the method's own.
    max_range_m : float, optional
        In place of the configuration's `max_range_m`.
    max_scans : int, optional
        Take the log's first usable scans only, at least 1.

    Examples
    --------
    >>> run = Run(open_log("intel.clf.bz2"))                       # doctest: +SKIP
    >>> for step in run:                                           # doctest: +SKIP
    ...     print(step.scan.stamp, step.T_map_base, step.is_moving.sum())
    >>> run.result().T_map_base                                    # doctest: +SKIP
    """

    def __init__(
        self,
        log: LaserLog,
        method: str = "graph",
        *,
        config: Config | None = None,
        max_range_m: float | None = None,
        max_scans: int | None = None,
    ) -> None:
        if max_scans is not None and max_scans < 1:
            raise ConfigError(f"max_scans must be at least 1, not {max_scans}")
        self.log = log
        self.method = method
        self.config = config if config is not None else get_method(method).config
        if max_range_m is not None:
            self.config = replace(self.config, max_range_m=max_range_m)
        self.max_scans = max_scans
        self.pipeline = make_pipeline(self.config)
        self.is_complete = False
        self._kept = _Kept()
        self._final: FinalEstimate | None = None

    def __iter__(self) -> Iterator[StepResult]:
        """Run the log through; each scan's result comes as soon as it is there.

        Raises
        ------
        InputError
            No scan of the log was usable.
        """
        self.pipeline = make_pipeline(self.config)
        self.is_complete = False
        self._kept = _Kept()
        try:
            for scan in islice(self.log, self.max_scans):
                step = self.pipeline.step(scan)
                self._kept.keep(step)
                yield step
            if not self._kept.stamps:
                reasons = "; ".join(f"{s.place}: {s.reason}" for s in self.log.skipped[:3])
                raise InputError(
                    f"{self.log.path}: none of its {self.log.n_scans} scans is usable ({reasons})"
                )
            self.is_complete = True
        except BaseException:
            with suppress(SlammotError):  # the error that ended the run is the one to tell
                self._settle()
            raise
        self._settle()

    def _settle(self) -> None:
        """Take the optimised trajectory and the map, and end the pipeline."""
        try:
            self._final = self.pipeline.final()
            self._final_labels = self.pipeline.final_labels(self._final.T_map_base)
            self._grid = self.pipeline.render_map()
            self._moving_points = self._find_moving(self._final.T_map_base)
        finally:
            self.pipeline.close()

    def _find_moving(self, T_map_base: FloatArray) -> FloatArray:
        """(m, 2) moving points of all scans by the final labels, or else by those of the time; map frame."""
        if isinstance(self.pipeline, Pipeline) and self._final_labels is not None:
            return self.pipeline.moving_points(T_map_base, self._final_labels)
        found = [se2.transform(T_map_base[k], points) for k, points in self._kept.moving_base]
        return np.concatenate([np.empty((0, 2)), *found])

    def complete(self) -> RunResult:
        """Run to the end and give the result."""
        for _ in self:
            pass
        return self.result()

    def result(self) -> RunResult:
        """Give the result of all scans so far; call it after the iteration has ended, early or not."""
        kept, final = self._kept, self._final
        if final is None:
            raise SlammotError("no result: the run has not been iterated, or its pose graph failed")
        n = len(kept.stamps)
        online = _padded(kept.is_moving)
        is_moving = online if self._final_labels is None else _padded(self._final_labels)
        T_odom_base = np.array(kept.T_odom_base).reshape(-1, 3)
        start = se2.compose(final.T_map_base[0], se2.inverse(T_odom_base[0])) if n else se2.IDENTITY
        stage_names = list(dict.fromkeys(name for stages in kept.stage_ms for name in stages))
        return RunResult(
            method=self.method,
            config=to_plain(self.config),
            stamps=np.array(kept.stamps),
            T_map_base=final.T_map_base,
            T_map_odom_base=se2.compose(start[None, :], T_odom_base),
            cov_map=final.cov_map,
            is_valid=_padded(kept.is_valid),
            is_moving=is_moving,
            is_moving_online=online,
            p_moving=_padded(kept.p_moving, fill=np.nan),
            moving_points=self._moving_points,
            tracks=np.array(kept.tracks).reshape(-1, 10),
            grid=self._grid,
            node_scans=final.node_scans,
            nodes=final.nodes,
            edges=final.edges,
            stage_ms={
                name: np.array([stages.get(name, 0.0) for stages in kept.stage_ms]) for name in stage_names
            },
            nis=np.array(kept.nis),
            anchor_scans=np.array(kept.anchor_scans, dtype=np.int64),
            T_anchor_base=np.array(kept.T_anchor_base).reshape(-1, 3),
            cov_anchor_base=np.array(kept.cov_anchor_base).reshape(-1, 3, 3),
            T_world_base=np.array(kept.T_world_base) if n and len(kept.T_world_base) == n else None,
            n_failed_matches=kept.n_failed,
            n_skipped=len(self.log.skipped),
            events=tuple(kept.events),
            is_complete=self.is_complete,
        )


class _Kept:
    """What of each step goes into the result."""

    def __init__(self) -> None:
        self.stamps: list[float] = []
        self.T_odom_base: list[FloatArray] = []
        self.is_valid: list[BoolArray] = []
        self.is_moving: list[BoolArray] = []
        self.p_moving: list[np.ndarray] = []
        self.moving_base: list[tuple[int, np.ndarray]] = []
        self.tracks: list[list[float]] = []
        self.stage_ms: list[dict[str, float]] = []
        self.nis: list[float] = []
        self.anchor_scans: list[int] = []
        self.T_anchor_base: list[FloatArray] = []
        self.cov_anchor_base: list[FloatArray] = []
        self.T_world_base: list[FloatArray] = []
        self.n_failed = 0
        self.events: list[tuple[int, str]] = []

    def keep(self, step: StepResult) -> None:
        if step.is_moving.any():
            points = step.scan.points_base()[step.is_moving]
            self.moving_base.append((len(self.stamps), points.astype(np.float32)))
        self.stamps.append(step.scan.stamp)
        self.T_odom_base.append(step.scan.T_odom_base)
        self.is_valid.append(step.is_valid)
        self.is_moving.append(step.is_moving)
        self.p_moving.append(step.p_moving.astype(np.float16))
        self.stage_ms.append(dict(step.stage_ms))
        self.nis.append(step.innovation_nis)
        self.anchor_scans.append(step.anchor_scan)
        self.T_anchor_base.append(step.T_anchor_base)
        self.cov_anchor_base.append(step.cov_anchor_base)
        if step.scan.truth is not None and step.scan.truth.T_world_base is not None:
            self.T_world_base.append(step.scan.truth.T_world_base)
        self.n_failed += step.match is not None and step.match.status == "failed"
        self.events += [(event.scan, event.text) for event in step.events]
        for track in step.tracks:
            (xx, xy), (_, yy) = track.position_cov
            row = [step.scan.stamp, track.track_id, *track.position, *track.velocity, xx, xy, yy]
            self.tracks.append([float(value) for value in (*row, step.scan.index)])


def _padded(rows: list[np.ndarray], fill: float = 0.0) -> np.ndarray:
    """Stack rows of different lengths into (n, longest), filled up at the end."""
    if not rows:
        return np.zeros((0, 0), dtype=np.bool_)
    out = np.full((len(rows), max(map(len, rows))), fill, dtype=rows[0].dtype)
    for k, row in enumerate(rows):
        out[k, : len(row)] = row
    return out
