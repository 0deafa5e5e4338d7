import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.mapping.local_map import Keyframe, LocalMap, LocalMapConfig, make_keyframe
from tests.rooms import LASER, take_scan

START = np.array([2.0, 0.0, 1.5])


def keyframe(node: int, T_local_base: FloatArray, config: LocalMapConfig) -> Keyframe:
    scan = take_scan(se2.compose(START, T_local_base))
    return make_keyframe(node, T_local_base, scan.points_base(), scan.is_valid(), LASER, config)


def wall_points(T_local_base: FloatArray) -> FloatArray:
    scan = take_scan(se2.compose(START, T_local_base))
    return scan.points(T_local_base)


def test_keyframe_keeps_static_points_with_unit_normals() -> None:
    config, scan = LocalMapConfig(), take_scan(START)
    is_static = scan.is_valid() & (np.arange(LASER.n_beams) % 5 > 0)
    key = make_keyframe(7, START, scan.points_base(), is_static, LASER, config)
    np.testing.assert_array_equal(key.points_base, scan.points_base()[is_static])
    length = np.linalg.norm(key.normals_base, axis=1)
    assert set(np.round(length, 9)) <= {0.0, 1.0}
    np.testing.assert_array_equal(key.laser_base, [0.1, 0.0])
    assert key.node == 7


def test_normals_of_the_room_follow_its_walls() -> None:
    key = keyframe(0, np.zeros(3), LocalMapConfig())
    normals = key.normals_base @ se2.rotation(START[2]).T
    on_line = normals.any(axis=1)
    axis = np.abs(normals[on_line]).max(axis=1)  # walls run along x and y
    assert on_line.mean() > 0.8
    assert (axis > 0.999).mean() > 0.9


def test_a_keyframe_is_wanted_after_motion() -> None:
    config = LocalMapConfig(keyframe_distance_m=0.3, keyframe_rotation_rad=0.2)
    local_map = LocalMap(config)
    T = np.array([1.0, 2.0, 3.1])
    assert local_map.wants(T)
    local_map.add(keyframe(0, T, config))
    assert not local_map.wants(T)
    assert not local_map.wants(se2.compose(T, np.array([0.2, 0.2, 0.19])))
    assert local_map.wants(se2.compose(T, np.array([0.2, -0.25, 0.0])))
    assert local_map.wants(se2.compose(T, np.array([0.0, 0.0, 0.21])))
    assert local_map.wants(se2.compose(T, np.array([0.0, 0.0, -0.21])))


def test_a_full_map_is_replaced_by_one_of_its_latest_keyframes() -> None:
    config = LocalMapConfig(max_keyframes=4, n_overlap=2)
    local_map, fresh = LocalMap(config), LocalMap(config)
    keys = [keyframe(k, np.array([0.1 * k, 0.0, 0.1 * k]), config) for k in range(5)]
    finished = [local_map.add(key) for key in keys]
    assert finished == [(), (), (), tuple(keys[:4]), ()]
    assert [key.node for key in local_map.keyframes] == [2, 3, 4]
    assert local_map.anchor.node == 2
    fresh.start(keys[2:])
    np.testing.assert_array_equal(local_map.current_points(), fresh.current_points())


def test_points_of_all_keyframes_lie_on_the_walls_and_are_thinned() -> None:
    config = LocalMapConfig()
    local_map = LocalMap(config)
    poses = [np.array([0.02 * k, 0.01 * k, 0.002 * k]) for k in range(10)]
    for k, T in enumerate(poses):
        local_map.add(keyframe(k, T, config))
    n = len(local_map.current_points())
    n_all = sum(len(key.points_base) for key in local_map.keyframes)
    assert n < 0.7 * n_all
    walls = np.vstack([wall_points(T) for T in poses])
    distance = np.linalg.norm(local_map.current_points()[:, None] - walls[None], axis=-1).min(axis=1)
    assert distance.max() < 1e-9


def test_a_map_that_is_extended_shows_what_one_of_all_its_keyframes_does() -> None:
    config = LocalMapConfig(max_keyframes=3, n_overlap=1)
    keyframes = [keyframe(k, np.array([0.3 * k, 0.0, 0.1 * k]), config) for k in range(5)]
    whole, extended = LocalMap(config), LocalMap(config)
    whole.start(keyframes)
    extended.start(keyframes[:2])
    extended.extend(keyframes[2:])
    assert extended.keyframes == keyframes  # however many they are
    np.testing.assert_array_equal(extended.current_points(), whole.current_points())
    np.testing.assert_array_equal(extended.keyframe_roots, whole.keyframe_roots)


def test_starting_with_nothing_empties_the_map() -> None:
    config = LocalMapConfig()
    local_map = LocalMap(config)
    local_map.add(keyframe(0, np.zeros(3), config))
    local_map.start([])
    assert len(local_map.current_points()) == 0
    assert local_map.wants(np.zeros(3))


@pytest.mark.parametrize(
    "name",
    [
        "keyframe_distance_m",
        "keyframe_rotation_rad",
        "cell_m",
        "reach_m",
        "spacing_m",
        "field_m",
        "normal_half_window_rad",
        "normal_max_gap_m",
        "normal_max_thickness_m",
        "normal_std_rad",
    ],
)
@pytest.mark.parametrize("value", [0.0, float("nan")])
def test_impossible_local_maps_are_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=f"LocalMapConfig.{name} must be positive, not {value}"):
        LocalMapConfig(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(("n_overlap", "max_keyframes"), [(0, 5), (5, 5), (1, 1)])
def test_overlap_must_fit_into_a_map(n_overlap: int, max_keyframes: int) -> None:
    with pytest.raises(
        ConfigError,
        match=r"LocalMapConfig(\.n_overlap must be at| needs n_overlap < max_keyframes)",
    ):
        LocalMapConfig(n_overlap=n_overlap, max_keyframes=max_keyframes)
