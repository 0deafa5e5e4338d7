import numpy as np
import pytest

from slammot_graph.core.errors import ConfigError
from slammot_graph.core.linalg import is_covariance
from slammot_graph.odometry.noise import ConstantNoise, OdometryNoise

SILENT = dict.fromkeys(
    (
        "std_m_per_sqrt_m",
        "std_rad_per_sqrt_m",
        "std_m_per_sqrt_rad",
        "std_rad_per_sqrt_rad",
        "ratio_m_per_m",
        "ratio_rad_per_rad",
    ),
    0.0,
)


def covariance(increment: list[float], **changes: float) -> np.ndarray:
    noise = OdometryNoise(**(SILENT | {"still_std_m": 1e-9, "still_std_rad": 1e-9} | changes))
    return noise.covariance(np.array(increment))


def test_a_still_robot_has_the_still_noise() -> None:
    cov = covariance([0.0, 0.0, 0.0], still_std_m=0.01, still_std_rad=0.02)
    np.testing.assert_allclose(cov, np.diag([1e-4, 1e-4, 4e-4]))


@pytest.mark.parametrize(
    ("name", "variances"),
    [
        ("std_m_per_sqrt_m", [0.05, 0.0]),  # 0.1^2 times a distance of 5 m
        ("std_rad_per_sqrt_m", [0.0, 0.05]),
        ("std_m_per_sqrt_rad", [0.02, 0.0]),  # times a turn of 2 rad
        ("std_rad_per_sqrt_rad", [0.0, 0.02]),
        ("ratio_m_per_m", [0.25, 0.0]),  # (0.1 * 5)^2
        ("ratio_rad_per_rad", [0.0, 0.04]),  # (0.1 * 2)^2
    ],
)
@pytest.mark.parametrize("turn", [2.0, -2.0])
def test_each_part_grows_with_its_motion(name: str, variances: list[float], turn: float) -> None:
    cov = covariance([-3.0, 4.0, turn], **{name: 0.1})
    np.testing.assert_allclose(cov, np.diag([variances[0], variances[0], variances[1]]), atol=1e-15)


def test_random_parts_do_not_depend_on_how_the_way_is_cut() -> None:
    parts = {"std_m_per_sqrt_m": 0.03, "std_rad_per_sqrt_m": 0.04}
    whole = covariance([2.0, 0.0, 0.0], **parts)
    np.testing.assert_allclose(whole, 4 * covariance([0.5, 0.0, 0.0], **parts), rtol=1e-9)


def test_defaults_are_covariances_also_without_motion() -> None:
    for increment in ([0.0, 0.0, 0.0], [2.0, 0.0, 3.0]):
        assert is_covariance(OdometryNoise().covariance(np.array(increment)))


def test_the_papers_noise_is_constant() -> None:
    for increment in (np.zeros(3), np.array([1.0, 2.0, 3.0])):
        np.testing.assert_allclose(ConstantNoise().covariance(increment), np.diag([0.01, 0.01, 0.0025]))
    noise = ConstantNoise(x_std_m=1.0, y_std_m=2.0, theta_std_rad=3.0)
    np.testing.assert_allclose(noise.covariance(np.zeros(3)), np.diag([1.0, 4.0, 9.0]))


@pytest.mark.parametrize("name", ["still_std_m", "still_std_rad"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_still_noise_must_be_positive(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"OdometryNoise.{name} must be positive, not {value}"):
        OdometryNoise(**{name: value})


@pytest.mark.parametrize("name", SILENT)
@pytest.mark.parametrize("value", [-1.0, float("nan")])
def test_growing_noise_must_not_be_negative(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"OdometryNoise.{name} must not be negative, not {value}"):
        OdometryNoise(**{name: value})


@pytest.mark.parametrize("name", ["x_std_m", "y_std_m", "theta_std_rad"])
def test_constant_noise_must_be_positive(name: str) -> None:
    with pytest.raises(ConfigError, match=f"ConstantNoise.{name} must be positive, not 0.0"):
        ConstantNoise(**{name: 0.0})
