"""Whether matches land where they were predicted, within what both are said to know."""

from collections.abc import Sequence

from slammot_graph.core.findings import Finding
from slammot_graph.core.match_result import UNLIKELY_NIS
from slammot_graph.core.results import StepResult

MIN_MATCHES = 30
MAX_SHARE = 0.1
"""Of the matches with a larger one; logs in order have 0 to 0.01, with poor odometry too, as that is learnt."""


class InnovationConsistency:
    """Counts matches that are farther from their prediction than the covariances of both allow.

    Attributes
    ----------
    n_matches, n_unlikely : int
    """

    def __init__(self) -> None:
        self.n_matches = self.n_unlikely = 0

    def add(self, step: StepResult) -> None:
        """Take in the next step."""
        if step.match is None or not step.match.nis >= 0.0:
            return
        self.n_matches += 1
        self.n_unlikely += step.match.nis > UNLIKELY_NIS

    def findings(self) -> Sequence[Finding]:
        """Give what that tells of the log."""
        if self.n_matches < MIN_MATCHES or self.n_unlikely <= MAX_SHARE * self.n_matches:
            return ()
        share = self.n_unlikely / self.n_matches
        return (
            Finding(
                kind="inconsistent matches",
                severity="warning",
                cause=(
                    f"{100 * share:.0f}% of the matches lie farther from where they were predicted than both can err:"
                    " the scans do not fit onto each other as they are described, and poses and covariances are wrong"
                ),
                remedy=(
                    "look at the laser's angles (angle_min, angle_increment, its field of view), at its pose, and at"
                    " the stamps of laser and odometry"
                ),
                data={"n_matches": self.n_matches, "n_unlikely": self.n_unlikely},
            ),
        )
