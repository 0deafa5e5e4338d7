"""Which increments tell of a clock offset; what is found of one is in `test_calibration`."""

import numpy as np
import pytest

from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.calibration_config import CalibrationConfig
from slammot_graph.odometry.clock_offset import ClockOffsetSearch
from slammot_graph.odometry.history import OdometryHistory
from slammot_graph.odometry.noise import OdometryNoise

STEP_S, N = 0.1, 100
TIMES_S: FloatArray = STEP_S * np.arange(N, dtype=np.float64)


def search_and_history() -> tuple[ClockOffsetSearch, OdometryHistory]:
    history = OdometryHistory()
    for k in range(N):
        history.advance(STEP_S * k, np.array([0.05 * k, 0.0, 0.0]), None)
    return ClockOffsetSearch(CalibrationConfig(max_offset_s=0.6), OdometryNoise()), history


def rows_of(times_s: FloatArray) -> FloatArray:
    rows = np.zeros((len(times_s) - 1, 11))
    rows[:, 0], rows[:, 1], rows[:, 2] = times_s[:-1], times_s[1:], 0.05
    return rows


def test_only_increments_that_the_odometry_reaches_at_every_offset_count() -> None:
    search, history = search_and_history()
    kept = search._reached(rows_of(TIMES_S), history)
    assert kept[0, 0] == pytest.approx(0.7)
    assert kept[-1, 1] == pytest.approx(STEP_S * (N - 1) - 0.7)


def test_increments_of_a_burst_do_not_count() -> None:
    search, history = search_and_history()
    times: FloatArray = np.sort(np.concatenate([TIMES_S[20:80], TIMES_S[20:80:10] + 0.001]))
    kept = search._reached(rows_of(times), history)
    assert len(kept) == len(times) - 1 - 6
    assert (kept[:, 1] - kept[:, 0] > 0.09).all()


def test_increments_around_an_excluded_one_do_not_count() -> None:
    search, history = search_and_history()
    search.exclude(5.0)
    kept = search._reached(rows_of(TIMES_S), history)
    assert not ((kept[:, 0] < 5.0 + 0.75) & (kept[:, 1] > 5.0 - 0.75)).any()
    assert len(kept) > 60
