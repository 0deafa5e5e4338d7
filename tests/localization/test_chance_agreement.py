from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph import Run
from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.localization.chance_agreement import FARTHEST_M, N_OTHERS, NEAREST_M, stands_out
from slammot_graph.logs import open_log
from slammot_graph.simulation import simulate
from tests.rooms import ListLog

PREDICTED = np.array([3.0, -2.0, 0.7])


def agreement_around(T_peak: FloatArray, level: float, peak: float):  # type: ignore[no-untyped-def]
    """Agreement that is `level` everywhere but within 0.3 m of a pose."""

    def agreement_at(T: FloatArray) -> float:
        offset = se2.between(T_peak, T)
        return peak if np.hypot(offset[0], offset[1]) < 0.3 and abs(offset[2]) < 0.3 else level

    return agreement_at


@given(st.floats(0.0, 0.5), st.floats(0.01, 0.5))
def test_a_prediction_at_which_most_agrees_stands_out(level: float, more: float) -> None:
    assert stands_out(agreement_around(PREDICTED, level, level + more), PREDICTED)


@given(st.floats(0.0, 0.5))
def test_one_like_all_others_does_not(level: float) -> None:
    assert not stands_out(lambda _: level, PREDICTED)
    elsewhere = se2.compose(PREDICTED, np.array([10.0, 0.0, 0.0]))
    assert not stands_out(agreement_around(elsewhere, level, level + 0.2), PREDICTED)


def test_other_poses_lie_around_the_prediction_in_all_directions() -> None:
    tried: list[FloatArray] = []

    def agreement_at(T: FloatArray) -> float:
        tried.append(se2.between(PREDICTED, T))
        return float(len(tried) == 1)

    assert stands_out(agreement_at, PREDICTED)
    others = np.array(tried[1:])
    away = np.hypot(others[:, 0], others[:, 1])
    assert len(others) == N_OTHERS
    assert NEAREST_M - 1e-9 <= away.min() < away.max() <= FARTHEST_M + 1e-9
    for angles in (np.arctan2(others[:, 1], others[:, 0]), others[:, 2]):
        assert np.histogram(angles, bins=6, range=(-np.pi, np.pi))[0].min() >= 5


@pytest.mark.real
def test_on_a_slope_the_robot_goes_on_where_the_odometry_says(recorded_data: Path) -> None:
    """The laser sees the rising ground, a wall that moves along: most of these scans agrees with no pose."""
    log = open_log(recorded_data / "freiburg" / "fr-clinic_robotlaser.clf.bz2")
    scans = [replace(scan, index=k) for k, scan in enumerate(islice(log, 3060, 3180))]
    run = Run(ListLog(scans), "graph")
    lost = [event for step in run for event in step.events if event.kind == "lost"]
    result = run.result()
    assert [event.data["cause"] for event in lost] == ["changing view"]
    assert [finding.data["n_apart"] for finding in result.verdict if finding.kind == "lost"] == [0]
    assert result.T_map_odom_base is not None
    by_wheels = se2.between(result.T_map_odom_base[0], result.T_map_odom_base[-1])
    offset = se2.between(by_wheels, se2.between(result.T_map_base[0], result.T_map_base[-1]))
    assert np.hypot(offset[0], offset[1]) < 1.5  # on 24 m: the wheels' heading and scale are not known better
    assert abs(offset[2]) < 0.1
    assert (
        np.sqrt(result.cov_map[-1].diagonal()[:2].max()) < 2.0
    )  # 3 m and a full turn where nothing is known


FIRST = 60


def test_a_kidnapped_robot_is_lost_still() -> None:
    hall = simulate("hall", seed=4)
    away = np.hypot(*(hall.T_world_base[:, :2] - hall.T_world_base[FIRST, :2]).T)
    after = FIRST + int(np.flatnonzero(away[FIRST:] > 4.0)[0])
    scans = list(hall)
    kept = [*scans[:FIRST], *scans[after : after + 60]]
    T_odom = [scan.T_odom_base if scan.T_odom_base is not None else se2.IDENTITY for scan in scans]
    T_shift = se2.compose(T_odom[FIRST], se2.inverse(T_odom[after]))
    kidnapped = [
        replace(
            scan,
            index=k,
            stamp=scans[k].stamp,
            T_odom_base=T_odom[k] if k < FIRST else se2.compose(T_shift, T_odom[after + k - FIRST]),
            odometry=None,
        )
        for k, scan in enumerate(kept)
    ]
    steps = list(Run(ListLog(kidnapped), "graph"))
    causes = [event.data["cause"] for step in steps for event in step.events if event.kind == "lost"]
    assert "changing view" not in causes
