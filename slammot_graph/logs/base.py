"""The loop that all formats share: check each record, list the skipped ones, number the rest."""

import math
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from slammot_graph.core.errors import InputError, SlammotError
from slammot_graph.core.log_info import SourceInfo
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.scan import LaserModel, Scan, ScanTruth
from slammot_graph.core.types import FloatArray
from slammot_graph.logs.no_return_values import NoReturnValues
from slammot_graph.logs.source import SkippedScan

MAX_STEP_S = 60.0
"""A longer step between two stamps is worth a warning."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RawScan:
    """A decoded record, usable or not; its fields are those of `Scan`, and `place` that of `SkippedScan`."""

    place: str
    stamp: float
    ranges: FloatArray
    laser: LaserModel
    T_odom_base: FloatArray | None
    truth: ScanTruth | None = None
    odometry: OdometryTrack | None = None
    imu_yaw: float | None = None
    beam_times: FloatArray | None = None


Records: TypeAlias = Generator[RawScan | SkippedScan, None, None]


class RecordedLog(ABC):
    """A `LaserLog` of a format that only has to decode its records.

    Parameters
    ----------
    path : Path
    n_scans : int
        Scan records in the file.
    opening_warnings : sequence of str
        Warnings that hold for every iteration.
    source : SourceInfo, optional
        What of the file is used, as `source_of` gives it.
    """

    def __init__(
        self,
        path: Path,
        *,
        n_scans: int,
        opening_warnings: Sequence[str] = (),
        source: SourceInfo | None = None,
    ) -> None:
        self.path = path
        self.n_scans = n_scans
        self.skipped: list[SkippedScan] = []
        self.warnings: list[str] = list(opening_warnings)
        self.source: SourceInfo = {} if source is None else source
        self._opening_warnings = tuple(opening_warnings)

    @abstractmethod
    def _records(self) -> Records:
        """Decode the file from its start; what cannot be decoded comes as a `SkippedScan`."""

    def __iter__(self) -> Iterator[Scan]:
        """Usable scans in the file's order.

        Raises
        ------
        InputError
            The file cannot be read any further.
        """
        self.skipped = []
        self.warnings = list(self._opening_warnings)
        return self._usable_scans(self.skipped, self.warnings)

    def _usable_scans(self, skipped: list[SkippedScan], warnings: list[str]) -> Iterator[Scan]:
        jumps, no_returns = _StampJumps(), NoReturnValues()
        index = 0
        try:
            with closing(self._records()) as records:
                while True:
                    with damage_told(self.path):
                        record = next(records, None)
                    if record is None:
                        break
                    if isinstance(record, SkippedScan):
                        skipped.append(record)
                        continue
                    ranges = no_returns.cleared(record.ranges, record.laser)
                    if reason := _why_unusable(record, ranges):
                        skipped.append(SkippedScan(place=record.place, reason=reason))
                        continue
                    jumps.see(record.stamp)
                    yield Scan(
                        index=index,
                        stamp=record.stamp,
                        ranges=ranges,
                        laser=record.laser,
                        T_odom_base=record.T_odom_base,
                        truth=record.truth,
                        odometry=record.odometry,
                        imu_yaw=record.imu_yaw,
                        beam_times=record.beam_times,
                    )
                    index += 1
        finally:
            warnings.extend(jumps.warnings())
            warnings.extend(no_returns.warnings())


def _why_unusable(record: RawScan, ranges: FloatArray) -> str:
    """Why a record is unusable; empty when it is usable."""
    if not math.isfinite(record.stamp):
        return "its stamp is not finite"
    if record.T_odom_base is not None and not all(map(math.isfinite, record.T_odom_base.tolist())):
        return "its odometry is not finite"
    if not ((ranges > 0.0) & (ranges < np.inf)).any():
        return "no beam has a finite, positive range"
    return ""


@contextmanager
def damage_told(path: Path) -> Iterator[None]:
    """Turn whatever a decoder makes of a damaged file into an `InputError` that names it."""
    try:
        yield
    except SlammotError:
        raise
    except (Exception, MemoryError) as err:  # decoders of a damaged file may raise anything
        raise InputError(
            f"{path}: cannot be read ({type(err).__name__}: {one_line(err)[:200]}); the file is damaged or no log:"
            " check it, or copy it again"
        ) from err


def one_line(err: Exception) -> str:
    """What an exception says, on one line and never empty."""
    return " ".join(str(err).split()) or type(err).__name__


class _StampJumps:
    """Counts stamps that run backward or leap forward."""

    def __init__(self) -> None:
        self._previous = math.nan
        self._backward_steps_s: list[float] = []
        self._forward_steps_s: list[float] = []

    def see(self, stamp: float) -> None:
        step = stamp - self._previous
        self._previous = stamp
        if step < 0.0:
            self._backward_steps_s.append(-step)
        elif step > MAX_STEP_S:
            self._forward_steps_s.append(step)

    def warnings(self) -> list[str]:
        notes = []
        if self._backward_steps_s:
            n, largest = len(self._backward_steps_s), max(self._backward_steps_s)
            notes.append(f"stamps run backward {n} times, by up to {largest:.3g} s; the file's order is kept")
        if self._forward_steps_s:
            n, largest = len(self._forward_steps_s), max(self._forward_steps_s)
            notes.append(
                f"stamps leap forward by more than {MAX_STEP_S:g} s {n} times, by up to {largest:.6g} s"
            )
        return notes
