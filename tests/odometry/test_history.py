"""The scans' clock, and the odometry between the scans."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.history import FIRST_STEP_S, OdometryHistory, ScanClock

seeds = st.integers(0, 2**32 - 1)


def times_of(stamps: FloatArray, *, has_track: bool = False) -> tuple[FloatArray, list[ScanClock]]:
    """(n,) times of the clock, and copies of it after each scan."""
    clock, after = ScanClock(), []
    for stamp in stamps:
        clock.advance(float(stamp), has_track=has_track)
        copy = ScanClock()
        copy.__dict__.update(clock.__dict__)
        after.append(copy)
    return np.array([copy.now_s for copy in after]), after


def test_stamps_that_rise_are_the_time() -> None:
    stamps = 1.7e9 + np.cumsum([0.0, 0.1, 0.12, 0.08, 0.1, 0.2, 0.1])
    times, after = times_of(stamps)
    np.testing.assert_allclose(times, stamps - stamps[0], atol=1e-6)
    assert [clock.is_regular for clock in after] == [False] + 6 * [True]
    assert [clock.is_steady for clock in after] == 2 * [False] + 5 * [True]
    np.testing.assert_allclose([clock.step_s for clock in after[1:]], np.diff(stamps), atol=1e-6)


@pytest.mark.parametrize("jump_s", [-5.0, -(2.0**32), 0.0])
def test_where_stamps_do_not_rise_a_usual_step_is_taken(jump_s: float) -> None:
    """A clock set back, one of 32 bits that begins anew, and the same stamp twice."""
    stamps = 100.0 + 0.05 * np.arange(40.0)
    stamps[20:] += jump_s - 0.05 * (jump_s == 0.0)
    times, after = times_of(stamps)
    np.testing.assert_allclose(times, 0.05 * np.arange(40), atol=1e-5)
    assert [k for k, clock in enumerate(after) if not clock.is_regular] == [0, 20]
    assert [k for k, clock in enumerate(after) if not clock.is_steady] == [0, 1, 20, 21]
    assert after[20].step_s == pytest.approx(0.05, abs=1e-3)


def test_a_gap_counts_in_full_unless_it_is_out_of_any_sense() -> None:
    stamps = np.concatenate([0.1 * np.arange(20), 3.0 + 0.1 * np.arange(20)])  # 1.1 s
    times, after = times_of(stamps)
    np.testing.assert_allclose(times, stamps, atol=1e-9)
    assert after[20].step_s == pytest.approx(1.1)
    assert not after[20].is_steady
    stamps[20:] += 1000.0
    times, after = times_of(stamps)
    np.testing.assert_allclose(np.diff(times), 0.1, atol=1e-6)
    assert not after[20].is_regular
    # whoever has the odometry's own samples knows better
    times, after = times_of(stamps, has_track=True)
    np.testing.assert_allclose(times, stamps, atol=1e-9)
    assert after[20].is_regular


def test_a_long_step_after_a_wrong_one_makes_up_for_it() -> None:
    stamps = 0.1 * np.arange(20.0)
    stamps[10] -= 0.5
    _, after = times_of(stamps)
    assert [after[k].step_s for k in (10, 11)] == pytest.approx([0.1, 0.1])


@pytest.mark.parametrize(("start_s", "within_s"), [(1e5, 0.01), (1e6, 0.07)])
def test_stamps_of_single_precision(start_s: float, within_s: float) -> None:
    """At 1e6 s a float32 counts in steps of 0.06 s: the clock keeps up with them, rounded as they are."""
    stamps = (start_s + 0.1 * np.arange(3000)).astype(np.float32).astype(np.float64)
    times, _ = times_of(stamps)
    np.testing.assert_allclose(times, 0.1 * np.arange(3000), atol=within_s)


def test_after_usual_steps_stamps_that_stand_still_and_leap_tell_no_time() -> None:
    """At 1.7e9 s a float32 counts in steps of 128 s."""
    stamps = np.concatenate([0.1 * np.arange(20), 128.0 * (1 + np.arange(3000) // 1280)])
    times, _ = times_of(stamps)
    np.testing.assert_allclose(np.diff(times), FIRST_STEP_S, rtol=1e-6)


@given(st.lists(st.integers(-(10**13), 10**13), min_size=2, max_size=40))
def test_the_clock_never_runs_backward(stamps_ms: list[int]) -> None:
    times, after = times_of(1e-3 * np.array(stamps_ms))
    assert (np.diff(times) > 0.0).all()
    assert all(clock.step_s > 0.0 for clock in after)


def drive(seed: int, n: int = 30) -> tuple[FloatArray, FloatArray]:
    """Stamps (n,), not even, and poses (n, 3) whose heading is wrapped."""
    rng = np.random.default_rng(seed)
    stamps = 50.0 + np.cumsum(rng.uniform(0.08, 0.12, n))
    poses = np.cumsum(rng.normal(0.0, [0.1, 0.1, 0.6], (n, 3)), axis=0)
    poses[:, 2] = (poses[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    return stamps, poses


def interpolated(at_s: FloatArray, times: FloatArray, poses: FloatArray) -> FloatArray:
    unwrapped = np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])
    return np.column_stack([np.interp(at_s, times, unwrapped[:, k]) for k in range(3)])


def history_of(stamps: FloatArray, poses: FloatArray) -> OdometryHistory:
    history = OdometryHistory()
    for stamp, T in zip(stamps, poses, strict=True):
        history.advance(float(stamp), T, None)
    return history


@given(seeds)
def test_poses_between_scans_are_interpolated(seed: int) -> None:
    stamps, poses = drive(seed)
    history, times = history_of(stamps, poses), stamps - stamps[0]
    at_s = np.random.default_rng(seed).uniform(-1.0, times[-1], 50)
    expected = interpolated(at_s, times, poses)
    np.testing.assert_allclose(history.at(at_s), expected, atol=1e-9)
    np.testing.assert_allclose([history.pose_at(float(t)) for t in at_s], expected, atol=1e-9)


@given(seeds)
def test_beyond_the_latest_scan_the_motion_goes_on(seed: int) -> None:
    stamps, poses = drive(seed)
    history, end_s = history_of(stamps, poses), float(stamps[-1] - stamps[0])
    velocity = history.at(np.array([end_s])) - history.at(np.array([end_s - 0.01]))
    ahead = history.at(np.array([end_s + 0.3]))
    np.testing.assert_allclose(ahead, history.at(np.array([end_s])) + 30.0 * velocity, atol=1e-6)
    np.testing.assert_allclose(history.pose_at(end_s + 0.3), ahead[0], atol=1e-6)


def test_a_scan_without_odometry_leaves_a_gap_to_interpolate_over() -> None:
    history = OdometryHistory()
    for k in range(10):
        T = None if k in (4, 5) else np.array([0.2 * k, 0.0, 0.0])
        history.advance(0.1 * k, T, None)
    np.testing.assert_allclose(history.pose_at(0.45), [0.9, 0.0, 0.0], atol=1e-9)


def test_a_single_pose_stays() -> None:
    history = history_of(np.array([3.0]), np.array([[1.0, 2.0, 0.5]]))
    for time_s in (-1.0, 0.0, 4.0):
        np.testing.assert_array_equal(history.pose_at(time_s), [1.0, 2.0, 0.5])
        np.testing.assert_array_equal(history.at(np.array([time_s])), [[1.0, 2.0, 0.5]])


@given(seeds)
def test_the_odometry_of_the_whole_log_reaches_beyond_the_scan(seed: int) -> None:
    stamps, poses = drive(seed, 80)
    track, history = OdometryTrack.from_samples(stamps, poses.copy()), OdometryHistory()
    first = float(stamps[10])
    for k in range(4):
        history.advance(first + 0.1 * k, poses[10 + k], track)
    at_s = np.random.default_rng(seed).uniform(stamps[0] - first, stamps[-1] - first, 40)
    expected = interpolated(at_s + first, stamps, poses)
    np.testing.assert_allclose(history.at(at_s), expected, atol=1e-6)
    np.testing.assert_allclose([history.pose_at(float(t)) for t in at_s], expected, atol=1e-6)


def test_only_the_latest_poses_are_kept() -> None:
    n = 2 * OdometryHistory.N_KEPT + 10
    stamps = np.linspace(0.0, 0.1 * (n - 1), n)
    poses = np.column_stack([0.5 * stamps, np.zeros(n), np.zeros(n)])
    history, latest = history_of(stamps, poses), stamps[-OdometryHistory.N_KEPT :]
    np.testing.assert_allclose(history.at(latest)[:, 0], 0.5 * latest, atol=1e-6)
    assert history.at(np.array([0.0]))[0, 0] > 100.0
