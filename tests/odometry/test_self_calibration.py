from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry import self_calibration as calibration
from slammot_graph.odometry.noise import OdometryNoise
from slammot_graph.odometry.self_calibration import Calibration, Windows, calibrate, cut_windows
from slammot_graph.simulation import robot

MATCH_STD = np.array([0.002, 0.002, 0.001])
OF_WAY = ("std_m_per_sqrt_m", "std_rad_per_sqrt_m", "ratio_m_per_m")
OF_TURN = ("std_m_per_sqrt_rad", "std_rad_per_sqrt_rad", "ratio_rad_per_rad")
TYPICAL = np.array([1.0, 0.0, 1.0])


def drive_at_random(
    n: int, rng: np.random.Generator, *, turning: bool = True, driving: bool = True
) -> FloatArray:
    """(n, 3) poses: drives straight, drives bends, turns on the spot, and stands, for 40 scans each."""
    kind = rng.integers(0, 4, n // 40 + 1).repeat(40)[: n - 1]
    speed = np.where((kind < 2) & driving, rng.uniform(0.03, 0.07, n - 1), 0.0)
    turn = np.where(
        ((kind == 1) | (kind == 2)) & turning,
        0.06 * rng.choice([-1.0, 1.0], n // 40 + 1).repeat(40)[: n - 1],
        0.0,
    )
    poses = [np.zeros(3)]
    for v, w in zip(speed, turn, strict=True):
        poses.append(se2.compose(poses[-1], se2.exp(np.array([v, 0.0, w]))))
    return np.array(poses)


def cut(
    T_world_base: FloatArray,
    T_odom_base: FloatArray,
    rng: np.random.Generator,
    match_std: FloatArray = MATCH_STD,
) -> Windows:
    """With perfect local maps of 45 scans, and matches on them that err as they say."""
    n = len(T_world_base)
    anchors = np.arange(n) // 45 * 45
    T_anchor_base = se2.between(T_world_base[anchors], T_world_base)
    T_anchor_base = se2.compose(T_anchor_base, se2.exp(rng.normal(0.0, match_std, (n, 3))))
    cov = np.tile(np.diag(match_std**2), (n, 1, 1))
    return cut_windows(T_odom_base, T_anchor_base, cov, 0.0 * cov, anchors, np.ones(n, dtype=np.bool_))


def calibrated(
    noise: robot.OdometryNoise, *, scale: float = 1.0, n: int = 3000, seed: int = 0
) -> Calibration:
    rng = np.random.default_rng(seed)
    T_world_base = drive_at_random(n, rng)
    T_odom_base, _ = robot.simulate_odometry(T_world_base, noise, rng, noise_scale=scale)
    return calibrate(cut(T_world_base, T_odom_base, rng))


RANDOM = robot.OdometryNoise(scale_std=0.0, turn_scale_std=0.0, bias_std_rad_per_m=0.0, slips_per_m=0.0)


def typical_stds(noise: OdometryNoise) -> FloatArray:
    return np.sqrt(noise.covariance(TYPICAL).diagonal()[[0, 2]])


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_random_noise_is_recovered(scale: float, seed: int) -> None:
    got = calibrated(RANDOM, scale=scale, seed=seed)
    true = scale * np.sqrt([0.01**2 + 0.005**2, 0.01**2 + 0.02**2])
    ratio = typical_stds(got.noise) / true
    assert (ratio > 1.0 / 1.3).all()
    assert (ratio < 1.3).all()
    assert got.kept == ()
    assert got.spread == pytest.approx(1.0, abs=0.1)
    assert got.spread_before < 0.6
    assert got.match_scale == pytest.approx(1.0, abs=0.2)


def test_way_and_turn_are_told_apart() -> None:
    noise = replace(RANDOM, xy_std_per_sqrt_m=0.03, xy_std_per_sqrt_rad=0.01, theta_std_per_sqrt_m=0.03)
    got = calibrated(noise, n=4000).noise
    found = [got.std_m_per_sqrt_m, got.std_m_per_sqrt_rad, got.std_rad_per_sqrt_m, got.std_rad_per_sqrt_rad]
    np.testing.assert_allclose(found, [0.03, 0.01, 0.03, 0.02], rtol=0.3)


def test_a_wrong_scale_is_a_ratio() -> None:
    rng = np.random.default_rng(3)
    T_world_base = drive_at_random(4000, rng)
    increments = se2.log(se2.between(T_world_base[:-1], T_world_base[1:])) * [1.06, 1.06, 1.09]
    T_odom_base = [np.zeros(3)]
    for increment in se2.exp(increments):
        T_odom_base.append(se2.compose(T_odom_base[-1], increment))
    got = calibrate(cut(T_world_base, np.array(T_odom_base), rng)).noise
    np.testing.assert_allclose(typical_stds(got), [0.06, 0.09], rtol=0.35)
    assert got.ratio_m_per_m > 2.0 * got.std_m_per_sqrt_m
    assert got.ratio_rad_per_rad > 2.0 * got.std_rad_per_sqrt_rad


def test_slips_hardly_count() -> None:
    """Of 30 cm and 0.3 rad, every 3 m: a Gaussian would take them for ten times the noise."""
    slippery = replace(RANDOM, slips_per_m=0.3, slip_std_m=0.3, slip_std_rad=0.3)
    clean, slipped = (typical_stds(calibrated(noise, seed=5).noise) for noise in (RANDOM, slippery))
    assert (slipped < 1.8 * clean).all()


def test_a_windows_covariance_is_what_the_pipeline_compounds() -> None:
    rng = np.random.default_rng(0)
    noise = OdometryNoise(ratio_m_per_m=0.0, ratio_rad_per_rad=0.0)
    T = drive_at_random(60, rng)
    eye = np.zeros((60, 3, 3))
    windows = cut_windows(
        T, T, eye, eye, np.zeros(60, dtype=np.int64), np.ones(60, dtype=np.bool_), lengths=(50,)
    )
    expected = np.zeros((3, 3))
    for k in range(50):
        increment = se2.between(T[k], T[k + 1])
        expected = se2.compound_covariance(expected, increment, noise.covariance(increment))
    np.testing.assert_allclose(windows.covariance(noise)[0], expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(windows.residuals, 0.0, atol=1e-12)


def test_a_window_of_one_increment_has_the_covariance_of_the_increment() -> None:
    noise, T = OdometryNoise(), np.array([[3.0, 1.0, 2.0], [3.2, 0.7, 1.1]])
    T_match = se2.compose(T, np.array([[0.0, 0.0, 0.0], [0.02, 0.01, -0.03]]))
    independent, correlated = (
        np.array([np.diag([1e-5, 2e-5, 3e-6])] * 2),
        np.array([np.diag([4e-6, 5e-6, 6e-7])] * 2),
    )
    windows = cut_windows(
        T, T_match, independent, correlated, np.zeros(2, dtype=np.int64), np.ones(2, dtype=np.bool_)
    )
    assert (len(windows), windows.n_scans.tolist()) == (1, [1])
    increment = se2.between(T[0], T[1])
    np.testing.assert_allclose(windows.covariance(noise, 0.0)[0], noise.covariance(increment), atol=1e-15)
    moved = se2.between(T_match[0], T_match[1])
    expected = se2.compound_covariance(independent[0], moved, independent[1] + correlated[1])
    np.testing.assert_allclose(windows.cov_match[0], expected, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(windows.residuals[0], se2.log(np.array([0.02, 0.01, -0.03])), atol=1e-12)
    assert windows.distance_m[0] == pytest.approx(np.hypot(0.2, 0.3))
    assert windows.turn_rad[0] == pytest.approx(0.9)


def test_windows_end_where_both_ends_hang_on_one_anchor() -> None:
    n = 12
    T, eye = np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1))
    anchors = np.array([-1, -1, *[2] * 5, *[6] * 5])
    usable = np.ones(n, dtype=np.bool_)
    usable[3] = False  # may lie within
    windows = cut_windows(T, T, eye, eye, anchors, usable, lengths=(1, 2, 4))
    assert [int(np.count_nonzero(windows.n_scans == k)) for k in (1, 2, 4)] == [2 + 4, 2 + 3, 1 + 0]
    assert len(cut_windows(T, T, eye, eye, anchors, np.zeros(n, dtype=np.bool_))) == 0


@pytest.mark.parametrize(
    ("turning", "driving", "kept"),
    [
        (
            False,
            True,
            OF_TURN,
        ),
        (True, False, OF_WAY),
        (False, False, OF_TURN + OF_WAY),
    ],
)
def test_motion_that_is_missing_keeps_its_defaults(
    turning: bool, driving: bool, kept: tuple[str, ...]
) -> None:
    rng = np.random.default_rng(2)
    T_world_base = drive_at_random(1000, rng, turning=turning, driving=driving)
    T_odom_base, _ = robot.simulate_odometry(T_world_base, RANDOM, rng)
    default = OdometryNoise(std_m_per_sqrt_rad=0.021, ratio_m_per_m=0.051)
    got = calibrate(cut(T_world_base, T_odom_base, rng), default)
    assert set(got.kept) == set(kept)
    for name in kept:
        assert getattr(got.noise, name) == getattr(default, name)
    if driving:
        assert got.noise.std_m_per_sqrt_m == pytest.approx(0.01, rel=0.3)
    if turning:
        assert got.noise.std_rad_per_sqrt_rad == pytest.approx(0.02, rel=0.3)


def test_matches_that_err_more_than_they_say_are_not_taken_for_the_odometry() -> None:
    rng = np.random.default_rng(4)
    T_world_base = drive_at_random(3000, rng)
    T_odom_base, _ = robot.simulate_odometry(T_world_base, RANDOM, rng)
    windows = cut(T_world_base, T_odom_base, rng, 2.0 * MATCH_STD)
    got = calibrate(replace(windows, cov_match=windows.cov_match / 4.0))
    assert got.match_scale == pytest.approx(2.0, rel=0.2)
    ratio = typical_stds(got.noise) / np.sqrt([0.01**2 + 0.005**2, 0.01**2 + 0.02**2])
    np.testing.assert_allclose(ratio, 1.0, atol=0.3)


def test_a_long_log_is_thinned_and_a_standing_robot_counts_little(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "MAX_WINDOWS", 100)
    got = calibrated(RANDOM)
    assert got.n_windows <= 6 * 110
    assert dict(zip(calibration.PARAMETERS, got.n_windows_of, strict=True))["still_std_m"] == got.n_windows
    assert got.distance_m > 30.0
    assert got.turn_rad > 30.0


def test_too_few_windows_are_refused() -> None:
    rng = np.random.default_rng(0)
    T = drive_at_random(10, rng)
    with pytest.raises(InputError, match=r"windows of scans matched on one local map: \d+, needed: 30"):
        calibrate(cut(T, T, rng))


def test_an_exact_odometry_gives_small_and_usable_noise() -> None:
    got = calibrated(RANDOM, scale=0.0)
    assert (typical_stds(got.noise) < 0.003).all()
    assert got.noise.still_std_m == pytest.approx(calibration.LEAST_STILL, rel=0.05)
