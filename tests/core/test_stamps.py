"""Stamps: the nearest one, and sequences of one log."""

import numpy as np

from slammot_graph.core.stamps import have_same_times, nearest_stamps


def test_the_nearest_stamp_is_found(rng: np.random.Generator) -> None:
    stamps, wanted = rng.uniform(0.0, 5.0, 80), rng.uniform(-1.0, 6.0, 60)
    distance = np.abs(wanted[:, None] - stamps)
    expected = np.where(distance.min(axis=1) <= 0.05, distance.argmin(axis=1), -1)
    np.testing.assert_array_equal(nearest_stamps(stamps, wanted, 0.05), expected)
    assert set(nearest_stamps(np.zeros(0), wanted, 0.05).tolist()) == {-1}


def test_of_equal_stamps_the_first_is_found() -> None:
    stamps = np.array([2.0, 1.0, 2.0, 1.0])
    wanted = np.array([1.0, 2.0, 1.0 - 1e-6, 1.0 + 1e-6, 2.0 + 1e-6])
    assert nearest_stamps(stamps, wanted, 1e-5).tolist() == [1, 0, 1, 1, 0]


def test_runs_are_of_one_log_over_the_length_of_the_shorter_one() -> None:
    stamps = np.array([1.0, 1.1, 1.2])
    assert have_same_times(stamps, stamps[:2] + 4e-6)
    assert not have_same_times(stamps, stamps + 1e-3)
    assert not have_same_times(stamps, stamps[:0])
