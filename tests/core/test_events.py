import json
from dataclasses import asdict
from typing import get_args

import numpy as np
import pytest

from slammot_graph.core.events import SEVERITIES, Event, EventKind, describe, make_event
from slammot_graph.core.results import ClosureAttempt, ClosureStatus

CLOSURE: dict[str, str | int | float] = {"target_node": 12, "source_node": 340, "reason": "no pose agrees"}


@pytest.mark.parametrize(
    ("event", "severity", "text"),
    [
        (make_event("match failed", 3, reason="too few"), "warning", "match failed: too few"),
        (
            make_event("lost", 3, cause="failed matches", n_scans=5),
            "error",
            "lost: 5 matches failed in a row, a new local map begins here",
        ),
        (
            make_event("lost", 3, cause="kidnapped", n_scans=8),
            "error",
            "lost: 8 scans with nothing in sight, the robot may have been kidnapped, a new local map begins here",
        ),
        (
            make_event("lost", 3, cause="blind drive", n_scans=8),
            "error",
            "lost: drove for 8 scans with nothing in sight, a new local map begins where the odometry says",
        ),
        (
            make_event("lost", 3, cause="changing view", n_scans=5),
            "error",
            "lost: 5 matches failed in a row, yet what agrees lies where the prediction says: the view changes from"
            " scan to scan, as on slopes or before hedges; a new local map begins there",
        ),
        (
            make_event("laser blind", 3, cause="covered"),
            "warning",
            "laser blind: something covers the laser; the odometry alone tells of the motion",
        ),
        (
            make_event("factor dropped", 3, factor="match", from_node=3, to_node=7, reason="not finite"),
            "warning",
            "match factor 3-7 dropped, the pose graph goes on without it: not finite",
        ),
        (make_event("closure refused", 3, **CLOSURE), "info", "closure 12-340 refused: no pose agrees"),
        (
            make_event("closure rejected", 3, **CLOSURE),
            "warning",
            "closure 12-340 rejected as an outlier: no pose agrees",
        ),
    ],
)
def test_an_event_is_as_serious_as_its_kind_and_one_line(event: Event, severity: str, text: str) -> None:
    assert (event.scan, event.severity, event.text) == (3, severity, text)
    told = json.loads(json.dumps(asdict(event)))
    assert describe(told["kind"], told["data"]) == text


def test_every_kind_has_a_severity() -> None:
    assert set(SEVERITIES) == set(get_args(EventKind))


@pytest.mark.parametrize(
    ("status", "reason", "text"),
    [
        ("accepted", "", "closure 12-340 accepted"),
        ("accepted", "confirmed by 2 others", "closure 12-340 accepted, confirmed by 2 others"),
        ("waiting", "far", "closure 12-340 waits for another to confirm it, far"),
        ("refused", "far", "closure 12-340 refused: far"),
        ("outlier", "far", "closure 12-340 rejected as an outlier: far"),
    ],
)
def test_a_closure_attempt_reads_like_its_event(status: ClosureStatus, reason: str, text: str) -> None:
    attempt = ClosureAttempt(
        target_node=12, source_node=340, status=status, reason=reason, T_target_source=np.zeros(3)
    )
    event = attempt.event(77)
    assert attempt.text == event.text == text
    assert event.scan == 77
    assert event.kind.startswith("closure ")
    assert (event.data["target_node"], event.data["source_node"]) == (12, 340)


def test_a_contradiction_and_its_end() -> None:
    begun = make_event("contradiction", 3, reason="the wheels tell of 2 m in 0.1 s")
    assert (
        begun.text
        == "contradiction: odometry and laser tell of different motions, the wheels tell of 2 m in 0.1 s"
    )
    assert make_event("contradiction", 3, reason="").text.endswith("different motions")
    for after, words in (
        ("lost", "the robot was lost"),
        ("contradiction", "odometry and laser contradicted each other"),
    ):
        ended = make_event("recovered", 20, after=after, n_scans=17, n_consistent=5)
        assert ended.text == f"recovered: {words}, 17 scans ago; 5 matches in a row agree again"
        assert ended.severity == "info"


def test_a_robot_that_the_saved_map_does_not_show_is_lost() -> None:
    event = make_event("lost", 7, cause="saved map", n_scans=40)
    assert event.text.startswith("lost: for 40 scans the saved map has not shown what the robot sees")
