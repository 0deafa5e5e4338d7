import math

import numpy as np
import pytest

from slammot_graph.core.types import FloatArray
from slammot_graph.logs.mounting import FrameTree, mounting_from_transform, transform_matrix


def planar(x: float, y: float, yaw: float) -> FloatArray:
    return transform_matrix((x, y, 0.3), (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))


def between(tree: FrameTree, base: str, laser: str) -> FloatArray:
    T_base_laser = tree.between(base, laser)
    assert T_base_laser is not None
    return T_base_laser


def test_chain_over_a_common_ancestor() -> None:
    tree = FrameTree()
    tree.add("odom", "base_footprint", planar(7, 8, 1.0))
    tree.add("base_footprint", "base_link", planar(0.5, 0, math.pi / 2))
    tree.add("base_footprint", "mast", planar(0, 1, 0))
    tree.add("mast", "laser", planar(0.2, 0, 0.3))
    from_footprint = mounting_from_transform(between(tree, "base_footprint", "laser"))
    assert from_footprint.T_base_laser == pytest.approx((0.2, 1.0, 0.3))
    from_link = mounting_from_transform(between(tree, "base_link", "laser"))
    assert from_link.T_base_laser == pytest.approx((1.0, 0.3, 0.3 - math.pi / 2))
    assert from_link.is_level
    assert not from_link.is_upside_down
    np.testing.assert_allclose(between(tree, "laser", "laser"), np.eye(4))


def test_frames_that_do_not_connect() -> None:
    tree = FrameTree()
    tree.add("odom", "base_link", planar(0, 0, 0))
    tree.add("a", "b", planar(0, 0, 0))
    tree.add("b", "a", planar(0, 0, 0))
    assert tree.between("base_link", "a") is None
    assert tree.between("base_link", "laser") is None
    assert tree.between("a", "base_link") is None


def test_upside_down_keeps_the_heading() -> None:
    roll = transform_matrix((0, 0, 0), (1.0, 0.0, 0.0, 0.0))
    mounting = mounting_from_transform(planar(0.1, 0.2, 0.5) @ roll)
    assert mounting.is_upside_down
    assert mounting.is_level
    assert mounting.T_base_laser == pytest.approx((0.1, 0.2, 0.5))


def test_tilt() -> None:
    pitch = transform_matrix((0, 0, 0), (0.0, math.sin(0.25), 0.0, math.cos(0.25)))
    mounting = mounting_from_transform(pitch)
    assert mounting.tilt == pytest.approx(0.5)
    assert not mounting.is_level


def test_quaternion_of_any_length() -> None:
    np.testing.assert_allclose(
        transform_matrix((1, 2, 3), (0, 0, 2, 2)), transform_matrix((1, 2, 3), (0, 0, 1, 1))
    )
