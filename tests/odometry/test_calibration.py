"""The odometry's parameters, recovered from simulated drives; see `OdometryReport` for what each means."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.odometry_report import Estimated
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.types import FloatArray
from slammot_graph.odometry.calibration import OdometryCalibration, SelfCalibration
from slammot_graph.odometry.calibration_config import CalibrationConfig
from slammot_graph.odometry.history import OdometryHistory
from slammot_graph.odometry.noise import OdometryNoise

RATE_HZ = 10.0
MATCH_STD = np.array([0.003, 0.003, 0.0015])
FINE_S = 0.01


@dataclass(frozen=True, kw_only=True)
class Faults:
    """What is wrong with the odometry, and how the robot drives."""

    offset_s: float = 0.0
    distance_scale: float = 1.0
    heading_scale: float = 1.0
    bias_rad_per_m: float = 0.0
    direction_rad: float = 0.0
    laser_shift_m: tuple[float, float] = (0.0, 0.0)
    noise_std: tuple[float, float, float] = (0.002, 0.002, 0.002)
    speed_m_s: float = 0.5
    turn_rad_s: float = 0.6


def smooth(n: int, hold_s: float, rng: np.random.Generator) -> FloatArray:
    """(n,) a velocity between -1 and 1, every FINE_S, that changes within a fraction of a second."""
    targets = rng.uniform(-1.0, 1.0, int(n * FINE_S / hold_s) + 2).repeat(round(hold_s / FINE_S))[:n]
    kernel = np.hanning(41)
    return np.convolve(targets, kernel / kernel.sum(), mode="same")


def integrated(velocity: FloatArray) -> FloatArray:
    """(n + 1, 3) poses along (n, 3) velocities of FINE_S each."""
    theta = np.concatenate([[0.0], np.cumsum(FINE_S * velocity[:, 2])])
    c, s = np.cos(theta[:-1]), np.sin(theta[:-1])
    x = np.cumsum(FINE_S * (c * velocity[:, 0] - s * velocity[:, 1]))
    y = np.cumsum(FINE_S * (s * velocity[:, 0] + c * velocity[:, 1]))
    return np.column_stack([np.concatenate([[0.0], x]), np.concatenate([[0.0], y]), theta])


def sampled(at_s: FloatArray, poses: FloatArray) -> FloatArray:
    times = FINE_S * np.arange(len(poses))
    return np.column_stack([np.interp(at_s, times, poses[:, k]) for k in range(3)])


def calibrated(
    faults: Faults,
    *,
    seed: int = 0,
    duration_s: float = 80.0,
    has_track: bool = False,
    config: CalibrationConfig | None = None,
) -> OdometryCalibration:
    """Drive, and give what is found from matches with errors of MATCH_STD."""
    rng = np.random.default_rng(seed)
    n = round((duration_s + 2.0) / FINE_S)
    speed = faults.speed_m_s * np.abs(smooth(n, 2.0, rng))
    turn = faults.turn_rad_s * smooth(n, 1.5, rng)
    c, s = math.cos(faults.direction_rad), math.sin(faults.direction_rad)
    true = integrated(np.column_stack([c * speed, s * speed, turn]))
    told = integrated(
        np.column_stack(
            [
                speed / faults.distance_scale,
                np.zeros(n),
                (turn - faults.bias_rad_per_m * speed / faults.distance_scale) / faults.heading_scale,
            ]
        )
    )
    stamps = 1.0 + np.arange(0.0, duration_s, 1.0 / RATE_HZ)
    scans = sampled(stamps + faults.offset_s, true)
    scans = se2.compose(scans, np.array([*faults.laser_shift_m, 0.0]))
    matches = se2.compose(scans, rng.normal(0.0, 1.0, scans.shape) * MATCH_STD)
    odometry = sampled(stamps, told)
    steps = se2.between(odometry[:-1], odometry[1:])
    steps += rng.normal(0.0, 1.0, steps.shape) * faults.noise_std
    noisy = [odometry[0]]
    for step in steps:
        noisy.append(se2.compose(noisy[-1], step))
    track = OdometryTrack.from_samples(stamps, np.array(noisy)) if has_track else None
    calibration = SelfCalibration(config or CalibrationConfig(), OdometryNoise())
    history, before_s = OdometryHistory(), 0.0
    variances = float(2.0 * MATCH_STD[0] ** 2), float(2.0 * MATCH_STD[2] ** 2)
    for k, stamp in enumerate(stamps):
        history.advance(float(stamp), noisy[k], track)
        now_s = history.clock.now_s
        if k:
            increment = se2.between(matches[k - 1], matches[k])
            calibration.add((before_s, now_s), increment, variances, matches[k], history)
        before_s = now_s
    calibration.fit(history)
    return calibration.now


def is_near(estimated: Estimated, true: float, within: float) -> bool:
    """Within a tolerance, and within five of its own standard deviations and a part of the tolerance."""
    off = abs(estimated.value - true)
    return off < within and off < 5.0 * estimated.std + 0.3 * within


@pytest.mark.parametrize("offset_s", [-0.5, -0.25, -0.1, 0.1, 0.25, 0.5])
@pytest.mark.parametrize("has_track", [False, True])
def test_a_clock_offset_is_found(offset_s: float, has_track: bool) -> None:
    for seed in range(3):
        found = calibrated(Faults(offset_s=offset_s), seed=seed, has_track=has_track)
        assert is_near(found.clock_offset_s, offset_s, 0.02)
        assert 0.02 <= found.clock_offset_s.std < 0.025  # a fifth of the time between scans
        assert found.distance_scale.value == pytest.approx(1.0, abs=0.03)


def test_no_clock_offset_is_found_where_there_is_none() -> None:
    found = [calibrated(Faults(), seed=seed).clock_offset_s for seed in range(20)]
    assert max(abs(offset.value) for offset in found) < 0.01
    assert sum(offset.value == 0.0 for offset in found) >= 18


@pytest.mark.parametrize("scale", [0.3, 0.7, 1.4, 3.0])
@pytest.mark.parametrize("offset_s", [0.0, 0.2])
def test_scales_are_found(scale: float, offset_s: float) -> None:
    faults = Faults(
        offset_s=offset_s,
        distance_scale=scale,
        heading_scale=1.0 / scale,
        noise_std=(0.002 / scale, 0.002 / scale, 0.002 * scale),
    )
    for seed in range(2):
        found = calibrated(faults, seed=seed)
        assert is_near(found.distance_scale, scale, 0.02 * scale)
        assert is_near(found.heading_scale, 1.0 / scale, 0.02 / scale)
        assert is_near(found.clock_offset_s, offset_s, 0.02)


def test_odometry_that_turns_the_wrong_way() -> None:
    found = calibrated(Faults(heading_scale=-1.0))
    assert is_near(found.heading_scale, -1.0, 0.02)
    assert is_near(found.distance_scale, 1.0, 0.02)


@pytest.mark.parametrize("bias", [-0.1, 0.05])
def test_a_bias_is_found(bias: float) -> None:
    found = calibrated(Faults(bias_rad_per_m=bias))
    assert is_near(found.heading_bias_rad_per_m, bias, 0.01)


@pytest.mark.parametrize("direction", [math.pi, -0.5, 0.1])
def test_a_mounting_that_is_turned_is_found(direction: float) -> None:
    found = calibrated(Faults(direction_rad=direction))
    off = math.remainder(found.direction_rad.value - direction, 2.0 * math.pi)
    assert abs(off) < 0.02
    assert found.direction_rad.std < 0.02
    assert is_near(found.distance_scale, 1.0, 0.02)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (-0.3, 0.0), (0.1, 0.25)])
@pytest.mark.parametrize(
    "faults", [Faults(), Faults(distance_scale=0.9, heading_scale=1.1, direction_rad=0.3)]
)
def test_a_laser_that_sits_elsewhere_than_told_is_found(shift: tuple[float, float], faults: Faults) -> None:
    found = calibrated(replace(faults, laser_shift_m=shift))
    for estimated, true in zip(found.laser_shift_m, shift, strict=True):
        assert is_near(estimated, true, 0.03)
        assert estimated.std < 0.03


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_the_noise_is_found(times: float) -> None:
    """Of about so many times the noise model's standard deviation at the drive's usual step."""
    cov = OdometryNoise().covariance(np.array([0.025, 0.0, 0.02]))
    std_m, std_rad = times * np.sqrt(cov[[0, 2], [0, 2]])
    found = calibrated(Faults(noise_std=(std_m, std_m, std_rad)))
    assert found.noise_scale_m.value == pytest.approx(times, rel=0.4)
    assert found.noise_scale_rad.value == pytest.approx(times, rel=0.4)


def test_odometry_without_noise_is_found_to_be_better_than_its_model() -> None:
    found = calibrated(Faults(noise_std=(0.0, 0.0, 0.0)))
    assert found.noise_scale_m.value < 0.3
    assert found.noise_scale_rad.value < 0.3


def is_prior(estimated: Estimated, value: float) -> bool:
    return math.isinf(estimated.std) and abs(estimated.value - value) < 0.1


def test_a_robot_that_stands_tells_nothing() -> None:
    found = calibrated(Faults(speed_m_s=0.0, turn_rad_s=0.0, noise_std=(0.0, 0.0, 0.0)))
    assert found.clock_offset_s.value == 0.0
    for estimated, prior in (
        (found.distance_scale, 1.0),
        (found.heading_scale, 1.0),
        (found.heading_bias_rad_per_m, 0.0),
        (found.direction_rad, 0.0),
    ):
        assert is_prior(estimated, prior)


def test_a_straight_drive_tells_nothing_of_turns() -> None:
    found = calibrated(Faults(turn_rad_s=0.0, distance_scale=1.2, noise_std=(0.002, 0.002, 0.0)))
    assert is_near(found.distance_scale, 1.2, 0.02)
    assert is_prior(found.heading_scale, 1.0)
    assert all(is_prior(shift, 0.0) for shift in found.laser_shift_m)


def test_turns_on_the_spot_tell_nothing_of_distances() -> None:
    found = calibrated(Faults(speed_m_s=0.0, heading_scale=1.2, noise_std=(0.0, 0.0, 0.002)))
    assert is_near(found.heading_scale, 1.2, 0.02)
    assert is_prior(found.distance_scale, 1.0)
    assert is_prior(found.heading_bias_rad_per_m, 0.0)


def test_steady_motion_tells_no_clock_offset() -> None:
    """At one speed along one line a delay looks like nothing at all."""
    rng = np.random.default_rng(0)
    history, calibration = OdometryHistory(), SelfCalibration(CalibrationConfig(), OdometryNoise())
    T_before = np.zeros(3)
    for k in range(400):
        T = np.array([0.05 * k, 0.0, 0.0]) + rng.normal(0.0, MATCH_STD)
        history.advance(0.1 * k, np.array([0.05 * (k + 3), 0.0, 0.0]), None)
        if k:
            increment = se2.between(T_before, T)
            calibration.add((0.1 * (k - 1), 0.1 * k), increment, (2e-5, 5e-6), T, history)
        T_before = T
    assert calibration.now.clock_offset_s.value == 0.0
    assert not calibration.now.clock_offset_s.std < 0.02


def offset_down_a_corridor(seed: int, config: CalibrationConfig) -> float:
    """The robot drives on at changing speed; the matches slide to and fro along the walls, each with those before."""
    rng = np.random.default_rng(seed)
    history, calibration = OdometryHistory(), SelfCalibration(config, OdometryNoise())
    x, odometry_x, T_before = 0.0, 0.0, np.zeros(3)
    n = 600
    speed = 0.05 + 0.03 * smooth(n * 10, 4.0, rng)[::10]
    slid = 0.15 * smooth(n * 10, 0.8, rng)[::10]
    for k in range(n):
        x += float(speed[k])
        odometry_x += float(speed[k]) + rng.normal(0.0, 0.003)
        T = np.array([x + float(slid[k]), 0.0, 0.0]) + rng.normal(0.0, MATCH_STD)
        history.advance(0.1 * k, np.array([odometry_x, 0.0, 0.0]), None)
        if k:
            increment = se2.between(T_before, T)
            calibration.add((0.1 * (k - 1), 0.1 * k), increment, (2e-5, 5e-6), T, history)
        T_before = T
    calibration.fit(history)
    return calibration.now.clock_offset_s.value


def test_matches_that_slide_make_up_no_clock_offset() -> None:
    """Their errors go together over many scans, so that some offset explains them by chance."""
    found = [offset_down_a_corridor(seed, CalibrationConfig()) for seed in range(8)]
    assert sum(value != 0.0 for value in found) <= 1
    by_likelihood_alone = CalibrationConfig(min_sigma=1e-9, min_sigma_kept=1e-9)
    assert sum(offset_down_a_corridor(seed, by_likelihood_alone) != 0.0 for seed in range(8)) >= 4


def offset_of_noisy_wheels(seed: int, offset_s: float) -> float:
    """The robot drives straight but for a wobble and a turn now and then, on wheels that slip aside all the time."""
    rng, n = np.random.default_rng(seed), 800
    history, calibration = OdometryHistory(), SelfCalibration(CalibrationConfig(), OdometryNoise())
    velocity = np.zeros((20 * n + 200, 3))
    velocity[:, 0] = 0.5 + 0.1 * smooth(len(velocity), 3.0, rng)
    velocity[:, 2] = 0.03 * smooth(len(velocity), 1.0, rng)
    for start in rng.integers(0, 20 * n, 6):
        velocity[start : start + 300, 2] += rng.choice([-0.5, 0.5])
    true = integrated(velocity)
    noise = np.cumsum(rng.normal(0.0, (0.005, 0.0, 0.025), (n + 10, 3)), axis=0)
    T_before = np.zeros(3)
    for k in range(n):
        now_s = 0.2 * k + 0.6
        told = sampled(np.array([now_s - offset_s]), true)[0]
        history.advance(0.2 * k, told + noise[k], None)
        T = sampled(np.array([now_s]), true)[0] + rng.normal(0.0, (0.005, 0.005, 0.0004))
        if k:
            calibration.add((0.2 * (k - 1), 0.2 * k), se2.between(T_before, T), (5e-5, 4e-7), T, history)
        T_before = T
    calibration.fit(history)
    return calibration.now.clock_offset_s.value


def test_wheels_whose_turns_are_mostly_noise_make_up_no_clock_offset() -> None:
    """A heading scale of 0 explains such turns best; found at some offsets only, it speaks for these."""
    assert [offset_of_noisy_wheels(seed, 0.0) for seed in range(6)] == [0.0] * 6


def test_the_clock_offset_of_wheels_whose_turns_are_mostly_noise_is_found() -> None:
    found = [offset_of_noisy_wheels(seed, 0.3) for seed in range(6)]
    assert found == pytest.approx([0.3] * 6, abs=0.1)  # half the time between scans


def test_slips_hardly_count() -> None:
    """The wheels spin for a tenth of the drive: a least-squares fit would be off by as much."""
    rng, slips = np.random.default_rng(3), 0
    history, calibration = OdometryHistory(), SelfCalibration(CalibrationConfig(), OdometryNoise())
    T, T_odom = np.zeros(3), np.zeros(3)
    for k in range(600):
        step = np.array([rng.uniform(0.02, 0.08), 0.0, rng.normal(0.0, 0.05)])
        is_slip = k // 20 % 10 == 5
        slips += is_slip
        T_before, T = T, se2.compose(T, np.zeros(3) if is_slip else step)
        T_odom = se2.compose(T_odom, step / np.array([1.1, 1.0, 1.0]))
        history.advance(0.1 * k, T_odom, None)
        if k:
            found = se2.between(T_before, T) + rng.normal(0.0, MATCH_STD)
            calibration.add((0.1 * (k - 1), 0.1 * k), found, (2e-5, 5e-6), T, history)
    assert slips == 60
    assert calibration.now.distance_scale.value == pytest.approx(1.1, abs=0.02)


def test_the_first_fit_waits_for_enough_matches() -> None:
    config = CalibrationConfig(n_first=10_000)
    history, calibration = OdometryHistory(), SelfCalibration(config, OdometryNoise())
    for k in range(1, 100):
        history.advance(0.1 * k, np.array([0.05 * k, 0.0, 0.0]), None)
        T = np.array([0.1 * k, 0.0, 0.0])
        calibration.add((0.1 * (k - 1), 0.1 * k), np.array([0.1, 0.0, 0.0]), (1e-5, 1e-6), T, history)
    assert calibration.now.distance_scale == Estimated(value=1.0)


def test_only_the_latest_matches_count() -> None:
    """Tyres lose air: what was once true is forgotten."""
    config = CalibrationConfig(n_kept=200)
    history, calibration = OdometryHistory(), SelfCalibration(config, OdometryNoise())
    T, T_odom, rng = np.zeros(3), np.zeros(3), np.random.default_rng(0)
    for k in range(1000):
        step = np.array([rng.uniform(0.0, 0.1), 0.0, rng.normal(0.0, 0.1)])
        T_before, T = T, se2.compose(T, step)
        T_odom = se2.compose(T_odom, step / np.array([1.0 if k < 500 else 1.3, 1.0, 1.0]))
        history.advance(0.1 * k, T_odom, None)
        if k:
            found = se2.between(T_before, T)
            calibration.add((0.1 * (k - 1), 0.1 * k), found, (2e-5, 5e-6), T, history)
    assert calibration.now.distance_scale.value == pytest.approx(1.3, abs=0.02)


def test_what_corrects_one_increment_corrects_many() -> None:
    found = OdometryCalibration(
        distance_scale=Estimated(value=1.2),
        direction_rad=Estimated(value=0.3),
        heading_scale=Estimated(value=0.9),
        heading_bias_rad_per_m=Estimated(value=0.05),
    )
    told = np.random.default_rng(0).normal(size=(4, 5, 3))
    corrected = found.corrected(told)
    for index in np.ndindex(4, 5):
        np.testing.assert_allclose(corrected[index], found.corrected(told[index]))
    x, y, turn = told[0, 0]
    expected = se2.rotation(0.3) @ (1.2 * told[0, 0, :2])
    np.testing.assert_allclose(corrected[0, 0], [*expected, 0.9 * turn + 0.05 * math.hypot(x, y)])


@pytest.mark.parametrize("name", ["n_kept", "n_first", "max_offset_s", "scale_std", "min_std_m"])
def test_impossible_settings_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"CalibrationConfig.{name} must be"):
        CalibrationConfig(**{name: 0})
