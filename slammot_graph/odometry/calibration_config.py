"""How the odometry is calibrated while running."""

from dataclasses import dataclass

import numpy as np

from slammot_graph.core.checks import Checked, Count, Positive
from slammot_graph.core.types import FloatArray


@dataclass(frozen=True, kw_only=True)
class CalibrationConfig(Checked):
    """How the odometry is calibrated while running.

    Attributes
    ----------
    n_kept : int
        The latest so many increments are fitted.
    n_first : int
        The first fit is made with so many ...
    growth : float
        ... and the next ones when there are this many times as many, or `n_between` more.
    n_between : int
    max_offset_s : float
        Clock offsets are searched up to this.
    offset_step_s : float
        Step of the search, refined to a fifth.
    min_gain : float
        Natural logarithm of the likelihood ratio against no offset at which an offset is believed ...
    min_sigma, min_sigma_kept : float
        ... if that is so many of its standard deviations (Vuong 1989, with neighbours that go together); and of one
        that was believed before. Down a corridor the matches err for many scans in a row, which some offset always
        happens to explain.
    window_m : float
        Increments are joined until they are about this long, so that scales stand out of the noise ...
    max_window : int
        ... but no more than so many.
    min_turn_rad : float
        A window in which the matches tell of less turn tells nothing of the heading's scale.
    scale_std : float
        Prior standard deviation of both scales about 1, and of the direction [rad].
    bias_std_rad_per_m : float
        Prior standard deviation of the heading bias about 0.
    shift_std_m : float
        Prior standard deviation of the laser's place on the base about that of its pose, per axis.
    min_std_m, min_std_rad : float
        Least standard deviation of an increment's residual in the fit.
    noise_scale_std : float
        Prior standard deviation of the natural logarithm of the noise's variance about that of the noise model.
    """

    n_kept: Count = 800
    n_first: Count = 20
    growth: Positive = 1.5
    n_between: Count = 500
    max_offset_s: Positive = 0.6
    offset_step_s: Positive = 0.05
    min_gain: Positive = 12.0
    min_sigma: Positive = 3.0
    min_sigma_kept: Positive = 1.0
    window_m: Positive = 0.4
    max_window: Count = 8
    min_turn_rad: Positive = 0.08
    scale_std: Positive = 0.5
    bias_std_rad_per_m: Positive = 0.1
    shift_std_m: Positive = 0.5
    min_std_m: Positive = 0.003
    min_std_rad: Positive = 0.002
    noise_scale_std: Positive = 1.1

    @property
    def heading_prior(self) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (2,) of the heading's scale and bias [rad/m]."""
        return np.array([1.0, 0.0]), np.array([self.scale_std, self.bias_std_rad_per_m])

    @property
    def scale_prior(self) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (2,) of the distances' scale, along and across."""
        return np.array([1.0, 0.0]), np.array([self.scale_std, self.scale_std])

    def stds(self, variances: FloatArray) -> FloatArray:
        """Standard deviations (n, 2) [m, rad] of residuals in a fit, by variances (n, 2), with a lower bound."""
        least = self.min_std_m**2, self.min_std_rad**2
        return np.asarray(np.sqrt(variances + np.array(least)))
