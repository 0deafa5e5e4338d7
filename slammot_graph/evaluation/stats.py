"""The five figures that summarise a set of errors."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, kw_only=True)
class ErrorStats:
    """Figures of a set of errors, all in the unit of the errors; NaN where `n` is 0.

    Attributes
    ----------
    n : int
    mean, std, median, rmse, max : float
        `std` is that of the set itself (divided by n), as the SLAM evaluations print it.
    """

    n: int
    mean: float
    std: float
    median: float
    rmse: float
    max: float


def summarize(errors: npt.ArrayLike) -> ErrorStats:
    """Summarise errors of any shape; over nothing every figure is NaN and `n` is 0."""
    values = np.asarray(errors, dtype=np.float64).ravel()
    if values.size == 0:
        return ErrorStats(n=0, mean=math.nan, std=math.nan, median=math.nan, rmse=math.nan, max=math.nan)
    return ErrorStats(
        n=values.size,
        mean=float(values.mean()),
        std=float(values.std()),
        median=float(np.median(values)),
        rmse=float(np.sqrt(np.mean(values * values))),
        max=float(values.max()),
    )


def ratio(numerator: float, denominator: float) -> float:
    """Divide; NaN over zero, since a share of nothing is not a number."""
    return numerator / denominator if denominator else math.nan
