"""The offset between the clocks of laser and odometry, by where what the odometry tells fits the matches best.

For each offset of a grid the odometry's scale, bias and direction are a robust linear fit (Student's t). The odometry
is fitted to the matches, for its noise is the larger: the other way round, down a corridor, a heading scale of 0
explains the matches best, at whatever offset the fit happens to find it.
"""

import math
from typing import NamedTuple

import numpy as np

from slammot_graph.core.odometry_report import Estimated
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.calibration_config import CalibrationConfig
from slammot_graph.odometry.history import OdometryHistory
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise, variances_of
from slammot_graph.odometry.robust_fit import long_run_variance, residual_scale, robust_fit, scaled_and_turned
from slammot_graph.odometry.windows import smoothed_rows, told_increments, usual_step

MIN_ROWS = 20
"""No offset is looked for in fewer increments."""

LEAST_STEP = 0.5
"""Increments over less of the usual time are left out."""

N_FINE = 5
"""Steps of the grid are refined to so many parts."""

INTERPOLATION_SHARE = 0.2
"""Of the time from scan to scan: how far the offset is off where it falls between samples, however many there are."""


class ClockOffsetSearch:
    """Finds the clock offset in increments between matched scans.

    Attributes
    ----------
    config : CalibrationConfig
    noise : OdometryNoise or ConstantNoise
    """

    def __init__(self, config: CalibrationConfig, noise: OdometryNoise | ConstantNoise) -> None:
        self.config = config
        self.noise = noise
        self._excluded_s = list[float]()

    def exclude(self, time_s: float) -> None:
        """Tell that no robot can have made the odometry's increment up to a time of its clock.

        Interpolated at shifted times it would spoil neighbours at some offsets more than at others.
        """
        self._excluded_s.append(time_s)

    def find(self, rows: FloatArray, history: OdometryHistory, *, is_known: bool) -> Estimated:
        """Find the offset by a grid search, refined; 0 with the curvature's standard deviation where none is clear.

        Parameters
        ----------
        rows : (n, 11) array
            Of `SelfCalibration`, those of each laser together.
        history : OdometryHistory
        is_known : bool
            An offset was believed before.
        """
        rows = self._reached(smoothed_rows(rows), history)
        if len(rows) < MIN_ROWS:
            return Estimated(value=0.0)
        step = self.config.offset_step_s
        n = round(self.config.max_offset_s / step)
        coarse = step * np.arange(-n, n + 1)
        increments = _Increments(rows, history, self.config)
        std = self.config.stds(rows[:, 5:7] + variances_of(self.noise, rows[:, 2:5]))
        fits = [increments.fit(offset, std) for offset in coarse]
        k = int(np.argmin([fit.costs.sum() for fit in fits]))
        best, std = coarse[k], np.maximum(fits[k].scales * std, self.config.stds(np.zeros(2)))

        def costs_at(offset: float) -> FloatArray:
            return increments.fit(offset, std).costs

        step /= N_FINE
        fine = best + step * np.arange(-N_FINE, N_FINE + 1)
        costs_of_rows = np.array([costs_at(offset) for offset in fine])
        costs = costs_of_rows.sum(axis=1)
        k = int(np.clip(np.argmin(costs), 1, len(fine) - 2))
        curvature = (costs[k - 1] - 2.0 * costs[k] + costs[k + 1]) / step**2
        slope = (costs[k + 1] - costs[k - 1]) / (2.0 * step)
        std_s = math.inf
        if curvature > 1.0:
            spread = _variance_of_sum((costs_of_rows[k + 1] - costs_of_rows[k - 1]) / (2.0 * step))
            std_s = max(1.0 / math.sqrt(curvature), math.sqrt(spread) / curvature)
            std_s = math.hypot(std_s, INTERPOLATION_SHARE * increments.step_s)
        # What is left of the smoothing by interpolation favours both signs alike: an offset must beat its opposite too.
        others = (costs_at(other) for other in (0.0, -float(fine[k])))
        if not all(self._is_clear(other - costs_of_rows[k], is_known=is_known) for other in others):
            return Estimated(value=0.0, std=std_s)
        value = fine[k] - (slope / curvature if curvature > 1.0 else 0.0)
        return Estimated(value=float(np.clip(value, fine[k - 1], fine[k + 1])), std=std_s)

    def _is_clear(self, gains: FloatArray, *, is_known: bool) -> bool:
        """Tell whether the gains in log likelihood (n,) of an offset, row by row, are more than chance."""
        n_sigma = self.config.min_sigma_kept if is_known else self.config.min_sigma
        return float(gains.sum()) > max(self.config.min_gain, n_sigma * math.sqrt(_variance_of_sum(gains)))

    def _reached(self, rows: FloatArray, history: OdometryHistory) -> FloatArray:
        """Rows of which the odometry tells at every clock offset, and no excluded increment at any.

        What it tells must be alike at all of them: at other times it tells of hardly any motion in the short steps of
        scans that were stamped in bursts, which a scale of 0 explains best.
        """
        if not len(rows):
            return rows
        step_s = usual_step(rows)
        reach_s = self.config.max_offset_s + step_s
        rows = rows[(rows[:, 0] - reach_s >= history.start_s) & (rows[:, 1] + reach_s <= history.end_s)]
        rows = rows[rows[:, 1] - rows[:, 0] > LEAST_STEP * step_s]
        if not len(rows):
            return rows
        reach_s += step_s
        self._excluded_s = [time_s for time_s in self._excluded_s if time_s > rows[0, 0] - reach_s]
        times = np.array(self._excluded_s)
        near = np.searchsorted(times, rows[:, 0] - reach_s), np.searchsorted(times, rows[:, 1] + reach_s)
        return np.asarray(rows[near[0] == near[1]])


class _OffsetFit(NamedTuple):
    """A fit at a clock offset.

    Attributes
    ----------
    costs : (n,) array
        Negative log likelihood of each row.
    scales : (2,) array
        Of the residuals of translation and rotation, in the standard deviations taken for them.
    """

    costs: FloatArray
    scales: FloatArray


class _Increments:
    """What the matches found, ready to be fitted to at many clock offsets.

    Attributes
    ----------
    step_s : float
        Usual time of an increment.
    """

    def __init__(self, rows: FloatArray, history: OdometryHistory, config: CalibrationConfig) -> None:
        self.step_s = usual_step(rows)
        self._rows, self._history, self._config = rows, history, config
        found = rows[:, 2:5]
        self._turned = np.column_stack([found[:, 2], np.hypot(found[:, 0], found[:, 1])])
        self._moved = scaled_and_turned(found)

    def fit(self, offset: float, std: FloatArray) -> _OffsetFit:
        """Fit what the odometry tells at a clock offset to the matches, with standard deviations (n, 2) [m, rad]."""
        before_s, after_s = self._rows[:, 0], self._rows[:, 1]
        u = told_increments(before_s, after_s, float(offset), self._history, spread_s=self.step_s)
        heading = robust_fit(self._turned, u[:, 2], std[:, 1], self._config.heading_prior)
        told, std_told = np.concatenate([u[:, 0], u[:, 1]]), np.tile(std[:, 0], 2)
        translation = robust_fit(self._moved, told, std_told, self._config.scale_prior)
        return _OffsetFit(
            costs=heading.costs + translation.costs.reshape(2, -1).sum(axis=0),
            scales=np.array(
                [
                    residual_scale((told - self._moved @ translation.x) / std_told),
                    residual_scale((u[:, 2] - self._turned @ heading.x) / std[:, 1]),
                ]
            ),
        )


def _variance_of_sum(series: FloatArray) -> float:
    """Variance of the sum of a series (n,) whose neighbours go together."""
    return max(float(long_run_variance(series[:, None])[0, 0]), 0.0)
