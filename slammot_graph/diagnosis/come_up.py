"""Scans much of which something covers that has come up: the floor before a robot on a ramp, a cover, a large thing."""

import numpy as np

from slammot_graph.core.findings import Finding
from slammot_graph.core.results import StepResult
from slammot_graph.detection.reasons import COME_UP, TOO_WIDE

LEAST_SHARE, LEAST_SCANS = 0.1, 20
"""In so many scans more than this share of the returns lies on such things: a door, or a cart that passes, is less."""


class ComeUp:
    """Counts scans in which much lies on free cells, and is wider than a person."""

    def __init__(self) -> None:
        self._n_scans = 0
        self._first = -1
        self._n_without_odometry = 0

    def add(self, step: StepResult) -> None:
        """Take in the next step."""
        n = np.count_nonzero((step.reason == COME_UP) | (step.reason == TOO_WIDE))
        if n <= LEAST_SHARE * np.count_nonzero(step.is_valid):
            return
        self._first = step.scan.index if self._n_scans == 0 else self._first
        self._n_scans += 1
        self._n_without_odometry += step.scan.T_odom_base is None

    def findings(self) -> list[Finding]:
        """Say so; without odometry the path may be wrong there."""
        if self._n_scans < LEAST_SCANS:
            return []
        is_alone = 2 * self._n_without_odometry > self._n_scans
        return [
            Finding(
                kind="floor or cover",
                severity="warning" if is_alone else "info",
                cause=(
                    f"in {self._n_scans} scans, first at scan {self._first}, more than {LEAST_SHARE:.0%} of the returns"
                    " lie where free space was known, on something wider than a person: the floor before a robot that"
                    " tilts or drives onto a ramp, a cover before the laser, or something large that moves"
                ),
                remedy=(
                    "where no walls tell of it the way is guessed there, and may be off by metres: record the odometry,"
                    " or mount the laser higher"
                    if is_alone
                    else "that was kept out of the map; where no walls tell of the way the odometry does"
                ),
                data={"n_scans": self._n_scans, "first": self._first},
            )
        ]
