"""Beams that hit the robot's own body: found where the robot moves, and only then."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.diagnosis.own_body import find_body, look_at, without_own_body
from slammot_graph.run import Run
from slammot_graph.simulation import SimulatedLog, simulate

BODY = slice(2, 9)


def log_of(*, has_body: bool, seed: int = 3) -> SimulatedLog:
    log = simulate("lab", seed=seed, n_people=0, n_laps=1)
    if has_body:
        noise = 0.01 * np.random.default_rng(seed).standard_normal((log.n_scans, 7))
        log.ranges = log.ranges.copy()
        log.ranges[:, BODY] = 0.25 + 0.01 * np.arange(7) + noise
    return log


def test_the_body_is_left_aside_and_told() -> None:
    log = log_of(has_body=True)
    cleaned = without_own_body(log)
    assert cleaned is not log
    scans = list(cleaned)
    assert len(scans) == log.n_scans
    for scan, ranges in zip(scans, log.ranges, strict=True):
        np.testing.assert_array_equal(scan.ranges[9:], ranges[9:])
    share = np.mean([np.isnan(scan.ranges[BODY]).mean() for scan in scans])
    assert share > 0.95
    (told,) = cleaned.warnings
    assert told.startswith(
        "7 beams hit the robot's own body (at -88 to -82 degrees of the laser, 0.25 to 0.31 m"
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_log_without_stays_as_it_is(seed: int) -> None:
    log = log_of(has_body=False, seed=seed)
    assert without_own_body(log) is log


def test_a_robot_that_stands_tells_nothing() -> None:
    log = log_of(has_body=True)
    standing = [replace(scan, T_odom_base=np.zeros(3), ranges=log.ranges[0]) for scan in log]
    assert all(find_body(looked) is None for looked in look_at(standing).values())


def test_nor_do_wheels_that_spin() -> None:
    log = log_of(has_body=True)
    stuck = [replace(scan, ranges=log.ranges[0]) for scan in log]
    assert all(find_body(looked) is None for looked in look_at(stuck).values())


def test_along_a_wall_the_beams_across_are_no_body() -> None:
    looked = next(iter(look_at(log_of(has_body=False)).values()))
    looked.ranges = [np.full(181, 0.6) + 3.0 * k * (np.arange(181) > 20) for k in range(40)]
    looked.headings = [0.02 * k for k in range(40)]
    assert find_body(looked) is None


def test_who_stands_before_the_body_is_seen() -> None:
    log = log_of(has_body=True)
    log.ranges[-1, BODY] = 0.15
    cleaned = list(without_own_body(log))
    np.testing.assert_array_equal(cleaned[-1].ranges, log.ranges[-1])


def test_a_run_takes_the_log_without_its_body() -> None:
    result = Run(log_of(has_body=True), max_scans=120).complete()
    assert any("own body" in text for text in result.log.warnings)
    assert not result.is_valid[:, 3:8].mean() > 0.05
