"""Increments between scans, as the calibration joins and smooths them."""

import numpy as np
import pytest

from slammot_graph.odometry.windows import usual_step


def test_the_usual_step_is_the_one_in_which_most_time_passes() -> None:
    """Of scans that are stamped in bursts most steps are far shorter."""
    steps = np.array([0.2, 0.001, 0.001, 0.001, 0.22, 0.001, 0.001, 0.24, 0.001])
    ends = np.cumsum(steps)
    rows = np.column_stack([ends - steps, ends])
    assert usual_step(rows) == pytest.approx(0.22)
    assert usual_step(rows[[0]]) == pytest.approx(0.2)
