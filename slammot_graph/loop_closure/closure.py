"""A verified loop closure."""

from dataclasses import dataclass

from slammot_graph.core.results import ClosureAttempt, ClosureStatus
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure.submap import Place


@dataclass(frozen=True, kw_only=True, eq=False)
class Closure:
    """Two local maps found to be the same place: anchor of `source` in the frame of the anchor of `target`.

    Attributes
    ----------
    target, source : Place
    T_target_source : (3,) array
    cov, information : (3, 3) array
        Right perturbation; no information in directions that the match does not determine.
    cov_own : (3, 3) array or None
        Of the match's own noise, both local maps taken for rigid; None: as `cov`.
    overlap : float
        Share of the source's points that found a partner.
    """

    target: Place
    source: Place
    T_target_source: FloatArray
    cov: FloatArray
    information: FloatArray
    overlap: float
    cov_own: FloatArray | None = None

    def attempt(self, status: ClosureStatus, reason: str) -> ClosureAttempt:
        """What became of it."""
        return make_attempt(self.target, self.source, status, reason, self.T_target_source)


def make_attempt(
    target: Place, source: Place, status: ClosureStatus, reason: str, T_target_source: FloatArray
) -> ClosureAttempt:
    """What became of two local maps that might have been the same place."""
    return ClosureAttempt(
        target_node=target.anchor,
        source_node=source.anchor,
        status=status,
        reason=reason,
        T_target_source=T_target_source,
    )
