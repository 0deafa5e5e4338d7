import numpy as np
import pytest

from slammot_graph.core.types import FloatArray
from slammot_graph.diagnosis.odometry import OdometryStatistics

N = 200


def steady(n: int = N) -> FloatArray:
    path = np.zeros((n, 3))
    path[:, 0] = 0.05 * np.arange(n)
    return path


def statistics_of(T_odom_base: FloatArray | None, truth: FloatArray | None = None) -> OdometryStatistics:
    statistics = OdometryStatistics()
    truth = steady() if truth is None else truth
    for k, T_map_base in enumerate(truth):
        statistics.add(0.1 * k, None if T_odom_base is None else T_odom_base[k], T_map_base)
    return statistics


def kinds(statistics: OdometryStatistics, *, has_moved: bool = True) -> list[str]:
    return [finding.kind for finding in statistics.findings(has_moved=has_moved)]


def test_good_odometry() -> None:
    statistics = statistics_of(steady())
    assert kinds(statistics) == []
    assert statistics.distance_m == pytest.approx(0.05 * (N - 1))
    assert kinds(OdometryStatistics()) == []


def test_none() -> None:
    (finding,) = statistics_of(None).findings(has_moved=True)
    assert (finding.kind, finding.severity) == ("no odometry", "info")


def test_it_never_moves() -> None:
    stuck, still = np.zeros((N, 3)), np.zeros((N, 3))
    (finding,) = statistics_of(stuck, still).findings(has_moved=True)
    assert finding.kind == "odometry never moves"
    assert "encoders" in finding.remedy
    assert kinds(statistics_of(stuck), has_moved=False) == [
        "odometry never moves"
    ]  # the estimate says it too
    assert kinds(statistics_of(stuck, still), has_moved=False) == []  # a robot that stands


def test_it_dies_on_the_way() -> None:
    dead = steady()
    dead[120:] = dead[120]
    (finding,) = statistics_of(dead).findings(has_moved=True)
    assert finding.kind == "odometry stands still"
    assert finding.data["intervals"] == [[121, N - 1]]
    standing = steady()
    standing[120:] = standing[120]
    assert kinds(statistics_of(dead, standing)) == []  # a robot that has parked


def test_it_stands_still_and_leaps() -> None:
    rare = steady()
    for k in range(10, N, 10):
        rare[k + 1 : k + 3] = rare[k]
    (finding,) = statistics_of(rare).findings(has_moved=True)
    assert finding.kind == "odometry leaps"
    assert finding.data["n_leaps"] == 19


def test_a_robot_that_stops_and_starts_does_not_leap() -> None:
    path = np.zeros((N, 3))
    is_driving = np.arange(N) % 44 < 40
    path[:, 0] = 0.05 * np.cumsum(is_driving)
    assert kinds(statistics_of(path, path)) == []


def test_it_jumps() -> None:
    jumping = steady()
    jumping[150:, 0] += 2.0
    (finding,) = statistics_of(jumping).findings(has_moved=True)
    assert finding.kind == "odometry jumps"
    assert finding.data["scans"] == [150]
    assert "jumps once, by up to 2.05 m" in finding.cause


def test_stamps_that_tell_nothing_are_no_jumps() -> None:
    statistics = OdometryStatistics()
    for T_map_base in steady():
        statistics.add(0.0, T_map_base, T_map_base)
    assert kinds(statistics) == []


def turning_path(sign: float = 1.0) -> FloatArray:
    path = steady()
    path[:, 2] = sign * np.cumsum(0.05 * np.sin(0.1 * np.arange(N)))
    return path


def test_it_turns_the_wrong_way() -> None:
    (finding,) = statistics_of(turning_path(-1.0), turning_path()).findings(has_moved=True)
    assert finding.kind == "odometry turns the wrong way"
    assert finding.data["share"] > 0.9
    assert kinds(statistics_of(turning_path(), turning_path())) == []
    half = np.where(np.arange(N)[:, None] < N // 2, turning_path(), turning_path(-1.0))
    assert "odometry turns the wrong way" not in kinds(statistics_of(half, turning_path()))
