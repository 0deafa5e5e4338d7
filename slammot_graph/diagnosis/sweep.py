"""When a laser that turns sends out its beams, where a log may tell wrong: at once, one after the other, or in reverse.

Drivers of cheap lasers give the time between beams in the wrong unit, or none, or list the beams against the order in
which they were sent out. The scans are then bent where the robot turns, and so is the path. The first scans are
localized by the laser alone under each assumption; the one under which most returns agree with the map while the robot
turns is used where that stands out of the noise, in a paired test that allows for neighbours that go together.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.stats import rankdata

from slammot_graph.core import se2
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.scan import Scan
from slammot_graph.core.types import FloatArray
from slammot_graph.diagnosis.inspect import FULL_TURN
from slammot_graph.diagnosis.mounting import by_laser_alone
from slammot_graph.diagnosis.own_body import Source
from slammot_graph.diagnosis.turns import agreement_of
from slammot_graph.logs import source_of
from slammot_graph.logs.remounted import RemountedLog
from slammot_graph.logs.source import LaserLog, beginning_of
from slammot_graph.methods import get_method
from slammot_graph.odometry.robust_fit import long_run_variance
from slammot_graph.pipeline import Pipeline
from slammot_graph.pipeline_config import PipelineConfig

WHOLE_TURN_RAD = math.radians(340.0)
"""Lasers that see less seldom sweep slowly, and their drivers tell of it."""

LONG = 0.5
"""A sweep that is told to last so much of the time from scan to scan may be right; its order may be wrong."""

N_PERIOD = 20
"""The time from scan to scan is the median of the first ones."""

TURNING_RAD, MAX_TURN_RAD = 0.02, 1.0
"""Scans between which the robot turns by more than the first are compared; more than the second is no turn."""

MIN_TURNING, MAX_TURNING, MAX_SCANS = 20, 160, 800
"""Turning scans needed, after as many of which it is looked at anew; looked at most; scans read at most."""

MIN_SIGMA, SURE_SIGMA = 3.5, 6.0
"""Standard deviations by which an assumption must agree more than what is told; by which no more scans are read.

By the first the best one must also lead the others that are not told, where no more scans are read.
"""

TOLD_SO = "time_increment"
"""Words of the log's warnings that what was found takes the place of."""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """How a laser sends out its beams.

    Attributes
    ----------
    duration_s : float
        From the first beam to the last one; 0: all at once.
    is_reversed : bool
        The last beam comes first.
    """

    duration_s: float = 0.0
    is_reversed: bool = False

    def beam_times(self, n_beams: int) -> FloatArray | None:
        """(n_beams,) since the stamp [s]; None: at once. Scans share the array."""
        return None if self.duration_s == 0.0 else _spread(self.duration_s, n_beams, self.is_reversed)

    def __str__(self) -> str:
        if self.duration_s == 0.0:
            return "beams sent out at once"
        order = "from the last beam to the first" if self.is_reversed else "from the first beam to the last"
        return f"a sweep of {self.duration_s:.2g} s {order}"


@cache
def _spread(duration_s: float, n_beams: int, is_reversed: bool) -> FloatArray:
    times: FloatArray = np.linspace(0.0, duration_s, n_beams)
    times = times[::-1].copy() if is_reversed else times
    times.setflags(write=False)
    return times


@dataclass(frozen=True, kw_only=True)
class FoundSweep:
    """A sweep that differs from what the log tells.

    Attributes
    ----------
    sweep, told : Sweep
    period_s : float
        From scan to scan.
    gain : float
        So much larger a share of the returns agrees while the robot turns ...
    sigma : float
        ... which is so many standard deviations.
    """

    sweep: Sweep
    told: Sweep
    period_s: float
    gain: float
    sigma: float


def with_found_sweeps(log: Source) -> Source | RemountedLog:
    """Give a log from a file with the beam times that its drive tells of, where it may be wrong; others as they are."""
    source = source_of(log)
    if "laser_pose" not in source or not isinstance(log, LaserLog):
        return log
    try:
        found = find_sweeps(log, has_own_times="cloud_topic" in source)
    except SlammotError:  # the log ends here, or cannot be localized: the run comes to it, and tells
        return log
    if not found:
        return log

    def timed(scan: Scan) -> Scan:
        sweep = found.get(scan.laser.number)
        return scan if sweep is None else replace(scan, beam_times=sweep.sweep.beam_times(scan.laser.n_beams))

    warnings = [_warning(number, sweep, len(found)) for number, sweep in found.items()]
    return RemountedLog(log, mend=timed, warnings=warnings, replaces=TOLD_SO)


def _warning(number: int, found: FoundSweep, n_found: int) -> str:
    laser = f" of laser {number}" if n_found > 1 else ""
    return (
        f"time_increment{laser} tells of {found.told} where scans come every {found.period_s:.2g} s;"
        f" {100 * found.gain:.1f}% more of the returns agree with the map in turns ({found.sigma:.1f} standard"
        f" deviations) under {found.sweep}, which is used instead: correct the driver or the log"
    )


def find_sweeps(log: Iterable[Scan], *, has_own_times: bool = False) -> dict[int, FoundSweep]:
    """Find how the lasers of a log send out their beams, by number, where that is not as told.

    Parameters
    ----------
    log : iterable of Scan
    has_own_times : bool
        Where scans have beam times these are measured, as those of clouds.
    """
    trials: dict[int, _Trial] = {}
    try:
        with beginning_of(log) as scans:
            for n_scans, scan in enumerate(scans, start=1):
                if _may_be_wrong(scan, has_own_times=has_own_times):
                    trials.setdefault(scan.laser.number, _Trial()).add(scan)
                is_settled = all(trial.is_settled for trial in trials.values())
                if n_scans >= MAX_SCANS or (n_scans >= N_PERIOD and is_settled):
                    break
        found = {number: trial.found() for number, trial in trials.items()}
    finally:
        for trial in trials.values():
            trial.close()
    return {number: sweep for number, sweep in found.items() if sweep is not None}


def _may_be_wrong(scan: Scan, *, has_own_times: bool) -> bool:
    """Tell whether a laser looks all round, and no farther, and its beams have no times, or those of a driver."""
    if not WHOLE_TURN_RAD <= scan.laser.field_of_view_rad <= 2.0 * math.pi * FULL_TURN:
        return False
    return scan.beam_times is None or not has_own_times


def _told(scan: Scan) -> Sweep:
    """What the log says of a scan's beams."""
    if scan.beam_times is None:
        return Sweep()
    first, last = float(scan.beam_times[0]), float(scan.beam_times[-1])
    return Sweep(duration_s=abs(last - first), is_reversed=last < first)


def _assumptions(told: Sweep, period_s: float, span_rad: float) -> list[Sweep]:
    """What may be, the first as told."""
    whole_s = period_s * min(span_rad / (2.0 * math.pi), 1.0)
    if told.duration_s >= LONG * whole_s:
        return [told, replace(told, is_reversed=not told.is_reversed), Sweep()]
    return [told, Sweep(duration_s=whole_s), Sweep(duration_s=whole_s, is_reversed=True)]


class _Assumed:
    """The scans localized by the laser alone as if it swept so."""

    def __init__(self, sweep: Sweep, config: PipelineConfig) -> None:
        self.sweep = sweep
        self.agreement: list[float] = []
        self._pipeline = Pipeline(config)
        self._T_before: FloatArray | None = None

    def add(self, scan: Scan, index: int) -> tuple[float, float]:
        """Take in the next scan; gives the turn since the one before [rad], and the share of returns that agree."""
        beam_times = self.sweep.beam_times(scan.laser.n_beams)
        step = self._pipeline.step(replace(by_laser_alone(scan), index=index, beam_times=beam_times))
        before, self._T_before = self._T_before, step.T_map_base
        turn_rad = 0.0 if before is None else abs(float(se2.wrap_angle(step.T_map_base[2] - before[2])))
        return turn_rad, agreement_of(step)

    def close(self) -> None:
        self._pipeline.close()


class _Trial:
    """One laser's scans under each assumption."""

    def __init__(self) -> None:
        self._first: list[Scan] = []
        self._assumed: list[_Assumed] = []
        self._period_s = math.nan
        self._n_scans = 0
        self.is_settled = False

    def add(self, scan: Scan) -> None:
        """Take in the next scan of the laser."""
        if self.is_settled:
            return
        if self._assumed:
            self._compare(scan)
            return
        self._first.append(scan)
        if len(self._first) == N_PERIOD:
            self._begin()

    def found(self) -> FoundSweep | None:
        """The sweep under which more returns agree than as told; None: as told, or not known."""
        if not self._assumed or len(self._assumed[0].agreement) < MIN_TURNING:
            return None
        agreement = self._agreement()
        best = int(agreement.mean(axis=1).argmax())
        gain, sigma = _lead(agreement[best], agreement[0])
        if best == 0 or sigma < MIN_SIGMA:
            return None
        sweeps = [x.sweep for x in self._assumed]
        return FoundSweep(sweep=sweeps[best], told=sweeps[0], period_s=self._period_s, gain=gain, sigma=sigma)

    def close(self) -> None:
        """End the pipelines."""
        for assumed in self._assumed:
            assumed.close()

    def _begin(self) -> None:
        """Know the time from scan to scan, and begin with the scans waiting."""
        steps_s = np.diff([scan.stamp for scan in self._first])
        steps_s = steps_s[steps_s > 0.0]
        self.is_settled = 2 * len(steps_s) < N_PERIOD
        if self.is_settled:
            return
        self._period_s = float(np.median(steps_s))
        config = get_method("graph-noloop").config
        assert isinstance(config, PipelineConfig)
        told, span_rad = _told(self._first[0]), self._first[0].laser.field_of_view_rad
        self._assumed = [_Assumed(sweep, config) for sweep in _assumptions(told, self._period_s, span_rad)]
        for scan in self._first:
            self._compare(scan)
        self._first.clear()

    def _compare(self, scan: Scan) -> None:
        """Localize a scan under each assumption."""
        found = [assumed.add(scan, self._n_scans) for assumed in self._assumed]
        self._n_scans += 1
        if not TURNING_RAD < float(np.median([turn_rad for turn_rad, _ in found])) < MAX_TURN_RAD:
            return
        for assumed, (_, agreement) in zip(self._assumed, found, strict=True):
            assumed.agreement.append(agreement)
        n_turning = len(self._assumed[0].agreement)
        if n_turning % MIN_TURNING == 0:
            self.is_settled = n_turning >= MAX_TURNING or self._is_sure()

    def _agreement(self) -> FloatArray:
        """(assumptions, turning scans) share of the returns that agree."""
        return np.array([x.agreement for x in self._assumed])

    def _is_sure(self) -> bool:
        """Whether one assumption leads what is told by far, and the others clearly; or what is told all by far."""
        agreement = self._agreement()
        best = int(agreement.mean(axis=1).argmax())
        return all(
            _lead(agreement[best], other)[1] > (MIN_SIGMA if best and k else SURE_SIGMA)
            for k, other in enumerate(agreement)
            if k != best
        )


def _lead(one: FloatArray, other: FloatArray) -> tuple[float, float]:
    """By how much (n,) values are larger in the mean than others of the same scans, and by how many stds.

    The second is that of the signed ranks of the differences (Wilcoxon, 1945): single scans differ by much.
    """
    lead = one - other
    signed_ranks = np.sign(lead) * rankdata(np.abs(lead))
    variance = float(long_run_variance(signed_ranks[:, None])[0, 0])
    return float(lead.mean()), float(signed_ranks.sum()) / math.sqrt(variance) if variance > 0.0 else 0.0
