"""The verdict on a log without a run folder: all scans are inspected, and the first ones matched."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from slammot_graph.core.errors import InputError
from slammot_graph.core.findings import Finding
from slammot_graph.core.log_info import LogInfo
from slammot_graph.core.odometry_report import OdometryReport
from slammot_graph.core.results import Health
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.diagnosis.inspect import ScanStatistics, limits_of
from slammot_graph.diagnosis.mounting import with_found_mounting
from slammot_graph.diagnosis.odometry import OdometryStatistics
from slammot_graph.diagnosis.own_body import Source, without_own_body
from slammot_graph.diagnosis.statistics import RunStatistics
from slammot_graph.diagnosis.sweep import with_found_sweeps
from slammot_graph.diagnosis.verdict import diagnose
from slammot_graph.logs.remounted import RemountedLog
from slammot_graph.logs.source import LaserLog, describe
from slammot_graph.methods import get_method
from slammot_graph.pipeline import Pipeline, PipelineConfig

BUDGET_S = 6.0
"""Scans are matched as long as the rest of the log can still be read and inspected in this time."""

MIN_MATCHED = 200
"""So many scans are matched in any case."""

METHOD = "graph-noloop"


@dataclass(frozen=True, kw_only=True, eq=False)
class CheckReport:
    """What is known of a log without a run.

    Attributes
    ----------
    scans : ScanStatistics
        Of the whole log.
    raw_odometry : OdometryStatistics
        Of the whole log; its estimates are those of the scans that were matched.
    n_matched_scans : int
        So many of the first scans were matched.
    n_skipped : int
    health : mapping of state to int
        Of the scans that were matched.
    odometry : OdometryReport
    log : LogInfo
    verdict : tuple of Finding
    """

    scans: ScanStatistics
    raw_odometry: OdometryStatistics
    n_matched_scans: int
    n_skipped: int
    health: dict[Health, int]
    odometry: OdometryReport
    log: LogInfo
    verdict: tuple[Finding, ...]


def as_mounted(log: Source) -> Source | RemountedLog:
    """Give a log as a run uses it: with beam times and mounting that the drive tells of, without the robot's body."""
    return without_own_body(with_found_mounting(with_found_sweeps(log)))


def check_log(
    log: LaserLog,
    *,
    max_range_m: float | None = None,
    budget_s: float = BUDGET_S,
    show: Callable[[int], None] = lambda n_scans: None,
) -> CheckReport:
    """Inspect all scans of a log, and match the first ones without loop closure, as many as fit into the time.

    Parameters
    ----------
    log : LaserLog
    max_range_m : float, optional
        Farther returns are left aside; by default as the method says.
    budget_s : float
        Time for all [s] but the first scan, which takes long when kernels are loaded; a log that takes longer to read
        is read to its end nevertheless.
    show : callable
        Is told the number of scans done.

    Raises
    ------
    InputError
        The log cannot be read, or none of its scans is usable.
    """
    config = _config(max_range_m)
    limits = limits_of(config)
    log = as_mounted(log)
    statistics = RunStatistics(limits)
    # what the matches tell is known of the first scans only, what the scans tell of all
    scans, raw_odometry = ScanStatistics(limits), OdometryStatistics()
    n_matched = 0
    budget = _Budget(budget_s)
    with Pipeline(config) as pipeline:
        for n_scans, scan in enumerate(log, start=1):
            scans.add(scan)
            if n_scans <= MIN_MATCHED or budget.has_left(log.n_scans - n_scans):
                with budget.matching():
                    step = pipeline.step(scan)
                statistics.add(step)
                T_map_base, n_matched = step.T_map_base, n_scans
            raw_odometry.add(scan.stamp, scan.T_odom_base, T_map_base)
            show(n_scans)
        report = pipeline.odometry_report()
    if not scans.n_scans:
        reasons = "; ".join(f"{skipped.place}: {skipped.reason}" for skipped in log.skipped[:3])
        raise InputError(f"{log.path}: none of its {log.n_scans} scans is usable ({reasons})")
    statistics.scans, statistics.odometry = scans, raw_odometry
    info = describe(log)
    return CheckReport(
        scans=scans,
        raw_odometry=raw_odometry,
        n_matched_scans=n_matched,
        n_skipped=len(log.skipped),
        health=dict(statistics.health),
        odometry=report,
        log=info,
        verdict=diagnose(statistics, report, info.warnings),
    )


class _Budget:
    """Keeps time for reading what is left of a log; begins with the second scan, for the first loads kernels."""

    def __init__(self, budget_s: float) -> None:
        self._budget_s = budget_s
        self._start_s = math.nan
        self._matching_s = 0.0
        self._n_scans = 0

    def has_left(self, n_scans: int) -> bool:
        """Whether there is time for another match, and for reading so many scans more; once false, always false."""
        took_s = time.perf_counter() - self._start_s
        reading_s = max(took_s - self._matching_s, 0.0) / max(self._n_scans, 1)
        if took_s + reading_s * max(n_scans, 0) > self._budget_s:
            self._budget_s = -math.inf
        return self._budget_s > 0.0

    @contextmanager
    def matching(self) -> Iterator[None]:
        """Measure a match."""
        start = time.perf_counter()
        yield
        now = time.perf_counter()
        if math.isnan(self._start_s):
            self._start_s = now
            return
        self._matching_s += now - start
        self._n_scans += 1


def _config(max_range_m: float | None) -> PipelineConfig:
    """Give the method's configuration without what is made for the end of a run."""
    config = get_method(METHOD).config
    assert isinstance(config, PipelineConfig)
    assert isinstance(config.detector, EllipseDetectorConfig)
    config = replace(config, detector=replace(config.detector, backward_pass=False))
    return config if max_range_m is None else replace(config, max_range_m=max_range_m)
