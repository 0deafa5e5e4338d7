"""Odometry between its samples and beyond: what sweeps are deskewed by."""

import numpy as np
import pytest

from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.history import OdometryHistory

PERIOD_S = 0.14


def poses_at(times: FloatArray) -> FloatArray:
    """A drive whose velocities change as a robot's do."""
    return np.stack([np.sin(times), 0.5 * np.cos(1.3 * times), 0.8 * np.sin(2.0 * times)], axis=-1)


def history_of(times: FloatArray, poses: FloatArray) -> OdometryHistory:
    history = OdometryHistory()
    history.advance(float(times[0]), poses[0], OdometryTrack(stamps=times, T_odom_base=poses))
    return history


def test_between_samples_the_motion_is_smooth() -> None:
    times = np.arange(0.0, 6.0, PERIOD_S)
    history = history_of(times, poses_at(times))
    asked = np.linspace(PERIOD_S, 5.5, 300)
    smooth = np.abs(history.going_on(asked) - poses_at(asked)).max(axis=0)
    straight = np.abs(history.at(asked) - poses_at(asked)).max(axis=0)
    assert (smooth < 0.25 * straight).all()
    np.testing.assert_allclose(history.going_on(times), poses_at(times), atol=1e-12)


def test_a_jump_bends_nothing_beside_it() -> None:
    times = np.arange(0.0, 6.0, PERIOD_S)
    poses = poses_at(times)
    poses[20:, 0] += 2.0
    history = history_of(times, poses)
    for first in (18, 19, 20):
        asked = np.linspace(times[first], times[first + 1], 11)
        error = np.abs(history.going_on(asked) - history.at(asked))
        assert error.max() < 0.01


@pytest.mark.parametrize("n", [1, 2])
def test_few_samples_are_enough(n: int) -> None:
    times = PERIOD_S * np.arange(float(n))
    found = history_of(times, poses_at(times)).going_on(np.array([0.0, 0.1]))
    assert np.isfinite(found).all()


def test_samples_of_one_time_do_no_harm() -> None:
    times = np.array([0.0, 0.1, 0.1, 0.2, 0.3])
    history = OdometryHistory()
    history.advance(0.0, np.zeros(3), None)
    history._times[:5], history._n = times, 5
    history._poses[:5] = poses_at(times)
    found = history.going_on(np.linspace(0.0, 0.3, 31))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, poses_at(np.linspace(0.0, 0.3, 31)), atol=0.02)
