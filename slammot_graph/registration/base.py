"""What a localizer asks of a matcher, and what it gets."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

from slammot_graph.core.match_result import MatchResult
from slammot_graph.core.types import BoolArray, FloatArray

__all__ = ["Match", "MatchPrior", "MatchResult", "Matcher", "ReferenceScan"]

ReferenceT_contra = TypeVar("ReferenceT_contra", contravariant=True)


class MatchPrior(NamedTuple):
    """Where a match starts.

    Attributes
    ----------
    T_a_base : (3,) array
        Predicted base in the frame a of what is matched against.
    cov : (3, 3) array
        Its covariance (body frame), as the prior counts: cautious.
    cov_independent : (3, 3) array or None
        Its covariance (body frame) without what scans have in common; None: the same.
    """

    T_a_base: FloatArray
    cov: FloatArray
    cov_independent: FloatArray | None = None


class Match(NamedTuple):
    """Outcome of a match: its own result, and the estimate with the prior.

    Attributes
    ----------
    result : MatchResult
    T_a_base : (3,) array
        Base in the frame of what was matched against; the prior's where the match failed.
    cov : (3, 3) array
        Its covariance (body frame), without `MatchResult.cov_correlated`.
    """

    result: MatchResult
    T_a_base: FloatArray
    cov: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferenceScan:
    """A scan to match against: points (m, 2) [m] in its base frame, and which of them to use (m,)."""

    points_base: FloatArray
    is_used: BoolArray


class Matcher(Protocol[ReferenceT_contra]):
    """Finds the pose of a scan against a reference: a local map, or another scan."""

    def match(
        self,
        reference: ReferenceT_contra,
        points_base: FloatArray,
        is_static: BoolArray,
        laser_base: FloatArray,
        prior: MatchPrior,
        *,
        kernel_factor: float = 1.0,
    ) -> Match:
        """Match the static points of a scan of n beams.

        Parameters
        ----------
        reference : as the matcher takes it
        points_base : (n, 2) array [m]
        is_static : (n,) bool array
            Points to use.
        laser_base : (2,), (1, 2) or (n, 2) array
            Where all or each were seen from, base frame [m].
        prior : MatchPrior
        kernel_factor : float
            A robust kernel, if there is one, is made narrower by this.
        """
