"""What was decided about each scan of a run, kept small: for the final labels and for the map."""

import io
import struct
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.core.spool import MOST_IN_MEMORY, Spool
from slammot_graph.core.sweep import SweepMotion
from slammot_graph.core.types import BoolArray, FloatArray, IntArray
from slammot_graph.detection import _kernels

_HEAD = struct.Struct("=qdqiI?H9f")
SURE_P = 0.95
"""Beams that moved with at least this probability were sure."""
_SWEEP = struct.Struct("=2d9f")


@dataclass(kw_only=True, eq=False)
class ScanRecord:
    """What was decided about a scan at its time.

    Attributes
    ----------
    scan : Scan
        With its ranges, and without odometry.
    is_valid, is_moving : (n,) bool arrays
    is_wall : (n,) bool array
        Beams that hit an occupied cell.
    is_displaced : (n,) bool array
        Beams on tracked objects that have displaced.
    is_lasting : (n,) bool array
        Beams on those and on others that are no false alarm by all evidence.
    is_sure : (n,) bool array
        Beams that were called moving with a probability of at least `SURE_P`.
    cov_relative : (3, 3) array
        Covariance of the matched pose in the test.
    window : int
        Number of the scan in the log with which the test's memory began.
    is_doubtful : bool
        The scan could not be matched.
    """

    scan: Scan
    is_valid: BoolArray
    is_moving: BoolArray
    is_wall: BoolArray
    is_displaced: BoolArray
    is_lasting: BoolArray
    is_sure: BoolArray
    cov_relative: FloatArray
    window: int
    is_doubtful: bool


class ScanHistory(Sequence[ScanRecord]):
    """All scans of a run in their order: 5 bytes a beam, 9 of a sweep; on the disk once they are many.

    Parameters
    ----------
    most_in_memory : int, optional
        Beyond this [bytes] they are many; by default `MOST_IN_MEMORY`.

    Attributes
    ----------
    stamps : array of n floats [s]
    laser_numbers : array of n ints
        Which of the robot's lasers took each.
    windows : array of n ints
        As of `ScanRecord.window`.
    """

    def __init__(self, most_in_memory: int | None = None) -> None:
        self._lasers: list[LaserModel] = []
        self._places = array("q")
        self.stamps = array("d")
        self.laser_numbers = array("q")
        self.windows = array("q")
        self._spool = Spool(MOST_IN_MEMORY if most_in_memory is None else most_in_memory)

    def append(
        self,
        scan: Scan,
        *,
        is_valid: BoolArray,
        is_moving: BoolArray,
        reason: IntArray,
        marks: BoolArray,
        cov_relative: FloatArray,
        window: int,
        is_doubtful: bool,
    ) -> None:
        """Add a scan of n beams: see `ScanRecord`; `marks` (3, n) are `is_displaced`, `is_lasting` and `is_sure`."""
        laser = self._number_of(scan.laser)
        masks = np.empty(len(is_valid), dtype=np.uint8)
        _kernels.pack_masks(is_valid, is_moving, reason, marks, masks)
        cov = cov_relative.ravel().tolist()
        n_knots = 0 if scan.sweep is None else len(scan.sweep.T_stamp_base)
        head = _HEAD.pack(scan.index, scan.stamp, window, laser, len(masks), is_doubtful, n_knots, *cov)
        packed = head + scan.ranges.astype(np.float32).tobytes() + masks.tobytes()
        self._places.append(self._spool.add(packed if scan.sweep is None else packed + _packed_sweep(scan)))
        self.stamps.append(scan.stamp)
        self.laser_numbers.append(scan.laser.number)
        self.windows.append(window)

    def _number_of(self, laser: LaserModel) -> int:
        """Place of a laser in the list; of several, each is among the latest few."""
        n = len(self._lasers)
        for k in range(n - 1, max(n - 9, -1), -1):
            if self._lasers[k] is laser:
                return k
        self._lasers.append(laser)
        return n

    @overload
    def __getitem__(self, k: int) -> ScanRecord: ...

    @overload
    def __getitem__(self, k: slice) -> list[ScanRecord]: ...

    def __getitem__(self, k: int | slice) -> ScanRecord | list[ScanRecord]:
        """Unpack one or several; ranges and covariances come back in single precision."""
        if isinstance(k, slice):
            return [self._unpack(j) for j in range(*k.indices(len(self)))]
        return self._unpack(range(len(self))[k])

    @property
    def spools(self) -> tuple[Spool, ...]:
        """What grows with the scans."""
        return (self._spool,)

    @property
    def n_lasers(self) -> int:
        """Lasers of the robot that took them."""
        return len(set(self.laser_numbers))

    def __len__(self) -> int:
        return len(self._places)

    def close(self) -> None:
        """Give the temporary file back."""
        self._spool.close()

    def _unpack(self, k: int) -> ScanRecord:
        place = self._places[k]
        end = self._places[k + 1] if k + 1 < len(self) else self._spool.n_bytes
        data = self._spool.read(place, end - place)
        index, stamp, window, laser, n, is_doubtful, n_knots, *cov = _HEAD.unpack_from(data)
        ranges = np.frombuffer(data, np.float32, n, _HEAD.size).astype(np.float64)
        masks = np.empty((6, n), dtype=np.bool_)
        _kernels.unpack_masks(np.frombuffer(data, np.uint8, n, _HEAD.size + 4 * n), masks)
        valid, moving, wall, displaced, lasting, sure = masks
        beam_times, sweep = _read_sweep(data[_HEAD.size + 5 * n :], n, n_knots) if n_knots else (None, None)
        return ScanRecord(
            scan=Scan(
                index=index,
                stamp=stamp,
                ranges=ranges,
                laser=self._lasers[laser],
                T_odom_base=se2.IDENTITY,
                beam_times=beam_times,
                sweep=sweep,
            ),
            is_valid=valid,
            is_moving=moving,
            is_wall=wall,
            is_displaced=displaced,
            is_lasting=lasting,
            is_sure=sure,
            cov_relative=np.array(cov).reshape(3, 3),
            window=window,
            is_doubtful=is_doubtful,
        )


def _read_sweep(data: bytes, n: int, n_knots: int) -> tuple[FloatArray, SweepMotion]:
    """Beam times (n,) and motion of a deskewed scan."""
    file = io.BytesIO(data)
    first_s, last_s, *cov = _SWEEP.unpack(file.read(_SWEEP.size))
    knots = np.frombuffer(file.read(12 * n_knots), dtype=np.float32).astype(np.float64)
    times = np.frombuffer(file.read(4 * n), dtype=np.float32).astype(np.float64)
    sweep = SweepMotion(
        first_s=first_s,
        last_s=last_s,
        T_stamp_base=knots.reshape(-1, 3),
        cov_velocity=np.array(cov).reshape(3, 3),
    )
    return times, sweep


def _packed_sweep(scan: Scan) -> bytes:
    """Beam times and motion of a deskewed scan as bytes; none of any other."""
    sweep = scan.sweep
    if sweep is None or scan.beam_times is None:
        return b""
    head = _SWEEP.pack(sweep.first_s, sweep.last_s, *sweep.cov_velocity.ravel().tolist())
    return b"".join((head, *(x.astype(np.float32).tobytes() for x in (sweep.T_stamp_base, scan.beam_times))))
