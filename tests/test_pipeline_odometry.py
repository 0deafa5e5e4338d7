"""Odometry that dies, never moves or counts backward at times: what the laser tells is followed."""

from collections.abc import Callable

import pytest

from slammot_graph import Run
from slammot_graph.evaluation import absolute_error
from slammot_graph.simulation import SimulatedLog, odometry_faults, simulate


@pytest.mark.parametrize(
    ("scenario", "seed", "fault"),
    [
        ("lab", 131, odometry_faults.unsigned),
        ("office", 131, odometry_faults.dead),
        ("hall", 130, lambda log: odometry_faults.dead(log, from_share=0.0)),
    ],
    ids=["counts backward at times", "dies", "never moves"],
)
def test_odometry_that_is_wrong_at_once_does_no_harm(
    scenario: str, seed: int, fault: Callable[[SimulatedLog], SimulatedLog]
) -> None:
    log = fault(simulate(scenario, seed=seed))
    result = Run(log).complete()
    assert absolute_error(result.T_map_base, log.T_world_base).translation_m.max < 0.1
    assert any(event.kind == "contradiction" for event in result.events)
    assert result.verdict
