import numpy as np
import pytest

from slammot_graph.core.types import FloatArray
from slammot_graph.logs.scan_stamps import COUNTERS, mended, unwrap

RISING = np.linspace(1000.0, 1004.9, 50)


def test_stamps_that_rise_are_given_back() -> None:
    jumping = RISING.copy()
    jumping[[10, 20]] -= 0.5
    holed = RISING.copy()
    holed[7] = np.nan
    for stamps in (RISING, jumping, holed, RISING[:1], np.array([np.nan, 3.0])):
        times = mended(stamps)
        np.testing.assert_array_equal(times.stamps, stamps)
        assert (times.is_numbered, times.warnings) == (False, ())


@pytest.mark.parametrize("value", [0.0, 1.3e9, np.nan])
def test_equal_stamps_give_way_to_scan_numbers(value: float) -> None:
    times = mended(np.full(20, value, dtype=np.float64))
    assert times.is_numbered
    np.testing.assert_allclose(np.diff(times.stamps), 0.1, atol=1e-6)
    (warning,) = times.warnings
    assert "scan numbers serve as time, at 10 scans a second (assumed)" in warning
    assert ("all stamps are the same" in warning) == np.isfinite(value)


def test_stamps_in_whole_minutes_tell_the_rate() -> None:
    minutes: FloatArray = np.floor(np.arange(601) * 0.2 / 60.0)
    times = mended(60.0 * minutes)
    assert times.is_numbered
    np.testing.assert_allclose(np.diff(times.stamps), 0.2, rtol=0.01)
    assert "by the first and the last stamp" in times.warnings[0]


def test_stamps_that_fall_are_no_time() -> None:
    times = mended(RISING[::-1])
    assert times.is_numbered
    assert "do not rise" in times.warnings[0]


@pytest.mark.parametrize("unit", COUNTERS)
def test_a_wrapped_counter_is_unwrapped(unit: str) -> None:
    period_s = COUNTERS[unit]
    true = 0.75 * period_s + np.arange(60, dtype=np.float64) * (0.1 if period_s > 10.0 else 0.02)
    if period_s > 10.0:
        true += 0.25 * period_s - 3.0
    stamps: FloatArray = true % period_s
    assert stamps.min() < 4.0
    times = mended(stamps)
    np.testing.assert_allclose(np.diff(times.stamps), np.diff(true), atol=1e-5)
    assert "wrap around once at 2^32" in times.warnings[0]
    assert f"2^32 {unit} " in times.warnings[0]


@pytest.mark.parametrize("unit", COUNTERS)
def test_a_signed_counter_is_unwrapped(unit: str) -> None:
    period_s = COUNTERS[unit]
    true = 0.5 * period_s + (np.arange(40, dtype=np.float64) - 20.0) * (0.1 if period_s > 10.0 else 0.02)
    times = mended((true + 0.5 * period_s) % period_s - 0.5 * period_s)
    np.testing.assert_allclose(np.diff(times.stamps), np.diff(true), atol=1e-5)
    assert "wrap around once at 2^32" in times.warnings[0]


def test_a_counter_of_nanoseconds_is_unwrapped_at_a_low_rate() -> None:
    true = 0.14 * np.arange(100, dtype=np.float64)
    found = unwrap(true % COUNTERS["ns"])
    np.testing.assert_allclose(found.stamps, true, atol=1e-9)
    assert found.n_wraps == 3


@pytest.mark.parametrize(
    ("unit", "in_a_second"), [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)]
)
@pytest.mark.parametrize(("start", "rate_hz"), [(0.0, 10.0), (1.7e9, 40.0), (100.0, 1.0)])
def test_stamps_in_other_units_are_turned_into_seconds(
    unit: str, in_a_second: float, start: float, rate_hz: float
) -> None:
    true = start + np.arange(50) / rate_hz
    times = mended(true * in_a_second)
    np.testing.assert_allclose(np.diff(times.stamps), 1.0 / rate_hz, atol=1e-5)
    assert times.warnings == (f"stamps are {unit} by the time between scans; they are turned into seconds",)


def test_a_few_long_pauses_tell_no_unit() -> None:
    stamps = np.arange(40, dtype=np.float64)
    stamps[20:] += 1e6
    assert mended(stamps).warnings == ()
    assert mended(30.0 * np.arange(5, dtype=np.float64)).warnings == ()


def test_a_counter_that_went_below_zero_is_unwrapped() -> None:
    true = 0.5 - 0.1 * np.arange(20, dtype=np.float64)
    found = unwrap(np.where(true < 0.0, true + 2.0**32, true))
    np.testing.assert_allclose(found.stamps, true, atol=1e-5)
    assert found.n_wraps == 1


@pytest.mark.parametrize("pause_s", [4.0, 4.29, 4294.97])
def test_a_pause_is_no_wrap(pause_s: float) -> None:
    stamps = 0.1 * np.arange(50, dtype=np.float64)
    stamps[3:] += pause_s
    assert unwrap(stamps).n_wraps == 0
