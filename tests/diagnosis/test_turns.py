"""Scans that agree less while the robot turns."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core.results import StepResult
from slammot_graph.diagnosis.turns import MIN_SCANS, TurnAgreement
from slammot_graph.run import Run
from tests.rooms import drive


@pytest.fixture(scope="module")
def matched() -> StepResult:
    return list(Run(drive(4)))[-1]


def judged(
    step: StepResult, while_turning: float, *, n: int = MIN_SCANS, swept: bool = False
) -> TurnAgreement:
    """As many scans while turning by 0.2 rad as while not, which agree by 0.9."""
    assert step.match is not None
    turns, theta = TurnAgreement(), 0.0
    scan = replace(step.scan, beam_times=np.zeros(len(step.scan.ranges)) if swept else None)
    for k in range(2 * n + 1):
        is_turning = k % 2 == 1
        theta += 0.2 * is_turning
        match = replace(step.match, inlier_ratio=while_turning if is_turning else 0.9)
        pose = np.array([1.0, 2.0, theta])
        turns.add(replace(step, scan=scan, T_map_base=pose, match=match, is_moving=step.is_valid & False))
    return turns


def test_less_agreement_while_turning_is_a_finding(matched: StepResult) -> None:
    turns = judged(matched, 0.6)
    assert turns.ratio == pytest.approx(0.6 / 0.9)
    (finding,) = turns.findings()
    assert finding.kind == "beam times"
    assert "33% fewer" in finding.text and "time_increment" in finding.remedy


def test_as_much_is_none(matched: StepResult) -> None:
    assert not judged(matched, 0.85).findings()


def test_few_scans_and_scans_with_beam_times_tell_nothing(matched: StepResult) -> None:
    assert np.isnan(judged(matched, 0.5, n=MIN_SCANS - 1).ratio)
    assert not judged(matched, 0.5, n=MIN_SCANS - 1).findings()
    swept = judged(matched, 0.5, swept=True)
    assert swept.n_turning == swept.n_straight == 0
