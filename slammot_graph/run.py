"""A whole run: a source of scans through a method, step by step, and its result at any time."""

import weakref
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from slammot_graph.baselines.kiss_icp import KissIcpPipeline
from slammot_graph.conclusion import Outcome, conclude, conclude_trajectory
from slammot_graph.core import se2
from slammot_graph.core._numba import is_compiled
from slammot_graph.core.config import to_plain
from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.frozen_state import FrozenRun
from slammot_graph.core.results import RunResult, StepResult
from slammot_graph.core.saved_map import MapStart
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.diagnosis import as_mounted, diagnose, findings_of_map
from slammot_graph.logs import describe
from slammot_graph.logs.source import SkippedScan
from slammot_graph.methods import Config, get_method
from slammot_graph.observer import Observer, Observers, RunInfo
from slammot_graph.pipeline import Pipeline
from slammot_graph.registration._solve_kernels import match_point_to_line
from slammot_graph.session import Session, fingerprint, make_pipeline
from slammot_graph.tracking.smoothing import SmoothedTracks

__all__ = ["Run", "has_compiled_kernels", "make_pipeline"]


def has_compiled_kernels() -> bool:
    """Tell whether the machine code of the kernels lies on disk: without it the first scans wait for the compiler."""
    return is_compiled(match_point_to_line)


class Run:
    """Iterate it to run; ask for the `result` at any time, also while it runs.

    Each iteration is a run of its own from the source's beginning and ends the one before; `result` is that of the
    latest. As a context manager it ends a run that was left early.

    Parameters
    ----------
    log : iterable of Scan
        A `LaserLog`, or any other source of scans, as some of a log's; they are counted anew. A live one need not know
        its length and is not read twice. Where the mounting of a recorded laser is only assumed, and for the robot's
        own body, its beginning is read before.
    method : str
        A name of the method registry.
    config : PipelineConfig or KissIcpConfig, optional
        In place of the method's own.
    max_range_m : float, optional
        In place of the configuration's `max_range_m`.
    max_scans : int, optional
        Take the log's first usable scans only, at least 1.
    observers : iterable of Observer
        Are shown each step; they cannot change the estimate.
    start : MapStart, optional
        A saved map to start from: the robot's place there is looked for, and poses are in its frame once it is found.
        While it is not, the health of the scans is "lost".

    Examples
    --------
    >>> run = Run(open_log("intel.clf.bz2"))                       # doctest: +SKIP
    >>> for step in run:                                           # doctest: +SKIP
    ...     print(step.scan.stamp, step.T_map_base, step.is_moving.sum())
    >>> run.result().T_map_base                                    # doctest: +SKIP
    """

    def __init__(
        self,
        log: Iterable[Scan],
        method: str = "graph",
        *,
        config: Config | None = None,
        max_range_m: float | None = None,
        max_scans: int | None = None,
        observers: Iterable[Observer] = (),
        start: MapStart | None = None,
    ) -> None:
        if max_scans is not None and max_scans < 1:
            raise ConfigError(f"max_scans must be at least 1, not {max_scans}")
        self.log: Iterable[Scan] = as_mounted(log)
        self.method = method
        self.config = config if config is not None else get_method(method).config
        if max_range_m is not None:
            self.config = replace(self.config, max_range_m=max_range_m)
        self.max_scans = max_scans
        self._observers = Observers(observers)
        self.start = start
        self._session = Session.begin(self.config, start)
        self._steps: weakref.ref[Generator[StepResult, None, None]] | None = None

    @property
    def pipeline(self) -> Pipeline | KissIcpPipeline:
        """What computes the latest run."""
        return self._session.pipeline

    @property
    def is_complete(self) -> bool:
        """Whether the latest run took all scans."""
        return self._session.is_complete

    def __iter__(self) -> Iterator[StepResult]:
        """Run the log through; each scan's result comes as soon as it is there.

        Raises
        ------
        InputError
            No scan of the log was usable.
        Exception
            Whatever ended the run, or went wrong at its end; `result` has what was computed nevertheless.
        """
        self.close()
        if self._session.is_started:
            self._session = Session.begin(self.config, self.start)
        self._session.is_started = True
        steps = self._run(self._session)
        self._steps = weakref.ref(steps)
        return steps

    def _run(self, session: Session) -> Generator[StepResult, None, None]:
        try:
            self._observers.on_start(self._info())
            session.is_observed = True
            scans = _numbered(islice(self.log, self.max_scans))
            if session.frozen is not None:
                session.thaw(scans)
            for scan in scans:
                session.see(scan)
                step = session.pipeline.step(scan)
                session.kept.keep(step)
                session.statistics.add(step)
                self._observers.on_step(step, session.pipeline)
                yield step
            if not len(session.kept):
                raise InputError(self._why_nothing())
            session.is_complete = True
        except BaseException as error:
            errors = self._settle(session)
            if errors and isinstance(error, GeneratorExit):
                raise errors[0] from None
            for other in errors:  # the error that ended the run is the one to tell
                error.add_note(f"at the end of the run: {other}")
            raise
        errors = self._settle(session)
        if errors:
            raise errors[0]

    def _settle(self, session: Session) -> list[Exception]:
        """Compute what there is at the end, show it to the observers and close all; returns what went wrong."""
        errors: list[Exception] = []
        try:
            session.outcome = conclude(session.pipeline, session.kept)
            errors += session.outcome.failures.values()
            if session.is_observed:
                errors += self._observers.on_finish(self._result(session))
        finally:
            errors += self._observers.close()
            session.pipeline.close()
        return errors

    def _info(self) -> RunInfo:
        n_scans = getattr(self.log, "n_scans", None)
        limits = [n for n in (n_scans, self.max_scans) if n is not None]
        return RunInfo(
            method=self.method,
            config=to_plain(self.config),
            log_path=getattr(self.log, "path", None),
            n_scans=min(limits) if n_scans is not None else None,
        )

    def _why_nothing(self) -> str:
        """Say why there was no scan."""
        reasons = "; ".join(f"{s.place}: {s.reason}" for s in _skipped(self.log)[:3])
        path, n_scans = getattr(self.log, "path", None), getattr(self.log, "n_scans", None)
        if path is None or n_scans is None:
            return "the source gave no usable scan" + (f" ({reasons})" if reasons else "")
        return f"{path}: none of its {n_scans} scans is usable ({reasons})"

    def complete(self) -> RunResult:
        """Run to the end and give the result."""
        for _ in self:
            pass
        return self.result()

    def result(self) -> RunResult:
        """Give the result of all scans so far.

        While the run goes on, each call optimises the graph's copy, renders the map and labels all scans anew, which
        does not change the run. What cannot be computed is told in `RunResult.failures`.
        """
        return self._result(self._session)

    def trajectory(self) -> RunResult:
        """Give what is known of all scans so far but the final labels, the tracks and the map, which take long."""
        session = self._session
        return self._result(session, conclude_trajectory(session.pipeline, session.kept))

    def freeze(self) -> FrozenRun:
        """Give the state between two steps, from which another `Run` of the same log can go on: see `resume`.

        The observers are told, that they may keep what they have seen. For a method whose state cannot be kept the
        state is None, and what goes on from it does all of the scans again.
        """
        self._observers.on_checkpoint()
        return self._session.freeze(self._fingerprint())

    def resume(self, frozen: FrozenRun) -> None:
        """Let the next iteration go on from a state of `freeze`: it ends as one that was never interrupted, bit by bit.

        It reads the log from its beginning, and yields the steps from there on.

        Raises
        ------
        InputError
            The state is of another method, configuration or version; later, from the iteration: of another log.
        """
        frozen.check(self._fingerprint())
        self.close()
        self._session.frozen = frozen

    @property
    def n_scans(self) -> int:
        """Scans that the latest run has taken."""
        return len(self._session.kept)

    def _fingerprint(self) -> dict[str, str]:
        return fingerprint(self.method, self.config, self.start)

    def close(self) -> None:
        """End the run if it has not ended yet; may be called twice.

        Raises
        ------
        Exception
            Something went wrong at the end; `result` has what was computed nevertheless.
        """
        steps = None if self._steps is None else self._steps()
        if steps is not None:
            steps.close()
        self._steps = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _result(self, session: Session, outcome: Outcome | None = None) -> RunResult:
        outcome = outcome or session.outcome or conclude(session.pipeline, session.kept)
        kept, final = session.kept, outcome.final
        rows = kept.rows()
        is_valid, online, p_moving = kept.beams()
        is_moving = online if outcome.labels is None else _padded(outcome.labels)
        log, report = describe(self.log), session.pipeline.odometry_report()
        tracks, is_track_seen = tracks_online, is_seen_online = kept.tracks()
        if outcome.tracks is not None:
            tracks, is_track_seen = _track_rows(outcome.tracks, rows), outcome.tracks.is_seen
        return RunResult(
            method=self.method,
            config=to_plain(self.config),
            stamps=rows["stamp"].copy(),
            T_map_base=final.T_map_base,
            T_map_odom_base=_odometry_in_map(rows["T_odom_base"], final.T_map_base),
            cov_map=final.cov_map,
            is_valid=is_valid,
            is_moving=is_moving,
            is_moving_online=online,
            p_moving=p_moving,
            moving_points=outcome.moving_points,
            tracks=tracks,
            is_track_seen=is_track_seen,
            tracks_online=tracks_online,
            is_track_online_seen=is_seen_online,
            T_map_base_online=rows["T_map_base"].copy(),
            objects=() if outcome.tracks is None else outcome.tracks.objects,
            grid=outcome.grid,
            node_scans=final.node_scans,
            nodes=final.nodes,
            edges=final.edges,
            stage_ms=kept.stage_ms(),
            nis=rows["nis"].copy(),
            anchor_scans=rows["anchor_scan"].copy(),
            T_anchor_base=rows["T_anchor_base"].copy(),
            cov_anchor_base=rows["cov_anchor_base"].copy(),
            T_world_base=rows["T_world_base"].copy() if len(rows) and rows["has_truth"].all() else None,
            n_failed_matches=kept.n_failed,
            n_skipped=len(_skipped(self.log)),
            events=tuple(kept.events),
            is_complete=session.is_complete and not outcome.failures,
            log=log,
            failures=tuple(f"{what}: {error}" for what, error in outcome.failures.items()),
            health=kept.health(),
            odometry=report,
            verdict=(
                *diagnose(session.statistics, report, log.warnings),
                *findings_of_map(outcome.grid, self.config.grid.resolution_m),
            ),
            laser=rows["laser"].astype(np.int64),
            saved_map=final.saved_map,
            is_changed=None if outcome.is_changed is None else _padded(outcome.is_changed),
            **_changed_cells(outcome),
        )


def _changed_cells(outcome: Outcome) -> dict[str, FloatArray]:
    """What stands where nothing was, and what is there no more, as arguments of a `RunResult`."""
    if outcome.changes is None:
        return {}
    return {"new_points": outcome.changes.new_points, "gone_points": outcome.changes.gone_points}


def _track_rows(tracks: SmoothedTracks, rows: npt.NDArray[Any]) -> FloatArray:
    """(k, 10) rows of smoothed tracks, the columns `TRACK_COLUMNS`."""
    stamps, indices = rows["stamp"][tracks.scans], rows["index"][tracks.scans]
    covs = tracks.covs[:, [0, 0, 1], [0, 1, 1]]
    return np.column_stack([stamps, tracks.ids, tracks.states, covs, indices])


def _numbered(scans: Iterable[Scan]) -> Iterator[Scan]:
    """Count scans from 0, as all that is kept of them is addressed."""
    for number, scan in enumerate(scans):
        yield scan if scan.index == number else replace(scan, index=number)


def _skipped(log: Any) -> Sequence[SkippedScan]:
    """Scans that a source has left out so far; empty where it does not tell."""
    return getattr(log, "skipped", ())


def _odometry_in_map(T_odom_base: FloatArray, T_map_base: FloatArray) -> FloatArray:
    """(n, 3) odometry, moved to start where the trajectory (n, 3) does; NaN where there is none."""
    known = np.flatnonzero(np.isfinite(T_odom_base[:, 0]))
    if not len(known):
        return T_odom_base.copy()
    start = se2.compose(T_map_base[known[0]], se2.inverse(T_odom_base[known[0]]))
    return se2.compose(start[None, :], T_odom_base)


def _padded(rows: Sequence[BoolArray]) -> BoolArray:
    """Stack rows of different lengths into (n, longest), filled up at the end."""
    out = np.zeros((len(rows), max(map(len, rows), default=0)), dtype=np.bool_)
    for k, row in enumerate(rows):
        out[k, : len(row)] = row
    return out
