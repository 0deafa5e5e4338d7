"""The matchers there are, by their configuration."""

from typing import overload

from slammot_graph.mapping.local_map import LocalMap
from slammot_graph.registration.base import Matcher, ReferenceScan
from slammot_graph.registration.point_to_line import PointToLineConfig, PointToLineMatcher
from slammot_graph.registration.point_to_point import PointToPointConfig, PointToPointMatcher


@overload
def make_matcher(config: PointToLineConfig) -> Matcher[LocalMap]: ...


@overload
def make_matcher(config: PointToPointConfig) -> Matcher[ReferenceScan]: ...


def make_matcher(
    config: PointToLineConfig | PointToPointConfig,
) -> Matcher[LocalMap] | Matcher[ReferenceScan]:
    """Build a matcher."""
    if isinstance(config, PointToPointConfig):
        return PointToPointMatcher(config)
    return PointToLineMatcher(config)
