import numpy as np

from slammot_graph.tracking.clock import LONGEST_STEP_S, TrackerClock, rising_times


def test_time_passes_only_forward() -> None:
    clock = TrackerClock(max_backward_s=1.0)
    assert clock.elapsed_s(5.0) == 0.0
    assert [clock.advance(stamp) for stamp in (5.0, 5.5, 5.25)] == [0.0, 0.5, 0.0]
    assert clock.elapsed_s(6.0) == 0.5  # since the latest stamp, not the last one
    assert clock.advance(6.0) == 0.5


def test_a_clock_that_was_set_back_for_good_starts_anew() -> None:
    clock = TrackerClock(max_backward_s=1.0)
    clock.advance(100.0)
    assert clock.advance(3.0) == 0.0
    assert clock.advance(3.25) == 0.25


def test_times_of_a_whole_log_never_fall() -> None:
    stamps = np.array([7.0, 7.5, 7.25, 8.0, 2.0, 2.5, 1e9])
    times = rising_times(stamps, max_backward_s=1.0)
    np.testing.assert_allclose(times, [0.0, 0.5, 0.5, 1.0, 1.0, 1.5, 1.5 + LONGEST_STEP_S])
