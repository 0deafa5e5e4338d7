"""Typed events: what happened at which scan, how serious it is, and the one place where that becomes prose."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

EventKind = Literal[
    "match failed",
    "lost",
    "closure accepted",
    "closure waiting",
    "closure refused",
    "closure rejected",
]
Severity = Literal["info", "warning", "error"]

_TEXTS: dict[EventKind, Callable[[Mapping[str, Any]], str]] = {
    "match failed": lambda data: f"match failed: {data['reason']}",
    "lost": lambda data: f"lost: {data['reason']}, a new local map begins here",
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
        What the text is made of: plain strings and numbers.
    """

    kind: EventKind
    severity: Severity
    scan: int
    data: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def text(self) -> str:
        """One line for a person."""
        return _TEXTS[self.kind](self.data)


def _pair(data: Mapping[str, Any]) -> str:
    return f"closure {data['target_node']}-{data['source_node']}"
