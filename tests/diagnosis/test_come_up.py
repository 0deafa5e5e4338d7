"""Scans much of which lies on something that has come up where free space was known."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slammot_graph import Run
from slammot_graph.core import se2
from slammot_graph.detection.reasons import COME_UP, OCCUPIED, TOO_WIDE
from slammot_graph.diagnosis.come_up import LEAST_SCANS, LEAST_SHARE, ComeUp
from slammot_graph.simulation import SimulatedLog, simulate


def on_a_ramp(has_odometry: bool) -> SimulatedLog:
    """The floor comes up to two metres before a robot, and stays there."""
    log = simulate("lab", seed=5, rate_hz=5.0)
    there = np.clip((np.arange(log.n_scans) - 60) / 20.0, 0.0, 1.0)[:, None]
    down = np.cos(log.laser.angles_base) * np.sin(0.15 * there)
    floor = np.divide(0.3, down, out=np.full(log.ranges.shape, np.inf), where=down > 1e-3)
    log.ranges = np.fmin(log.ranges, floor)
    return log if has_odometry else log.with_odometry(np.full_like(log.T_odom_base, np.nan))


@pytest.mark.parametrize(("has_odometry", "severity"), [(True, "info"), (False, "warning")])
def test_the_floor_before_a_robot_on_a_ramp_is_told(has_odometry: bool, severity: str) -> None:
    log = on_a_ramp(has_odometry)
    result = Run(log, max_scans=130).complete()
    (finding,) = [each for each in result.verdict if each.kind == "floor or cover"]
    assert finding.severity == severity
    assert finding.data["n_scans"] >= LEAST_SCANS
    assert 60 <= finding.data["first"] < 90
    T_first = se2.compose(log.T_world_base[0], se2.inverse(result.T_map_base[0]))
    apart = se2.compose(T_first[None], result.T_map_base)[:, :2] - log.T_world_base[:130, :2]
    assert np.hypot(*apart.T).max() < 0.4


def step(k: int, share: float, reason: int, T_odom_base: Any = None) -> Any:
    n = round(100 * share)
    return SimpleNamespace(
        reason=np.array(n * [reason] + (100 - n) * [OCCUPIED]),
        is_valid=np.ones(100, dtype=np.bool_),
        scan=SimpleNamespace(index=k, T_odom_base=T_odom_base),
    )


@pytest.mark.parametrize("reason", [COME_UP, TOO_WIDE])
def test_it_takes_so_many_scans_with_so_much_of_it(reason: int) -> None:
    come_up = ComeUp()
    for k in range(3 * LEAST_SCANS):
        come_up.add(step(k, LEAST_SHARE, reason))
        come_up.add(step(k, 0.5, OCCUPIED))
    for k in range(LEAST_SCANS):
        assert come_up.findings() == []
        come_up.add(step(100 + k, LEAST_SHARE + 0.01, reason))
    (finding,) = come_up.findings()
    assert finding.data == {"n_scans": LEAST_SCANS, "first": 100}
