import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import interp1d

from slammot_graph.core.odometry_track import MAX_GAP_S, MAX_HOLD_S, OdometryTrack
from slammot_graph.core.types import FloatArray


def track(stamps: npt.ArrayLike, poses: npt.ArrayLike) -> OdometryTrack:
    return OdometryTrack.from_samples(np.array(stamps, dtype=float), np.array(poses, dtype=float))


def pose_at(odometry: OdometryTrack, stamp: float) -> FloatArray:
    pose = odometry.at(stamp)
    assert pose is not None
    return pose


def test_interpolates_as_scipy_does(rng: np.random.Generator) -> None:
    stamps = np.sort(rng.uniform(0.0, 10.0, 60))
    theta = np.cumsum(rng.uniform(-1.0, 1.5, 60))
    xy = rng.normal(size=(60, 2))
    wrapped = np.column_stack([xy, np.angle(np.exp(1j * theta))])
    odometry = track(stamps, wrapped)
    oracle = interp1d(stamps, np.column_stack([xy, theta]), axis=0)
    for stamp in rng.uniform(stamps[0], stamps[-1], 200):
        expected, actual = oracle(stamp), pose_at(odometry, stamp)
        np.testing.assert_allclose(actual[:2], expected[:2], atol=1e-12)
        np.testing.assert_allclose(np.exp(1j * actual[2]), np.exp(1j * expected[2]), atol=1e-12)
        assert -np.pi <= actual[2] < np.pi


def test_turns_along_the_shorter_arc() -> None:
    odometry = track([0.0, 1.0], [[0, 0, np.pi - 0.1], [1, 2, -np.pi + 0.3]])
    np.testing.assert_allclose(pose_at(odometry, 0.25), [0.25, 0.5, -np.pi], atol=1e-12)
    np.testing.assert_allclose(pose_at(odometry, 0.5), [0.5, 1.0, -np.pi + 0.1], atol=1e-12)


@given(st.permutations(range(6)))
def test_order_of_the_samples_does_not_matter(order: list[int]) -> None:
    stamps, poses = (
        np.arange(6.0),
        np.column_stack([np.arange(6.0) ** 2, np.arange(6.0), np.arange(6.0) * 0.3]),
    )
    shuffled = track(stamps[list(order)], poses[list(order)])
    np.testing.assert_allclose(pose_at(shuffled, 2.5), [6.5, 2.5, 0.75])


def test_of_equal_stamps_the_first_counts() -> None:
    odometry = track([0, 1, 1, 2], [[0, 0, 0], [1, 0, 0], [9, 0, 0], [2, 0, 0]])
    assert pose_at(odometry, 1.0)[0] == 1.0


def test_at_the_samples_themselves() -> None:
    odometry = track([0, 1, 2], [[0, 0, 3], [1, 5, -3], [2, 0, 3]])
    for stamp, pose in [(0, [0, 0, 3]), (1, [1, 5, -3]), (2, [2, 0, 3])]:
        np.testing.assert_allclose(pose_at(odometry, stamp), pose, atol=1e-12)


def test_held_at_the_ends_for_a_short_time() -> None:
    odometry = track([10.0, 10.1], [[1, 2, 0.3], [3, 4, 0.5]])
    np.testing.assert_allclose(pose_at(odometry, 10.0 - 0.9 * MAX_HOLD_S), [1, 2, 0.3])
    np.testing.assert_allclose(pose_at(odometry, 10.1 + 0.9 * MAX_HOLD_S), [3, 4, 0.5])
    assert odometry.at(10.0 - 1.1 * MAX_HOLD_S) is None
    assert odometry.at(10.1 + 1.1 * MAX_HOLD_S) is None


def test_long_gaps_are_not_bridged() -> None:
    end = MAX_GAP_S + 1.0
    odometry = track([0.0, end], [[1, 2, 0.3], [3, 4, 0.5]])
    assert odometry.at(0.5 * end) is None
    np.testing.assert_allclose(pose_at(odometry, 0.1), [1, 2, 0.3])
    np.testing.assert_allclose(pose_at(odometry, end - 0.1), [3, 4, 0.5])


def test_one_sample_is_a_track() -> None:
    odometry = track([5.0], [[1, 2, 0.3]])
    assert odometry.at(5.1) == pytest.approx([1, 2, 0.3])
    assert odometry.at(6.0) is None


@given(st.integers(0, 1000))
def test_many_stamps_are_asked_as_each_of_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.choice([0.1, 0.3, 1.9, 2.5], rng.integers(1, 12)))
    odometry = track(stamps, rng.normal(0.0, 3.0, (len(stamps), 3)))
    asked = np.concatenate([rng.uniform(-1.0, stamps[-1] + 1.0, 40), stamps, [np.nan]])
    found = odometry.at_many(asked)
    for stamp, pose in zip(asked, found, strict=True):
        one = odometry.at(float(stamp))
        np.testing.assert_allclose(pose, np.full(3, np.nan) if one is None else one, atol=1e-12)
