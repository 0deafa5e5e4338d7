"""Whether scans agree with the map less where the robot turns: as those of a laser that sweeps do, unless deskewed."""

from collections.abc import Sequence

import numpy as np

from slammot_graph.core import se2
from slammot_graph.core.findings import Finding
from slammot_graph.core.results import StepResult
from slammot_graph.core.types import FloatArray
from slammot_graph.detection.base import matched_returns

TURNING_RAD, STRAIGHT_RAD = 0.1, 0.02
"""From scan to scan: a sweep over the first bends a wall 5 m away by 0.5 m at its end, over the second by 0.1 m."""

MAX_TURN_RAD = 1.0
"""More is no turn but a closure."""

MIN_SCANS = 20
MAX_RATIO = 0.87
"""Share of the returns that agree while turning over that while not, below which the scans are taken for bent."""


def agreement_of(step: StepResult) -> float:
    """Share of a scan's returns that agree with the local map; those that were not matched do not."""
    if step.match is None or step.match.status == "failed":
        return 0.0
    n_valid = int(np.count_nonzero(step.is_valid))
    share = np.count_nonzero(matched_returns(step.is_valid, step.is_moving, step.reason)) / max(n_valid, 1)
    return float(share * step.match.inlier_ratio)


class TurnAgreement:
    """Mean share of the returns that agree with the local map, of scans while turning and of others.

    Attributes
    ----------
    n_turning, n_straight : int
        Scans without beam times that were matched.
    """

    def __init__(self) -> None:
        self.n_turning = self.n_straight = 0
        self._sum_turning = self._sum_straight = 0.0
        self._T_before: FloatArray | None = None

    @property
    def ratio(self) -> float:
        """Agreement while turning over that while not; NaN with too few scans of either."""
        if min(self.n_turning, self.n_straight) < MIN_SCANS or not self._sum_straight:
            return float("nan")
        return self._sum_turning / self.n_turning / (self._sum_straight / self.n_straight)

    def add(self, step: StepResult) -> None:
        """Take in the next step."""
        before, self._T_before = self._T_before, step.T_map_base
        if before is None or step.match is None or step.scan.beam_times is not None:
            return
        turn_rad = abs(float(se2.wrap_angle(step.T_map_base[2] - before[2])))
        if not (turn_rad < STRAIGHT_RAD or TURNING_RAD < turn_rad < MAX_TURN_RAD):
            return
        agreement = agreement_of(step)
        if turn_rad < STRAIGHT_RAD:
            self.n_straight += 1
            self._sum_straight += agreement
        else:
            self.n_turning += 1
            self._sum_turning += agreement

    def findings(self) -> Sequence[Finding]:
        """Give what that tells of the laser."""
        if not self.ratio < MAX_RATIO:
            return ()
        return (
            Finding(
                kind="beam times",
                severity="warning",
                cause=(
                    f"{100 * (1 - self.ratio):.0f}% fewer returns agree with the map while the robot turns, and the log"
                    " gives no time between beams: the laser may sweep, which bends its scans, or the odometry's turns"
                    " are wrong"
                ),
                remedy="give the time between beams (time_increment of the scans, or the key of an .npz)",
                data={"agreement_ratio": self.ratio, "n_turning": self.n_turning},
            ),
        )
