"""Typed events: what happened at which scan, how serious it is, and the one place where that becomes prose."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

EventKind = Literal[
    "match failed",
    "lost",
    "contradiction",
    "recovered",
    "laser blind",
    "factor dropped",
    "closure accepted",
    "closure waiting",
    "closure refused",
    "closure rejected",
]
Severity = Literal["info", "warning", "error"]

FOUND_AGAIN = "found again"
"""So the reason of the closure begins by which a lost robot's place became known."""
PREDICTED_CAUSES = ("blind drive", "changing view")
"""Causes of being lost in which the robot goes on where its prediction says, and is not looked for elsewhere."""

SEVERITIES: Mapping[EventKind, Severity] = {
    "match failed": "warning",
    "lost": "error",
    "contradiction": "warning",
    "recovered": "info",
    "laser blind": "warning",
    "factor dropped": "warning",
    "closure accepted": "info",
    # routine: each finished local map is compared with several others nearby, most of which show another place
    "closure waiting": "info",
    "closure refused": "info",
    # the graph was wrong until now
    "closure rejected": "warning",
}
"""How serious an event of each kind is."""


def _pair(data: Mapping[str, Any]) -> str:
    return f"closure {data['target_node']}-{data['source_node']}"


def _lost(data: Mapping[str, Any]) -> str:
    n = data["n_scans"]
    if data["cause"] == "blind drive":
        return (
            f"lost: drove for {n} scans with nothing in sight, a new local map begins where the odometry says"
        )
    if data["cause"] == "changing view":
        return (
            f"lost: {n} matches failed in a row, yet what agrees lies where the prediction says: the view changes from"
            " scan to scan, as on slopes or before hedges; a new local map begins there"
        )
    if data["cause"] == "saved map":
        return f"lost: for {n} scans the saved map has not shown what the robot sees, it is looked for again"
    why = {
        "kidnapped": f"{n} scans with nothing in sight, the robot may have been kidnapped",
        "gap": "no scans for a while and no odometry, and nothing within reach looks like this scan",
    }.get(data["cause"], f"{n} matches failed in a row")
    return f"lost: {why}, a new local map begins here"


def _laser_blind(data: Mapping[str, Any]) -> str:
    if data["cause"] == "partly covered":
        return "laser blind: something covers most of the laser's beams; the others alone are used"
    why = (
        "the laser gives the same scan again and again while the robot moves"
        if data["cause"] == "repeated"
        else "something covers the laser"
    )
    return f"laser blind: {why}; the odometry alone tells of the motion"


def _recovered(data: Mapping[str, Any]) -> str:
    what = "the robot was lost" if data["after"] == "lost" else "odometry and laser contradicted each other"
    return (
        f"recovered: {what}, {data['n_scans']} scans ago; {data['n_consistent']} matches in a row agree again"
    )


_TEXTS: Mapping[EventKind, Callable[[Mapping[str, Any]], str]] = {
    "match failed": lambda data: f"match failed: {data['reason']}",
    "lost": _lost,
    "contradiction": lambda data: (
        "contradiction: odometry and laser tell of different motions"
        + (f", {data['reason']}" if data["reason"] else "")
    ),
    "recovered": _recovered,
    "laser blind": _laser_blind,
    "factor dropped": lambda data: (
        f"{data['factor']} factor {data['from_node']}-{data['to_node']} dropped, the pose graph goes on without it:"
        f" {data['reason']}"
    ),
    "closure accepted": lambda data: (
        f"{_pair(data)} accepted" + (f", {data['reason']}" if data["reason"] else "")
    ),
    "closure waiting": lambda data: f"{_pair(data)} waits for another to confirm it, {data['reason']}",
    "closure refused": lambda data: f"{_pair(data)} refused: {data['reason']}",
    "closure rejected": lambda data: f"{_pair(data)} rejected as an outlier: {data['reason']}",
}


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something a person should know.

    Attributes
    ----------
    kind : EventKind
    severity : "info", "warning" or "error"
    scan : int
        Index of the scan at which it happened.
    data : mapping
        What the text is made of, plain strings and numbers: `reason` of a failed match; `cause` ("kidnapped", "blind
        drive", "gap", "failed matches", "changing view" or "saved map") and `n_scans` of a lost robot; `cause`
        ("repeated", "covered" or "partly covered") of a blind laser; `reason` of a contradiction; `after`
        ("contradiction" or "lost"), `n_scans` since then and `n_consistent` of a recovery; `factor`, `from_node`,
        `to_node` and `reason` of what the graph could not take in; `target_node`, `source_node` and `reason` of a
        closure.
    """

    kind: EventKind
    severity: Severity
    scan: int
    data: Mapping[str, Any] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """One line for a person."""
        return describe(self.kind, self.data)


def make_event(kind: EventKind, scan: int, **data: str | int | float) -> Event:
    """Make an event with the severity of its kind."""
    return Event(kind=kind, severity=SEVERITIES[kind], scan=scan, data=data)


def describe(kind: EventKind, data: Mapping[str, Any]) -> str:
    """Put what happened into one line for a person."""
    return _TEXTS[kind](data)
