from slammot_graph.tracking.clock import TrackerClock


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
