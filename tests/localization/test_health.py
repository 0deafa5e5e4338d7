from slammot_graph.core.events import Event
from slammot_graph.core.match_result import UNLIKELY_NIS, MatchResult
from slammot_graph.core.results import Health
from slammot_graph.localization.health import UNLIKELY, HealthMonitor
from tests.localization.matches import CONTRADICTING, FAILED, MATCH, match_with

DEGENERATE = match_with(status="degenerate")
N = 3


def follow(*matches: MatchResult | None, lost_at: int = -1) -> tuple[list[Health], list[Event]]:
    """States and events after a first scan, which has no match."""
    monitor = HealthMonitor(N)
    updates = [
        monitor.update(scan, match, is_lost=scan == lost_at) for scan, match in enumerate((None, *matches))
    ]
    return [update.state for update in updates[1:]], [event for update in updates for event in update.events]


def test_what_converges_is_healthy_and_what_leaves_something_open_degenerate() -> None:
    states, events = follow(MATCH, DEGENERATE, FAILED, None, MATCH)
    assert states == ["healthy", "degenerate", "degenerate", "degenerate", "healthy"]
    assert events == []


def test_the_first_scan_has_nothing_to_match_onto() -> None:
    assert HealthMonitor().update(0, None, is_lost=False).state == "healthy"


def test_a_method_without_matches_is_healthy() -> None:
    monitor = HealthMonitor()
    updates = [monitor.update(k, None, is_lost=False, expects_match=False) for k in range(3)]
    assert [update.state for update in updates] == ["healthy"] * 3


def test_a_contradiction_ends_after_some_matches_that_agree() -> None:
    states, events = follow(CONTRADICTING, CONTRADICTING, MATCH, MATCH, MATCH, MATCH)
    assert states == [*["contradiction"] * 4, "recovered", "healthy"]
    assert [(event.kind, event.scan, event.severity) for event in events] == [
        ("contradiction", 1, "warning"),
        ("recovered", 5, "info"),
    ]
    assert dict(events[1].data) == {"after": "contradiction", "n_scans": 4, "n_consistent": N}


def test_a_degenerate_match_may_contradict_too() -> None:
    assert follow(match_with(status="degenerate", contradicts_odometry=True))[0] == ["contradiction"]


def test_unlikely_innovations_add_up_to_a_contradiction_until_as_many_are_likely() -> None:
    unlikely, likely = match_with(nis=UNLIKELY_NIS + 1.0), match_with(nis=UNLIKELY_NIS - 1.0)
    states, events = follow(*[unlikely, likely, likely] * 20)  # others make up for them
    assert (states, events) == (["healthy"] * 60, [])
    states, events = follow(unlikely, unlikely, likely, unlikely, unlikely)
    assert states == [*["healthy"] * 4, "contradiction"]
    states, events = follow(unlikely, FAILED, unlikely, None, unlikely)  # what failed tells of neither
    assert states[-1] == "contradiction"
    states, events = follow(unlikely, unlikely, unlikely, likely, likely, unlikely, likely, likely, likely)
    assert states == ["healthy", "healthy", *["contradiction"] * 6, "recovered"]
    assert [(event.kind, event.scan) for event in events] == [("contradiction", 3), ("recovered", 9)]
    assert events[0].data["reason"] == UNLIKELY


def test_another_contradiction_or_a_failure_begins_the_row_anew() -> None:
    for between in (CONTRADICTING, FAILED):
        states, events = follow(CONTRADICTING, MATCH, MATCH, between, MATCH, MATCH, MATCH)
        assert states == [*["contradiction"] * 6, "recovered"]
        assert len(events) == 2


def test_a_degenerate_match_neither_counts_nor_breaks_the_row() -> None:
    states, _ = follow(CONTRADICTING, MATCH, DEGENERATE, MATCH, DEGENERATE, MATCH)
    assert states == [*["contradiction"] * 5, "recovered"]


def test_a_contradiction_may_end_in_being_lost() -> None:
    states, events = follow(CONTRADICTING, FAILED, MATCH, CONTRADICTING, MATCH, MATCH, MATCH, lost_at=2)
    assert states == ["contradiction", *["lost"] * 5, "recovered"]
    assert [event.kind for event in events] == ["contradiction", "recovered"]  # "lost" is the localizer's own
    assert dict(events[1].data) == {"after": "lost", "n_scans": 5, "n_consistent": N}
