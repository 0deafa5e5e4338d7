"""Faults of odometry: what the scans carry, against increments that are known."""

from collections.abc import Callable

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.scan import LaserModel
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation import SimulatedLog
from slammot_graph.simulation.odometry_faults import (
    biased,
    dead,
    held,
    jumping,
    late,
    leaping,
    scaled,
    slipping,
    spiking,
    standing_still,
    turned,
    unsigned,
)

N_SCANS, PERIOD_S = 201, 0.1


@pytest.fixture
def log() -> SimulatedLog:
    """20 s at 10 scans a second along an arc that gets tighter, started away from the origin."""
    step = np.column_stack(
        [np.full(N_SCANS - 1, 0.05), np.zeros(N_SCANS - 1), np.linspace(0.0, 0.06, N_SCANS - 1)]
    )
    poses = [np.array([1.0, -2.0, 3.0])]
    for u in step:
        poses.append(se2.compose(poses[-1], se2.exp(u)))
    T = np.array(poses)
    return SimulatedLog(
        name="arc",
        laser=LaserModel(angle_min=-1.0, angle_increment=0.5, n_beams=5, range_min=0.1, range_max=8.0),
        stamps=5.0 + PERIOD_S * np.arange(N_SCANS, dtype=np.float64),
        ranges=np.full((N_SCANS, 5), 4.0),
        T_odom_base=T,
        T_world_base=T.copy(),
        is_moving=np.zeros((N_SCANS, 5), dtype=np.bool_),
        object_id=np.full((N_SCANS, 5), -1),
        objects=np.full((N_SCANS, 0, 4), np.nan),
    )


def increments(log: SimulatedLog) -> FloatArray:
    """(n - 1, 3) motion that the scans' odometry tells."""
    told = np.array([scan.T_odom_base for scan in log])
    return se2.between(told[:-1], told[1:])


FAULTS: tuple[Callable[[SimulatedLog], SimulatedLog], ...] = (
    lambda log: late(log, 0.25),
    lambda log: scaled(log, 0.3),
    lambda log: turned(log, -1.0),
    lambda log: biased(log, 0.1),
    slipping,
    standing_still,
    lambda log: jumping(log, 1.0),
    lambda log: leaping(log, 2.0),
    lambda log: spiking(log, 2.0),
    held,
    unsigned,
    dead,
)


@pytest.mark.parametrize("fault", FAULTS)
def test_only_the_odometry_changes_and_the_scans_carry_it(
    fault: Callable[[SimulatedLog], SimulatedLog], log: SimulatedLog
) -> None:
    before = log.T_odom_base.copy()
    changed = fault(log)
    np.testing.assert_array_equal(log.T_odom_base, before)
    assert changed.T_odom_base.shape == before.shape
    assert not np.allclose(changed.T_odom_base, before)
    np.testing.assert_allclose(changed.T_odom_base[0], before[0], atol=1e-12)
    for name in ("stamps", "ranges", "T_world_base", "is_moving", "object_id", "objects"):
        np.testing.assert_array_equal(getattr(changed, name), getattr(log, name))
    for scan in changed:
        assert scan.T_odom_base is not None
        assert scan.odometry is not None  # the samples around it, which the calibration interpolates
        np.testing.assert_array_equal(scan.T_odom_base, changed.T_odom_base[scan.index])
        off = se2.between(scan.odometry.T_odom_base[scan.index], scan.T_odom_base)
        np.testing.assert_allclose(off, 0.0, atol=1e-12)
        np.testing.assert_array_equal(scan.odometry.stamps[scan.index], scan.stamp)


@pytest.mark.parametrize("delay_s", [0.3, 0.25, -0.25])
def test_late_odometry_is_that_of_an_earlier_time(delay_s: float, log: SimulatedLog) -> None:
    changed = late(log, delay_s)
    k = 60  # of which the theta passes pi on the way
    asked = k - delay_s / PERIOD_S
    low, high, share = int(np.floor(asked + 1e-9)), int(np.ceil(asked - 1e-9)), asked % 1.0
    turn = se2.between(log.T_odom_base[low], log.T_odom_base[high])[2]
    xy = log.T_odom_base[low, :2] * (1.0 - share) + log.T_odom_base[high, :2] * share
    if low == high:
        xy, turn = log.T_odom_base[low, :2], 0.0
    np.testing.assert_allclose(changed.T_odom_base[k, :2], xy, atol=1e-9)
    off = se2.wrap_angle(changed.T_odom_base[k, 2] - log.T_odom_base[low, 2] - (asked % 1.0) * turn)
    assert float(off) == pytest.approx(0.0, abs=1e-9)
    held_end = changed.T_odom_base[:3] if delay_s > 0.0 else changed.T_odom_base[-3:]
    np.testing.assert_allclose(held_end - held_end[0], 0.0, atol=1e-12)
    assert np.abs(se2.between(changed.T_odom_base[:-1], changed.T_odom_base[1:])[:, 2]).max() < 0.07


def test_scales_signs_and_bias(log: SimulatedLog) -> None:
    was = increments(log)
    np.testing.assert_allclose(increments(scaled(log, 0.3)), was * [0.3, 0.3, 1.0], atol=1e-9)
    np.testing.assert_allclose(increments(scaled(log, -1.0)), was * [-1.0, -1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(increments(turned(log, -2.0)), was * [1.0, 1.0, -2.0], atol=1e-9)
    distance = np.hypot(was[:, 0], was[:, 1])
    told = increments(biased(log, 0.1))
    np.testing.assert_allclose(told[:, :2], was[:, :2], atol=1e-9)
    np.testing.assert_allclose(told[:, 2] - was[:, 2], 0.1 * distance, atol=1e-9)


def test_a_slip_counts_what_is_not_driven(log: SimulatedLog) -> None:
    error = increments(slipping(log, forward_m_s=0.4, turn_rad_s=0.2, duration_s=2.0)) - increments(log)
    faulty = np.flatnonzero(np.abs(error).max(axis=1) > 1e-9)
    np.testing.assert_array_equal(faulty, 80 + np.arange(20))  # from 8 s on, 2 s long
    np.testing.assert_allclose(error[faulty], np.tile([0.04, 0.0, 0.02], (20, 1)), atol=1e-9)


def test_dragged_wheels_count_nothing_and_go_on(log: SimulatedLog) -> None:
    told, was = increments(standing_still(log, from_share=0.5, duration_s=3.0)), increments(log)
    np.testing.assert_allclose(told[100:130], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.delete(told - was, np.arange(100, 130), axis=0), 0.0, atol=1e-9)


def test_jumps_stay_and_spikes_do_not(log: SimulatedLog) -> None:
    was = increments(log)
    jump = increments(jumping(log, 5.0)) - was
    assert np.flatnonzero(np.abs(jump).max(axis=1) > 1e-9).tolist() == [100]
    np.testing.assert_allclose(jump[100], [5.0, 0.0, 0.0], atol=1e-9)
    leaps = increments(leaping(log, 2.0)) - was
    assert np.flatnonzero(leaps[:, 0] > 1e-9).tolist() == list(range(19, 200, 20))
    np.testing.assert_allclose(leaps.sum(axis=0), [20.0, 0.0, 0.0], atol=1e-9)
    off = se2.between(log.T_odom_base, spiking(log, 2.0).T_odom_base)
    np.testing.assert_allclose(off[20::20], np.tile([2.0, 0.0, 0.0], (10, 1)), atol=1e-9)
    np.testing.assert_allclose(np.delete(off, np.arange(20, 201, 20), axis=0), 0.0, atol=1e-12)


def test_held_odometry_catches_up(log: SimulatedLog) -> None:
    told = held(log, 2).T_odom_base
    np.testing.assert_array_equal(told[::3], log.T_odom_base[::3])
    np.testing.assert_array_equal(told[1::3], log.T_odom_base[::3])
    np.testing.assert_array_equal(told[2::3], log.T_odom_base[::3])


def test_the_wrong_direction_comes_and_goes(log: SimulatedLog) -> None:
    told, was = increments(unsigned(log, every_s=5.0, duration_s=1.0)), increments(log)
    is_wrong = told[:, 0] < 0.0
    np.testing.assert_allclose(told[is_wrong], was[is_wrong] * [-1.0, -1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(told[~is_wrong], was[~is_wrong], atol=1e-9)
    assert np.count_nonzero(np.diff(is_wrong.astype(np.int8)) == 1) == 4
    assert is_wrong.sum() in range(36, 44)


def test_dead_odometry_repeats_its_last_pose(log: SimulatedLog) -> None:
    told = dead(log).T_odom_base
    np.testing.assert_array_equal(told[:101], log.T_odom_base[:101])
    np.testing.assert_array_equal(told[100:], np.tile(log.T_odom_base[100], (101, 1)))
    np.testing.assert_array_equal(dead(log, from_share=0.0).T_odom_base, np.tile(told[0], (N_SCANS, 1)))


def test_no_fault_leaves_the_odometry_as_it_is(log: SimulatedLog) -> None:
    for same in (late(log, 0.0), scaled(log, 1.0), turned(log, 1.0), biased(log, 0.0), jumping(log, 0.0)):
        np.testing.assert_allclose(se2.between(log.T_odom_base, same.T_odom_base), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        (lambda log: late(log, float("nan")), "the delay must be finite, not nan s"),
        (lambda log: scaled(log, float("inf")), "the fault of the odometry must be finite"),
        (lambda log: slipping(log, duration_s=-1.0), "the duration must be zero or positive, not -1 s"),
        (lambda log: jumping(log, 1.0, at_share=1.0), r"the share of the log must be in \[0, 1\), not 1"),
        (lambda log: held(log, 0), "the number of scans must be at least 1, not 0"),
        (
            lambda log: unsigned(log, every_s=1.0, duration_s=2.0),
            "the duration of 2 s must lie between 0 and 1 s",
        ),
    ],
)
def test_impossible_faults_are_refused(
    fault: Callable[[SimulatedLog], SimulatedLog], text: str, log: SimulatedLog
) -> None:
    with pytest.raises(ConfigError, match=text):
        fault(log)


def test_a_log_without_odometry_has_no_faults_of_it(log: SimulatedLog) -> None:
    without = log.with_odometry(np.full((N_SCANS, 3), np.nan))
    with pytest.raises(InputError, match="arc: faults of the odometry need a log with odometry at each scan"):
        scaled(without, 2.0)
