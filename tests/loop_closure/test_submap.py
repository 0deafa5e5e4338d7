from dataclasses import replace

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.types import FloatArray
from slammot_graph.loop_closure.submap import PreparedSubmap, Submap, SubmapConfig
from slammot_graph.mapping.local_map import LocalMapConfig, make_keyframe
from tests.rooms import LASER, ROOM, take_scan, wall_distance

CONFIG = SubmapConfig()
CELL_M, N_LEVELS = CONFIG.cell_m, CONFIG.n_levels
PLACES = np.array([[2.0 + 0.02 * k, 0.1 * k, 1.5 + 0.05 * k] for k in range(9)])
SHIFT = np.array([20.0, -30.0, 2.5])


def room_submap(T_local_anchor: FloatArray = SHIFT, places: FloatArray = PLACES, number: int = 3) -> Submap:
    keyframes = []
    for node, T_world_base in enumerate(places, start=7):
        scan = take_scan(T_world_base)
        T_local = se2.compose(T_local_anchor, se2.between(places[0], T_world_base))
        keyframes.append(
            make_keyframe(node, T_local, scan.points_base(), scan.is_valid(), LASER, LocalMapConfig())
        )
    return Submap(number, tuple(keyframes), 12.0)


@pytest.fixture(scope="module")
def submap() -> Submap:
    return room_submap()


@pytest.fixture(scope="module")
def prepared(submap: Submap) -> PreparedSubmap:
    return PreparedSubmap(submap)


def to_wall(points_anchor: FloatArray) -> FloatArray:
    return wall_distance(se2.transform(PLACES[0], points_anchor), ROOM)


def test_everything_is_relative_to_the_anchor(submap: Submap) -> None:
    assert submap.anchor == 7
    np.testing.assert_allclose(submap.T_anchor_keyframes, se2.between(PLACES[0], PLACES), atol=1e-9)
    np.testing.assert_allclose(submap.centre, se2.between(PLACES[0], PLACES)[:, :2].mean(axis=0), atol=1e-9)
    here, there = submap.points_and_normals, room_submap(np.zeros(3)).points_and_normals
    np.testing.assert_allclose(here[0], there[0], atol=1e-9)
    np.testing.assert_allclose(here[1], there[1], atol=1e-9)


def test_there_is_one_point_for_each_5_cm(submap: Submap) -> None:
    points, normals = submap.points_and_normals
    all_points = np.vstack(
        [
            se2.transform(T, k.points_base)
            for T, k in zip(submap.T_anchor_keyframes, submap.keyframes, strict=True)
        ]
    )
    first: dict[tuple[int, ...], FloatArray] = {}
    for point in all_points:
        first.setdefault(tuple(np.floor(point / 0.05).astype(int).tolist()), point)
    np.testing.assert_array_equal(points, list(first.values()))
    assert len(points) < 0.9 * len(all_points)
    assert to_wall(points).max() < 1e-9
    lengths = np.linalg.norm(normals, axis=1)
    assert np.mean(np.abs(lengths - 1.0) < 1e-9) > 0.9
    assert ((np.abs(lengths - 1.0) < 1e-9) | (lengths == 0.0)).all()
    keyframe = submap.as_keyframe()
    np.testing.assert_array_equal(keyframe.points_base, points)
    np.testing.assert_array_equal(keyframe.normals_base, normals)
    np.testing.assert_array_equal(keyframe.T_local_base, np.zeros(3))


def test_points_to_search_with_are_few_and_spread_out(submap: Submap) -> None:
    points, search = submap.points_and_normals[0], submap.search_points
    cells = {tuple(np.floor(point / (2 * CELL_M)).astype(int).tolist()) for point in search}
    assert len(cells) == len(search) <= 400
    assert {tuple(point) for point in search} <= {tuple(point) for point in points}
    assert len(cells) == len({tuple(np.floor(p / (2 * CELL_M)).astype(int).tolist()) for p in points})
    # so many that they must be thinned again
    places = np.column_stack([np.linspace(0.6, 4.0, 12), np.full(12, 1.5), np.linspace(0.0, 6.0, 12)])
    wide = room_submap(places=places)
    object.__setattr__(
        wide, "points_and_normals", (np.random.default_rng(0).uniform(-20, 20, (3000, 2)),) * 2
    )
    assert 250 < len(wide.search_points) <= 400


def test_scores_are_most_on_points_half_beside_and_a_loss_in_free_space(
    submap: Submap, prepared: PreparedSubmap
) -> None:
    points, _ = submap.points_and_normals
    rows, cols = prepared.pyramid.shape[1:]
    cells = {
        tuple(cell) for cell in np.floor((points - prepared.origin) / CELL_M).astype(int)[:, ::-1].tolist()
    }
    beside = {(i + a, j + b) for i, j in cells for a in (-1, 0, 1) for b in (-1, 0, 1)} - cells
    for i in range(rows):
        for j in range(cols):
            if (i, j) in cells:
                expected = [CONFIG.occupied_score]
            elif (i, j) in beside:
                expected = [CONFIG.neighbour_score]
            else:
                expected = [CONFIG.free_score] if prepared.is_free[i, j] else [0]
            assert prepared.score[i, j] in expected
    margin = 1 << (N_LEVELS - 1)
    assert not prepared.score[: margin - 1].any()
    assert not prepared.score[:, : margin - 1].any()
    assert prepared.pyramid.shape == (N_LEVELS, rows, cols)
    assert (np.diff(prepared.pyramid, axis=0) >= 0).all()


@pytest.mark.parametrize("k", [0, 1, 7, 8])
@pytest.mark.parametrize("far", [[25.0, 0.0], [-25.0, 3.0]])
def test_one_keyframe_may_see_farther_than_the_others(submap: Submap, k: int, far: list[float]) -> None:
    """Through a door, say."""
    keyframes = list(submap.keyframes)
    keyframes[k] = replace(
        keyframes[k],
        points_base=np.vstack([keyframes[k].points_base, far]),
        normals_base=np.vstack([keyframes[k].normals_base, [0.0, 0.0]]),
    )
    wide = Submap(3, tuple(keyframes), 0.0)
    points, _ = wide.points_and_normals
    assert len(points) == len(submap.points_and_normals[0]) + 1
    n_free, n_agree = PreparedSubmap(wide).free_share(points)
    assert n_free == 0
    assert n_agree >= len(points) - 1  # the grid need not reach it


def test_free_space_is_inside_the_room_and_off_its_walls(prepared: PreparedSubmap) -> None:
    cells = np.argwhere(prepared.is_free)
    centres = prepared.origin + CELL_M * (cells[:, ::-1] + 0.5)
    distance = to_wall(centres)
    assert len(cells) > 2000
    assert np.mean(distance > 0.05) > 0.99
    world = se2.transform(PLACES[0], centres)
    assert (np.abs(world[:, 0]) < 6.0).all()
    assert ((world[:, 1] > -4.0) & (world[:, 1] < 4.5)).all()
    # not behind the block in the middle, as seen from all three places
    in_shadow = (np.abs(world[:, 0] + 0.1) < 0.3) & (np.abs(world[:, 1]) < 0.3)
    assert not in_shadow.any()


def test_points_are_counted_as_in_free_space_or_agreeing(submap: Submap, prepared: PreparedSubmap) -> None:
    points, _ = submap.points_and_normals
    assert prepared.free_share(points) == (0, len(points))
    far = np.array([[1e3, 0.0], [0.0, -1e3], [-1e3, 1e3]])
    assert prepared.free_share(far) == (0, 0)
    near_robot = se2.transform(
        se2.between(PLACES[0], PLACES[1]), np.array([[0.5, 0.0], [0.0, 0.5], [0.3, -0.3]])
    )
    assert prepared.free_share(near_robot) == (3, 0)
    both = np.vstack([points[:10], near_robot, far])
    assert prepared.free_share(both) == (3, 10)


def test_the_same_room_shifted_lies_in_free_space(submap: Submap, prepared: PreparedSubmap) -> None:
    points, shares = submap.points_and_normals[0], []
    for shift in (0.0, 0.1, 0.5, 1.0):
        n_free, n_agree = prepared.free_share(points + np.array([shift, 0.0]))
        shares.append(n_free / (n_free + n_agree))
    assert shares[0] == 0.0
    assert shares[1] < 0.15
    assert min(shares[2:]) > max(2.0 * shares[1], 0.1)


def test_the_margin_of_the_search_is_empty_whoever_sees_farthest() -> None:
    """Every other keyframe makes the free space; a point that only the others saw counts too."""
    for k in range(3):
        submap = room_submap()
        keyframes = list(submap.keyframes)
        far = np.array([[30.0, -25.0]])
        keyframes[k] = replace(
            keyframes[k],
            points_base=np.vstack([keyframes[k].points_base, far]),
            normals_base=np.vstack([keyframes[k].normals_base, np.zeros((1, 2))]),
        )
        prepared = PreparedSubmap(Submap(0, tuple(keyframes), 0.0))
        margin = 1 << (N_LEVELS - 1)
        inside = prepared.score[margin:-margin, margin:-margin]
        assert (prepared.score > 0).sum() == (inside > 0).sum()
        points = Submap(0, tuple(keyframes), 0.0).points_and_normals[0]
        cells = np.floor((points - prepared.origin) / CELL_M).astype(int)
        assert (
            prepared.score[cells[:, 1], cells[:, 0]] >= CONFIG.neighbour_score
        ).all()  # rounding moves some by a cell
