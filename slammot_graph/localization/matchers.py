"""Matchers onto the local map that differ from the configured one."""

from dataclasses import replace
from functools import lru_cache

from slammot_graph.mapping.local_map import LocalMap
from slammot_graph.registration.base import Matcher
from slammot_graph.registration.factory import make_matcher
from slammot_graph.registration.point_to_line import PointToLineConfig


@lru_cache(maxsize=8)
def matcher_failing_below(config: PointToLineConfig, least_agreement: float) -> Matcher[LocalMap]:
    """Give a matcher that fails only where a smaller share of the points agrees; with 0 none ever does."""
    return make_matcher(replace(config, min_inlier_ratio=min(least_agreement, 0.99), min_pairs=3))


def noisier_matcher(config: PointToLineConfig, scale: float) -> Matcher[LocalMap]:
    """Give a matcher that takes the noise of matches for so many times what the configuration says."""
    return make_matcher(
        replace(
            config,
            residual_std_m=scale * config.residual_std_m,
            floor_std_m=scale * config.floor_std_m,
        )
    )
