"""Self-calibration of the odometry from the matches: clock offset, scales, bias, direction and noise.

The increments between matched scans are compared with those that the odometry tells at the times that the clock offset
(`clock_offset`) says; the other parameters are robust linear fits (iteratively reweighted least squares, Student's t
with 4 degrees of freedom). What the drive does not excite keeps its prior, with an infinite standard deviation.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.odometry_report import Estimated
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.calibration_config import CalibrationConfig
from slammot_graph.odometry.clock_offset import ClockOffsetSearch
from slammot_graph.odometry.history import OdometryHistory
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise, variances_of
from slammot_graph.odometry.robust_fit import noise_scale_of, robust_fit, scaled_and_turned, stds_of
from slammot_graph.odometry.windows import Windows, joined

MIN_WINDOWS = 8
"""Scales are not fitted to fewer."""

N_HEADING_FITS = 3
"""The turns of windows that hardly turn are mended by the scale of the fit before."""


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometryCalibration:
    """What corrects the odometry; see `OdometryReport` for the parameters."""

    clock_offset_s: Estimated = field(default_factory=lambda: Estimated(value=0.0))
    distance_scale: Estimated = field(default_factory=lambda: Estimated(value=1.0))
    direction_rad: Estimated = field(default_factory=lambda: Estimated(value=0.0))
    heading_scale: Estimated = field(default_factory=lambda: Estimated(value=1.0))
    heading_bias_rad_per_m: Estimated = field(default_factory=lambda: Estimated(value=0.0))
    laser_shift_m: tuple[Estimated, Estimated] = (Estimated(value=0.0), Estimated(value=0.0))
    noise_scale_m: Estimated = field(default_factory=lambda: Estimated(value=1.0))
    noise_scale_rad: Estimated = field(default_factory=lambda: Estimated(value=1.0))

    def corrected(self, increments: FloatArray) -> FloatArray:
        """(..., 3) increments of the base by those (..., 3) that the odometry tells at the corrected times."""
        scale, direction = self.distance_scale.value, self.direction_rad.value
        c, s = scale * math.cos(direction), scale * math.sin(direction)
        if increments.ndim == 1:
            forward, left, angle = increments.tolist()
            added = self.heading_bias_rad_per_m.value * math.hypot(forward, left)
            return np.array(
                [c * forward - s * left, s * forward + c * left, self.heading_scale.value * angle + added]
            )
        x, y, turn = increments[..., 0], increments[..., 1], increments[..., 2]
        bias = self.heading_bias_rad_per_m.value * np.hypot(x, y)
        return np.stack([c * x - s * y, s * x + c * y, self.heading_scale.value * turn + bias], axis=-1)


class SelfCalibration:
    """Gathers matched increments and fits the odometry to them now and then.

    Attributes
    ----------
    config : CalibrationConfig
    noise : OdometryNoise or ConstantNoise
    now : OdometryCalibration
        As best known.
    """

    _N_COLUMNS = 11  # times before and after, increment (3), variances [m^2, rad^2], pose after (3), laser

    def __init__(self, config: CalibrationConfig, noise: OdometryNoise | ConstantNoise) -> None:
        self.config = config
        self.noise = noise
        self.now = OdometryCalibration()
        self._search = ClockOffsetSearch(config, noise)
        self._rows = np.zeros((2 * config.n_kept, self._N_COLUMNS))
        self._n = 0
        self._n_seen = 0
        self._next_fit = config.n_first

    def exclude(self, time_s: float) -> None:
        """Tell that no robot can have made the odometry's increment up to a time of its clock."""
        self._search.exclude(time_s)

    def add(
        self,
        times_s: tuple[float, float],
        increment: FloatArray,
        variances: tuple[float, float],
        T_local_base: FloatArray,
        history: OdometryHistory,
        laser: int = 0,
    ) -> None:
        """Take in the increment (3,) between two matched scans of a laser, and fit where it is time to.

        Parameters
        ----------
        times_s : (before, after)
            Of the history's clock.
        increment : (3,) array
        variances : (m^2, rad^2)
            Of the increment's translation, per axis, and rotation.
        T_local_base : (3,) array
            The later matched pose, local frame.
        history : OdometryHistory
        laser : int
            Which laser took both scans.
        """
        if self._n == len(self._rows):
            half = self.config.n_kept
            self._rows[:half] = self._rows[half:]
            self._n = half
        self._rows[self._n] = (*times_s, *increment.tolist(), *variances, *T_local_base.tolist(), laser)
        self._n += 1
        self._n_seen += 1
        if self._n_seen >= self._next_fit:
            self.fit(history)
            more = min(int((self.config.growth - 1.0) * self._n_seen), self.config.n_between)
            self._next_fit = self._n_seen + max(more, 20)

    def fit(self, history: OdometryHistory) -> None:
        """Fit all parameters to the increments kept."""
        rows = self._rows[max(self._n - self.config.n_kept, 0) : self._n]
        rows = rows[np.argsort(rows[:, -1], kind="stable")]  # the scans of each laser follow each other
        offset = self._search.find(rows, history, is_known=self.now.clock_offset_s.value != 0.0)
        config = self.config
        windows = Windows(rows, offset.value, history, length_m=config.window_m, max_size=config.max_window)
        if windows.n < MIN_WINDOWS:
            self.now = OdometryCalibration(clock_offset_s=offset)
            return
        heading, distance, direction = self._fit_scales(windows)
        first = OdometryCalibration(
            clock_offset_s=offset,
            distance_scale=distance,
            direction_rad=direction,
            heading_scale=heading[0],
            heading_bias_rad_per_m=heading[1],
        )
        increments = first.corrected(windows.steps)
        told = joined(increments)
        noise_m, noise_rad = self._fit_noise(windows, increments, told)
        shift = self._fit_shift(windows, told)
        self.now = replace(first, laser_shift_m=shift, noise_scale_m=noise_m, noise_scale_rad=noise_rad)

    def _fit_scales(self, windows: Windows) -> tuple[tuple[Estimated, Estimated], Estimated, Estimated]:
        """Heading scale and bias, distance scale, and direction.

        Only windows with clearly more motion than noise tell of a scale: fitted to the noise of a still heading, a
        scale would go to zero. All tell of the bias. What too few windows excite keeps its prior.
        """
        heading = self._fit_heading(windows)
        turned = OdometryCalibration(heading_scale=heading[0], heading_bias_rad_per_m=heading[1])
        return heading, *self._fit_distance(windows, joined(turned.corrected(windows.steps)))

    def _fit_heading(self, windows: Windows) -> tuple[Estimated, Estimated]:
        turn, found, std = windows.told[:, 2], windows.found[:, 2], self.config.stds(windows.var)[:, 1]
        d = np.hypot(windows.told[:, 0], windows.told[:, 1])
        prior = self.config.heading_prior
        is_turning = np.abs(found) > self.config.min_turn_rad
        if np.count_nonzero(is_turning) < 2 * MIN_WINDOWS:
            prior = prior[0], np.array([1e-4, prior[1][1]])
            is_turning = np.ones(len(turn), dtype=np.bool_)
        A = np.column_stack([turn * is_turning, d])
        scale = 1.0
        for _ in range(N_HEADING_FITS):
            fit = robust_fit(A, found - scale * turn * ~is_turning, std, prior, is_scale_given=False)
            scale = float(fit.x[0])
        stds = stds_of(fit, self.config.heading_prior[1])
        if prior[1][0] < self.config.scale_std:
            stds[0] = math.inf
        return Estimated(value=float(fit.x[0]), std=stds[0]), Estimated(value=float(fit.x[1]), std=stds[1])

    def _fit_distance(self, windows: Windows, told: FloatArray) -> tuple[Estimated, Estimated]:
        """Distance scale and direction by the windows' motion (n, 3) with the heading mended."""
        is_moving = (np.hypot(told[:, 0], told[:, 1]) > 0.03) | (np.abs(told[:, 2]) > 0.02)
        if np.count_nonzero(is_moving) < MIN_WINDOWS:
            return Estimated(value=1.0), Estimated(value=0.0)
        u, z, std = told[is_moving], windows.found[is_moving], self.config.stds(windows.var)[is_moving, 0]
        prior = self.config.scale_prior
        found = np.concatenate([z[:, 0], z[:, 1]])
        fit = robust_fit(scaled_and_turned(u), found, np.tile(std, 2), prior, is_scale_given=False)
        scale, stds = math.hypot(*fit.x), stds_of(fit, prior[1], n_series=2)
        return (
            Estimated(value=scale, std=stds[0]),
            Estimated(value=math.atan2(fit.x[1], fit.x[0]), std=stds[1] / max(scale, 0.1)),
        )

    def _fit_shift(self, windows: Windows, told: FloatArray) -> tuple[Estimated, Estimated]:
        """How far the laser sits from where its pose says, forward and left, by the motion (n, 3) told with all mended.

        A laser pose that is short by p puts the base at ``B p``, and its motion T is seen as ``inverse(p) T p``:
        farther by ``(R(theta) - I) p``.
        """
        found, std = windows.found, self.config.stds(windows.var)[:, 0]
        c, s = np.cos(told[:, 2]) - 1.0, np.sin(told[:, 2])
        swing = np.vstack([np.column_stack([c, -s]), np.column_stack([s, c])])
        left = np.concatenate([found[:, 0] - told[:, 0], found[:, 1] - told[:, 1]])
        prior = np.zeros(2), np.full(2, self.config.shift_std_m)
        fit = robust_fit(swing, left, np.tile(std, 2), prior, is_scale_given=False)
        stds = stds_of(fit, prior[1], n_series=2)
        return Estimated(value=float(fit.x[0]), std=stds[0]), Estimated(value=float(fit.x[1]), std=stds[1])

    def _fit_noise(
        self, windows: Windows, increments: FloatArray, told: FloatArray
    ) -> tuple[Estimated, Estimated]:
        """Scale of the noise's standard deviation, from how the windows' residuals spread beyond the matches' own.

        By the mended increments (n, k, 3), and the motion (n, 3) that they make.
        """
        errors = se2.log(se2.between(told, windows.found))
        variances = variances_of(self.noise, increments.reshape(-1, 3))
        variances = variances.reshape(*increments.shape[:2], 2).sum(axis=1)
        own = windows.var
        m2 = np.concatenate([errors[:, 0] ** 2, errors[:, 1] ** 2])
        spread = self.config.noise_scale_std
        return (
            noise_scale_of(m2, np.tile(variances[:, 0], 2), np.tile(own[:, 0], 2), spread),
            noise_scale_of(errors[:, 2] ** 2, variances[:, 1], own[:, 1], spread),
        )
