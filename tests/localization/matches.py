"""Matches made by hand."""

from dataclasses import replace
from typing import Any

import numpy as np

from slammot_graph.core.match_result import MatchResult

MATCH = MatchResult(
    status="converged",
    T_ref_base=np.zeros(3),
    innovation=np.zeros(3),
    cov=np.eye(3),
    information=np.eye(3),
    graph_information=np.eye(3),
    hessian_information=np.eye(3),
    cov_correlated=np.zeros((3, 3)),
    n_iterations=1,
    n_correspondences=1,
    inlier_ratio=1.0,
    residual_m=0.0,
)


def match_with(**changes: Any) -> MatchResult:
    """A match that is perfect but for the changes."""
    return replace(MATCH, **changes)


FAILED = match_with(status="failed", information=np.zeros((3, 3)), graph_information=np.zeros((3, 3)))
CONTRADICTING = match_with(contradicts_odometry=True)
