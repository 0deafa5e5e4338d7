import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation.robot import (
    DriveConfig,
    OdometryErrors,
    OdometryNoise,
    drive,
    simulate_odometry,
)

QUIET = OdometryNoise(
    scale_std=0.0,
    turn_scale_std=0.0,
    bias_std_rad_per_m=0.0,
    xy_std_per_sqrt_m=0.0,
    xy_std_per_sqrt_rad=0.0,
    theta_std_per_sqrt_m=0.0,
    theta_std_per_sqrt_rad=0.0,
    slips_per_m=0.0,
)


def only(**stds: float) -> OdometryNoise:
    return OdometryNoise(**{**{name: getattr(QUIET, name) for name in QUIET.__dataclass_fields__}, **stds})


def path(step: list[float], n: int) -> FloatArray:
    """n equal steps, (n + 1, 3) poses."""
    poses = [np.array([3.0, -1.0, 0.4])]
    for _ in range(n):
        poses.append(se2.compose(poses[-1], se2.exp(np.array(step))))
    return np.array(poses)


def step_errors(T_world_base: FloatArray, T_odom_base: FloatArray) -> FloatArray:
    """(n, 3) what the odometry says of each step, less what it was."""
    said, was = (se2.log(se2.between(T[:-1], T[1:])) for T in (T_odom_base, T_world_base))
    return said - was


def odometry(
    noise: OdometryNoise, step: list[float], n: int, seed: int = 0, scale: float = 1.0
) -> FloatArray:
    poses = path(step, n)
    return step_errors(
        poses, simulate_odometry(poses, noise, np.random.default_rng(seed), noise_scale=scale)[0]
    )


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_noise_grows_with_the_root_of_the_way(scale: float) -> None:
    noise = only(xy_std_per_sqrt_m=0.02, theta_std_per_sqrt_m=0.03)
    error = odometry(noise, [0.25, 0.0, 0.0], 20_000, scale=scale)
    np.testing.assert_allclose(error.std(axis=0), scale * np.array([0.01, 0.01, 0.015]), rtol=0.03)
    assert (np.abs(error.mean(axis=0)) < 4.0 * error.std(axis=0) / np.sqrt(20_000)).all()
    np.testing.assert_allclose(np.corrcoef(error.T), np.eye(3), atol=0.03)


def test_noise_grows_with_the_root_of_the_turn() -> None:
    noise = only(xy_std_per_sqrt_rad=0.02, theta_std_per_sqrt_rad=0.03)
    error = odometry(noise, [0.0, 0.0, -0.25], 20_000)
    np.testing.assert_allclose(error.std(axis=0), [0.01, 0.01, 0.015], rtol=0.03)


def test_noise_of_way_and_turn_add_up_in_variance() -> None:
    noise = only(
        xy_std_per_sqrt_m=0.02,
        theta_std_per_sqrt_m=0.03,
        xy_std_per_sqrt_rad=0.04,
        theta_std_per_sqrt_rad=0.05,
    )
    error = odometry(noise, [0.3, 0.0, 0.2], 20_000)
    xy, theta = 0.02**2 * 0.3 + 0.04**2 * 0.2, 0.03**2 * 0.3 + 0.05**2 * 0.2
    np.testing.assert_allclose(error.var(axis=0), [xy, xy, theta], rtol=0.06)


@pytest.mark.parametrize("n", [20, 80])
def test_noise_does_not_depend_on_the_lasers_rate(n: int) -> None:
    """4 m straight on, in few steps or in many: the same spread at the end."""
    noise, ends = only(xy_std_per_sqrt_m=0.01, theta_std_per_sqrt_m=0.02), []
    poses = path([4.0 / n, 0.0, 0.0], n)
    rng = np.random.default_rng(4)
    for _ in range(1500):
        said, _ = simulate_odometry(poses, noise, rng)
        ends.append(said[-1] - [4.0, 0.0, 0.0])
    std = np.std(ends, axis=0)
    # along and in heading by the distance, across by the heading's random walk: integral of s^2 over 4 m
    across = np.sqrt(0.01**2 * 4.0 + 0.02**2 * 4.0**3 / 3.0)
    np.testing.assert_allclose(std, [0.02, across, 0.04], rtol=0.08)


def systematic(noise: OdometryNoise, n: int = 4000) -> tuple[FloatArray, list[OdometryErrors]]:
    """(n, 3) errors of one step of many logs."""
    poses, rng = path([0.4, 0.0, 0.3], 1), np.random.default_rng(9)
    out = [simulate_odometry(poses, noise, rng) for _ in range(n)]
    return np.array([step_errors(poses, said)[0] for said, _ in out]), [errors for _, errors in out]


def test_systematic_errors_are_drawn_once_a_log() -> None:
    error = odometry(only(scale_std=0.02, turn_scale_std=0.03, bias_std_rad_per_m=0.01), [0.2, 0.0, 0.1], 500)
    assert np.abs(error[0]).max() > 1e-4
    np.testing.assert_allclose(error, np.broadcast_to(error[0], error.shape), atol=1e-9)


def test_systematic_errors_have_their_size_and_are_told() -> None:
    error, told = systematic(only(scale_std=0.02, turn_scale_std=0.03, bias_std_rad_per_m=0.05))
    assert error[:, 0].std() == pytest.approx(0.4 * 0.02, rel=0.05)
    assert error[:, 2].std() == pytest.approx(np.hypot(0.3 * 0.03, 0.4 * 0.05), rel=0.05)
    np.testing.assert_allclose(error[:, 0], [0.4 * e.scale for e in told], atol=1e-9)
    np.testing.assert_allclose(
        error[:, 2], [0.3 * e.turn_scale + 0.4 * e.bias_rad_per_m for e in told], atol=1e-9
    )


def test_slips_come_as_often_and_as_large_as_they_should() -> None:
    noise = only(slips_per_m=0.5, slip_std_m=0.05, slip_std_rad=0.02)
    poses = path([0.1, 0.0, 0.0], 20_000)
    said, errors = simulate_odometry(poses, noise, np.random.default_rng(0))
    error = step_errors(poses, said)
    slips = np.flatnonzero(np.abs(error).max(axis=1) > 1e-7)
    np.testing.assert_array_equal(slips + 1, errors.slip_scans)
    assert len(slips) == pytest.approx(0.5 * 2000.0, rel=0.1)
    np.testing.assert_allclose(error[slips].std(axis=0), [0.05, 0.0, 0.02], rtol=0.1, atol=1e-9)


def test_a_robot_that_stands_has_no_noise() -> None:
    error = odometry(OdometryNoise(), [0.0, 0.0, 0.0], 50)
    np.testing.assert_allclose(error, 0.0, atol=1e-8)


def test_without_noise_the_odometry_is_the_way_from_the_origin() -> None:
    poses = path([0.1, 0.02, 0.2], 100)
    said, errors = simulate_odometry(poses, OdometryNoise(), np.random.default_rng(0), noise_scale=0.0)
    np.testing.assert_array_equal(said[0], np.zeros(3))
    np.testing.assert_allclose(se2.between(se2.between(poses[0], poses), said), 0.0, atol=1e-9)
    assert (errors.scale, errors.turn_scale, errors.bias_rad_per_m) == (0.0, 0.0, 0.0)


def test_the_default_noise_drifts_as_real_wheels_do() -> None:
    """50 m with turns: heading off by a few to some tens of degrees, never by nothing."""
    poses, ends = path([0.05, 0.0, 0.01], 1000), []
    for seed in range(40):
        said, _ = simulate_odometry(poses, OdometryNoise(), np.random.default_rng(seed))
        ends.append(se2.between(se2.between(poses[0], poses[-1]), said[-1]))
    assert np.deg2rad(5.0) < np.std(np.array(ends)[:, 2]) < np.deg2rad(40.0)


ROUTE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])


def test_a_drive_starts_rests_and_arrives(rng: np.random.Generator) -> None:
    poses = drive(ROUTE, DriveConfig(rest_start_s=2.0, rest_end_s=3.0, speed_spread=0.0), 0.1, rng)
    np.testing.assert_array_equal(poses[:20], np.tile(poses[0], (20, 1)))
    np.testing.assert_array_equal(poses[-30:], np.tile(poses[-1], (30, 1)))
    np.testing.assert_allclose(poses[0], 0.0, atol=0.03)
    assert np.hypot(*(poses[-1, :2] - ROUTE[-1])) < 0.15
    step = se2.log(se2.between(poses[:-1], poses[1:]))
    speed, turn = np.hypot(step[:, 0], step[:, 1]) / 0.1, step[:, 2] / 0.1
    assert 0.49 < speed.max() < 0.501
    assert np.abs(np.diff(speed)).max() < 0.1 * 0.5 * 1.05
    assert np.abs(turn).max() < 0.901
    assert np.abs(step[:, 1]).max() < 2e-3  # it does not move sideways


@pytest.mark.parametrize(
    "route", [[[1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]], [[1.0, 1.0, 0.0], [2.0, 1.0, 0.0]]]
)
def test_a_route_needs_two_points(route: list[list[float]], rng: np.random.Generator) -> None:
    with pytest.raises(ConfigError, match="the robot's route needs at least two different waypoints"):
        drive(np.array(route), DriveConfig(), 0.1, rng)


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_impossible_noise_is_refused(value: float, rng: np.random.Generator) -> None:
    for name in OdometryNoise.__dataclass_fields__:
        with pytest.raises(ConfigError, match=f"odometry noise: {name} must be zero or positive"):
            OdometryNoise(**{name: value})
    with pytest.raises(ConfigError, match="noise_scale must be zero or positive"):
        simulate_odometry(path([0.1, 0.0, 0.0], 3), OdometryNoise(), rng, noise_scale=value)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"max_speed_m_s": 0.0}, "drive: max_speed_m_s must be positive, not 0"),
        ({"lookahead_m": float("inf")}, "drive: lookahead_m must be positive, not inf"),
        ({"rest_end_s": -1.0}, "drive: rest_end_s must be zero or positive, not -1"),
        ({"speed_spread": 1.0}, r"drive: speed_spread must lie in \[0, 1\), not 1"),
    ],
)
def test_impossible_drives_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        DriveConfig(**changes)
