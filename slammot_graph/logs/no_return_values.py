"""The number that a driver writes where there is no return, where the log's `range_max` does not tell of it."""

import numpy as np

from slammot_graph.core.scan import NO_RETURN_FRACTION, LaserModel
from slammot_graph.core.types import FloatArray

LEAST_SHARE, LEAST_BEAMS = 0.1, 5
"""So many beams of one scan that read the very same number, and none more, did not meet a wall: the farthest place in
sight is a corner, seen by one beam."""

BEYOND = 1.001
"""A laser that sees farther than a number does not write it for nothing in sight."""


class NoReturnValues:
    """Finds that number, for each of several lasers, and takes it for no return from then on."""

    def __init__(self) -> None:
        self._values: dict[int, float] = {}
        self._n_scans = 0

    def cleared(self, ranges: FloatArray, laser: LaserModel) -> FloatArray:
        """Give the ranges (n_beams,) [m] with infinity for that number; the same array where it is not there."""
        with np.errstate(invalid="ignore"):
            is_return = (ranges > laser.range_min) & (ranges < NO_RETURN_FRACTION * laser.range_max)
        largest = float(np.max(ranges, where=is_return, initial=0.0))
        if largest <= 0.0:
            return ranges
        value = self._values.get(laser.number)
        if value is not None and largest > BEYOND * value:
            del self._values[laser.number]
            value = None
        if value is None:
            n_largest = np.count_nonzero(ranges == largest)
            if n_largest < max(LEAST_BEAMS, LEAST_SHARE * len(ranges)) or n_largest == np.count_nonzero(
                is_return
            ):
                return ranges
            value = self._values[laser.number] = largest
        is_code = ranges == value
        if not is_code.any():
            return ranges
        self._n_scans += 1
        return np.where(is_code, np.inf, ranges)

    def warnings(self) -> list[str]:
        """Say what was found."""
        if not self._n_scans:
            return []
        values = ", ".join(f"{value:.6g}" for value in sorted(set(self._values.values())))
        return [
            f"many beams read exactly {values or 'the same number of'} m, and none more, in {self._n_scans} scans:"
            " taken for no return, though the log's range_max is larger"
        ]
