"""Findings: what is wrong with a log or a run, its likely cause and the remedy."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from slammot_graph.core.events import Severity

FindingKind = Literal[
    "no returns",
    "no-return value",
    "beyond max_range",
    "too few beams",
    "too few returns",
    "ranges in millimetres",
    "angles in degrees",
    "more than a full turn",
    "nothing matched",
    "many failed matches",
    "inconsistent matches",
    "lost",
    "laser blind",
    "floor or cover",
    "contradiction",
    "no odometry",
    "odometry never moves",
    "odometry stands still",
    "odometry leaps",
    "odometry jumps",
    "odometry turns the wrong way",
    "mounting turned",
    "mounting shifted",
    "distance scale",
    "heading scale",
    "heading bias",
    "clock offset",
    "odometry noise",
    "stamps",
    "beam times",
    "frames",
    "map resolution",
]

RANKS: Mapping[Severity, int] = {"error": 0, "warning": 1, "info": 2}
"""The worst first."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something that is wrong, or was put right, as a person should be told.

    Attributes
    ----------
    kind : FindingKind
    severity : "info", "warning" or "error"
        An error means that the result is of no use.
    cause : str
        What is seen, and what it most likely comes from; one line.
    remedy : str
        What to do about it; one line, empty where there is nothing to do.
    data : mapping
        The numbers behind it.
    """

    kind: FindingKind
    severity: Severity
    cause: str
    remedy: str
    data: Mapping[str, Any] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """One line for a person."""
        return f"{self.cause}; {self.remedy}" if self.remedy else self.cause


def worst_first(findings: list[Finding]) -> tuple[Finding, ...]:
    """Sort findings by severity; those of one severity keep their order."""
    return tuple(sorted(findings, key=lambda finding: RANKS[finding.severity]))
