"""The health of the localization at each scan: a state machine fed with what became of the matches."""

from typing import Literal, NamedTuple

from slammot_graph.core.events import Event, make_event
from slammot_graph.core.match_result import UNLIKELY_NIS, MatchResult
from slammot_graph.core.results import Health

N_CONSISTENT = 5
"""So many matches in a row that converge and agree with the odometry end a contradiction, or being lost; so many that
are unlikely given the odometry begin one, less what others make up for."""

LIKELY = 0.5
"""A match that is likely makes up for so many that are not (a cumulative sum; Page, 1954). Where odometry and match are
as good as they say one in a thousand is unlikely: on recorded logs the sum was at most 2."""

UNLIKELY = "one match after the other is farther from where it was predicted than both can err"


class HealthUpdate(NamedTuple):
    """The state at a scan, and the event where it has just changed."""

    state: Health
    events: tuple[Event, ...] = ()


class HealthMonitor:
    """Follows the state of the localization.

    - healthy: the match converged and agrees with the odometry, or the method makes no matches.
    - degenerate: the match failed, left a direction open, or could not be made.
    - contradiction: odometry and match tell of different motions, at once or by `n_consistent` unlikely innovations
      (less `LIKELY` for each of the others), and until `n_consistent` matches in a row agree.
    - lost: the robot's place in the earlier map is not known, and until `n_consistent` matches in a row agree.
    - recovered: the scan at which a contradiction, or being lost, ends.

    A contradiction ends in recovery or in being lost. A degenerate match neither counts as agreeing nor breaks a row.

    Attributes
    ----------
    n_consistent : int
    trouble : "contradiction", "lost" or None
        What has begun and not ended.
    """

    def __init__(self, n_consistent: int = N_CONSISTENT) -> None:
        self.n_consistent = n_consistent
        self.trouble: Literal["contradiction", "lost"] | None = None
        self._n_agreeing = 0
        self._sum_unlikely = 0.0
        self._n_scans = 0
        self._is_first = True

    def update(
        self, scan: int, match: MatchResult | None, *, is_lost: bool, expects_match: bool = True
    ) -> HealthUpdate:
        """Take in the next scan.

        Parameters
        ----------
        scan : int
            Its index, for the events.
        match : MatchResult or None
        is_lost : bool
            The localizer has lost its place at this scan; its event is the localizer's.
        expects_match : bool
            The method makes matches; at the first scan there is nothing to match onto.
        """
        self._n_scans += self.trouble is not None
        is_expected, self._is_first = expects_match and not self._is_first, False
        is_unlikely = match is not None and match.nis > UNLIKELY_NIS
        if match is not None and match.status != "failed":
            change = 1.0 if is_unlikely else -LIKELY
            self._sum_unlikely = min(max(self._sum_unlikely + change, 0.0), self.n_consistent)
        adds_up = self._sum_unlikely >= self.n_consistent
        contradicts = adds_up or (match is not None and match.contradicts_odometry)
        events: tuple[Event, ...] = ()
        if is_lost:
            self._begin("lost")
        elif contradicts:
            if self.trouble is None:
                self._begin("contradiction")
                reason = UNLIKELY if adds_up or match is None else match.reason
                events = (make_event("contradiction", scan, reason=reason),)
            self._n_agreeing = 0
        elif is_unlikely or (match is not None and match.status == "failed"):
            self._n_agreeing = 0
        elif match is not None and match.status == "converged":
            self._n_agreeing += 1
        if self.trouble is None:
            is_healthy = not is_expected if match is None else match.status == "converged"
            return HealthUpdate(state="healthy" if is_healthy else "degenerate")
        if self._n_agreeing < self.n_consistent:
            return HealthUpdate(state=self.trouble, events=events)
        recovery = make_event(
            "recovered", scan, after=self.trouble, n_scans=self._n_scans, n_consistent=self._n_agreeing
        )
        self.trouble = None
        return HealthUpdate(state="recovered", events=(recovery,))

    def _begin(self, trouble: Literal["contradiction", "lost"]) -> None:
        self.trouble, self._n_agreeing, self._n_scans = trouble, 0, 0
