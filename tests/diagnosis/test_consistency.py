"""Matches far from their predictions, where the log describes the laser wrongly."""

from dataclasses import replace

import pytest

from slammot_graph import Run
from slammot_graph.core.match_result import UNLIKELY_NIS
from slammot_graph.diagnosis.consistency import MIN_MATCHES, InnovationConsistency
from slammot_graph.simulation import SimulatedLog, simulate


def kinds(log: SimulatedLog) -> set[str]:
    return {finding.kind for finding in Run(log, max_scans=150).complete().verdict}


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_beams_farther_apart_than_the_log_says_are_told(factor: float) -> None:
    log = simulate("lab", seed=5, rate_hz=5.0)
    log.lasers = (replace(log.laser, angle_increment=factor * log.laser.angle_increment),)
    assert ("inconsistent matches" in kinds(log)) == (factor != 1.0)


def test_few_matches_prove_nothing() -> None:
    consistency = InnovationConsistency()
    consistency.n_matches = consistency.n_unlikely = MIN_MATCHES - 1
    assert not consistency.findings()
    consistency.n_matches = consistency.n_unlikely = MIN_MATCHES
    (finding,) = consistency.findings()
    assert "100%" in finding.cause


def test_the_bound_is_exceeded_by_one_match_of_a_thousand() -> None:
    from scipy.stats import chi2

    assert chi2.sf(UNLIKELY_NIS, 3) == pytest.approx(1e-3, rel=0.01)
