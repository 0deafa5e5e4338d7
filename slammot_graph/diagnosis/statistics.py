"""What a run gathers, scan by scan, for its verdict: scans, raw odometry, matches and health."""

from collections import Counter

from slammot_graph.core.events import FOUND_AGAIN, PREDICTED_CAUSES
from slammot_graph.core.match_result import MatchStatus
from slammot_graph.core.results import Health, StepResult
from slammot_graph.core.spool import Spool
from slammot_graph.diagnosis.come_up import ComeUp
from slammot_graph.diagnosis.consistency import InnovationConsistency
from slammot_graph.diagnosis.inspect import MatchLimits, ScanStatistics
from slammot_graph.diagnosis.odometry import OdometryStatistics
from slammot_graph.diagnosis.turns import TurnAgreement


class RunStatistics:
    """Figures of a run, gathered one step after the other; cheap.

    Attributes
    ----------
    limits : MatchLimits
    scans : ScanStatistics
    odometry : OdometryStatistics
    turns : TurnAgreement
    come_up : ComeUp
    consistency : InnovationConsistency
    matches : Counter
        Scans by the status of their match; "none" where there was none.
    health : Counter
        Scans by their state.
    n_lost : int
        How often the robot was lost.
    n_apart : int
        How often it was and has not been found again: where that part of the run lies in the map is not known.
    contradictions : list of int
        Scans at which match and odometry began to contradict each other.
    blind : list of (int, str)
        Scans from which on the laser was blind, and the cause.
    """

    def __init__(self, limits: MatchLimits) -> None:
        self.limits = limits
        self.scans = ScanStatistics(limits)
        self.odometry = OdometryStatistics()
        self.turns = TurnAgreement()
        self.come_up = ComeUp()
        self.consistency = InnovationConsistency()
        self.matches: Counter[MatchStatus | str] = Counter()
        self.health: Counter[Health] = Counter()
        self.n_lost = self.n_apart = 0
        self.contradictions: list[int] = []
        self.blind: list[tuple[int, str]] = []

    @property
    def spools(self) -> tuple[Spool, ...]:
        """What grows with the scans."""
        return (self.odometry.spool,)

    def add(self, step: StepResult) -> None:
        """Take in the next step."""
        self.scans.add(step.scan)
        self.odometry.add(step.scan.stamp, step.scan.T_odom_base, step.T_map_base)
        self.turns.add(step)
        self.come_up.add(step)
        self.consistency.add(step)
        self.matches["none" if step.match is None else step.match.status] += 1
        self.health[step.health] += 1
        for event in step.events:
            if event.kind == "lost":
                self.n_lost += 1
                self.n_apart += event.data["cause"] not in PREDICTED_CAUSES
            if event.kind == "closure accepted" and str(event.data["reason"]).startswith(FOUND_AGAIN):
                self.n_apart -= self.n_apart > 0
            if event.kind == "laser blind":
                self.blind.append((event.scan, event.data["cause"]))
            if event.kind == "contradiction":
                self.contradictions.append(event.scan)
