"""Equality of scans, for the tests."""

from collections.abc import Sequence

import numpy as np

from slammot_graph.core.scan import Scan


def assert_same_scans(actual: Sequence[Scan], expected: Sequence[Scan]) -> None:
    assert len(actual) == len(expected)
    for a, b in zip(actual, expected, strict=True):
        assert a.index == b.index
        assert a.stamp == b.stamp
        assert a.laser == b.laser
        np.testing.assert_array_equal(a.ranges, b.ranges)
        np.testing.assert_array_equal(a.T_odom_base, b.T_odom_base)
