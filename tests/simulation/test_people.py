import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import FloatArray
from slammot_graph.simulation.free_space import free_space_of_segments
from slammot_graph.simulation.people import HALF_HIP_M, LEG_RADIUS_M, STRIDE_M, PeopleConfig, circles, walk
from tests.rooms import ROOM, box, wall_distance

ROOM_SPACE = free_space_of_segments(ROOM, np.array([2.0, 0.0]))
STAMPS: FloatArray = 0.1 * np.arange(300.0)
STILL_ROBOT = np.tile([2.0, 0.0, 0.0], (300, 1))


def straight(speed: float, heading: float, n: int = 120) -> tuple[FloatArray, FloatArray]:
    """One person (n, 1, 4) who walks straight on, and the stamps."""
    stamps, v = 0.05 * np.arange(float(n)), speed * np.array([np.cos(heading), np.sin(heading)])
    return np.column_stack([[1.0, -2.0] + stamps[:, None] * v, np.tile(v, (n, 1))])[:, None], stamps


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.5])
@pytest.mark.parametrize("speed", [0.6, 1.4])
def test_a_person_has_two_legs_that_swing_in_turn(speed: float, heading: float) -> None:
    people, stamps = straight(speed, heading)
    legs, person = circles(people, stamps, PeopleConfig())
    assert legs.shape == (120, 2, 3)
    assert person.tolist() == [0, 0]
    assert (legs[:, :, 2] == LEG_RADIUS_M).all()
    np.testing.assert_allclose(legs[:, :, :2].mean(axis=1), people[:, 0, :2], atol=1e-9)
    # in the person's frame: aside by half a hip, ahead and behind in turn
    offset = (legs[:, :, :2] - people[:, :, :2]) @ se2.rotation(heading)
    np.testing.assert_allclose(offset[:, :, 1], [[-HALF_HIP_M, HALF_HIP_M]] * 120, atol=1e-9)
    np.testing.assert_allclose(offset[:, 0, 0], -offset[:, 1, 0], atol=1e-9)
    ahead = offset[:, 1, 0]
    assert 0.15 < ahead.max() < 0.5 * STRIDE_M
    assert ahead.min() == pytest.approx(-ahead.max(), rel=0.02)
    # a full swing, there and back, takes two strides
    crossings = np.flatnonzero(np.diff(np.sign(ahead[1:])))
    assert np.mean(np.diff(stamps[crossings])) * speed == pytest.approx(STRIDE_M, rel=0.1)


def test_who_stands_has_his_legs_beside_each_other() -> None:
    people, stamps = straight(1.0, np.pi / 2)
    people[60:, 0, 2:] = 0.0
    people[60:, 0, :2] = people[59, 0, :2]
    legs, _ = circles(people, stamps, PeopleConfig())
    # he looks on where he went
    offset = legs[60:, :, :2] - people[60:, :, :2]
    np.testing.assert_allclose(offset[:, :, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.abs(offset[:, :, 0]), HALF_HIP_M, atol=1e-9)


def test_who_is_away_has_no_legs_and_gets_them_back() -> None:
    people, stamps = straight(1.0, 0.0)
    people[40:60] = np.nan
    legs, _ = circles(people, stamps, PeopleConfig())
    assert np.isnan(legs[40:60, :, :2]).all()
    assert np.isfinite(legs[:40]).all()
    assert np.isfinite(legs[60:]).all()


def test_a_cylinder_is_one_circle() -> None:
    people, stamps = straight(1.0, 0.0)
    both = np.concatenate([people, people + 1.0], axis=1)
    shapes, person = circles(both, stamps, PeopleConfig(shape="cylinder", cylinder_radius_m=0.3))
    np.testing.assert_array_equal(shapes[:, :, :2], both[:, :, :2])
    assert (shapes[:, :, 2] == 0.3).all()
    assert person.tolist() == [0, 1]
    legs, persons = circles(both, stamps, PeopleConfig())
    assert persons.tolist() == [0, 1, 0, 1]
    np.testing.assert_allclose(legs[:, [0, 2], :2].mean(axis=1), both[:, 0, :2], atol=1e-9)


def test_the_first_people_walk_alike_however_many_there_are() -> None:
    few, many = (
        walk(ROOM_SPACE, STAMPS, STILL_ROBOT, n, PeopleConfig(), np.random.default_rng(5)) for n in (2, 5)
    )
    np.testing.assert_array_equal(few, many[:, :2])
    assert not np.array_equal(many[:, 3], many[:, 4])


def test_people_wander_within_their_reach_at_their_speed() -> None:
    config = PeopleConfig(reach_m=3.5, speed_min_m_s=0.8, speed_max_m_s=0.9, pause_probability=0.0)
    people = walk(ROOM_SPACE, STAMPS, STILL_ROBOT, 4, config, np.random.default_rng(1))
    assert np.isfinite(people).all()
    assert np.linalg.norm(people[:, :, :2] - [2.0, 0.0], axis=2).max() < 1.5 * 3.5
    speed = np.hypot(people[:, :, 2], people[:, :, 3])
    assert 0.7 < np.median(speed) <= 0.9
    assert np.ptp(people[:, :, :2], axis=0).max() > 3.0
    assert wall_distance(people[:, :, :2], ROOM).min() > 0.2


def test_pauses_are_made_with_their_probability_and_length() -> None:
    never, always = (
        walk(
            ROOM_SPACE,
            STAMPS,
            STILL_ROBOT,
            4,
            PeopleConfig(pause_probability=p, pause_min_s=3.0, pause_max_s=4.0),
            np.random.default_rng(2),
        )
        for p in (0.0, 1.0)
    )
    stands = [np.hypot(people[10:, :, 2], people[10:, :, 3]) < 0.05 for people in (never, always)]
    assert stands[0].mean() < 0.05
    assert stands[1].mean() > 0.25


def test_who_is_left_behind_goes_away_and_comes_back_near() -> None:
    hall = free_space_of_segments(box(0, 0, 60, 8), np.array([2.0, 4.0]))
    robot = np.column_stack([np.linspace(2.0, 58.0, 600), np.full(600, 4.0), np.zeros(600)])
    stamps, config = 0.1 * np.arange(600.0), PeopleConfig(speed_max_m_s=0.6)
    people = walk(hall, stamps, robot, 3, config, np.random.default_rng(0))
    is_away = np.isnan(people[:, :, 0])
    assert is_away.any(axis=0).all()
    assert (~is_away[-200:]).any(axis=0).all()
    distance = np.linalg.norm(people[:, :, :2] - robot[:, None, :2], axis=2)
    assert np.nanmax(distance) <= 1.5 * config.reach_m + 0.2
    back = np.argwhere(~is_away & np.roll(is_away, 1, axis=0))
    assert len(back) >= 3
    assert all(1.9 < distance[k, p] < config.reach_m + 0.2 for k, p in back)


def test_nobody_walks_into_the_robot() -> None:
    """The robot rushes at where they are."""
    people_still = walk(ROOM_SPACE, STAMPS, STILL_ROBOT, 1, PeopleConfig(), np.random.default_rng(3))
    robot = STILL_ROBOT.copy()
    robot[:, 1] = 1.5 * np.sin(0.1 * STAMPS * 2.0)
    people = walk(ROOM_SPACE, STAMPS, robot, 5, PeopleConfig(), np.random.default_rng(3))
    distance = np.linalg.norm(people[:, :, :2] - robot[:, None, :2], axis=2)
    assert np.nanmin(distance) > 0.6
    assert np.isfinite(people_still).all()


def test_free_space_knows_its_clearance_exactly_at_its_cells() -> None:
    rows, cols = np.indices(ROOM_SPACE.clearance_m.shape)
    centres = ROOM_SPACE.origin + 0.1 * (np.stack([cols, rows], axis=-1) + 0.5)
    expected = np.minimum(wall_distance(centres, ROOM), 3.0)
    np.testing.assert_allclose(ROOM_SPACE.clearance_m, expected, atol=1e-9)
    points = np.random.default_rng(0).uniform([-5.5, -3.5], [5.5, 4.0], (500, 2))
    assert np.abs(ROOM_SPACE.clearance_at(points) - wall_distance(points, ROOM)).max() < 0.08
    assert ROOM_SPACE.clearance_at(np.array([[99.0, 0.0]])).tolist() == [0.0]
    walkable = ROOM_SPACE.walkable_points
    assert wall_distance(walkable, ROOM).min() >= 0.33
    # inside the boxes and outside the room nobody can get
    assert (np.abs(walkable[:, 0]) < 6.0).all()
    in_block = (walkable > [-0.5, -0.5]).all(axis=1) & (walkable < [0.3, 0.4]).all(axis=1)
    assert not in_block.any()


def test_ways_lead_to_their_goal_around_the_walls() -> None:
    goal, start = np.array([-2.5, 0.0]), np.array([2.5, 0.0])
    path, point, length = ROOM_SPACE.path_to(goal, start), start, 0.0
    for _ in range(100):
        ahead = ROOM_SPACE.ahead(path, point, 0.3)
        assert ahead is not None
        assert ROOM_SPACE.clearance_at(ahead) >= 0.33 - 1e-9
        length += float(np.hypot(*(ahead - point)))
        point = ahead
    assert np.hypot(*(point - goal)) < 0.11
    assert 5.0 < length < 6.5
    assert not ROOM_SPACE.is_clear_line(start, goal)
    assert ROOM_SPACE.is_clear_line(start, np.array([2.5, -2.0]))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"speed_min_m_s": 0.0}, "people need 0 < speed_min_m_s <= speed_max_m_s"),
        ({"speed_min_m_s": 2.0}, "people need 0 < speed_min_m_s <= speed_max_m_s"),
        ({"pause_min_s": -1.0}, "people need 0 <= pause_min_s <= pause_max_s"),
        ({"pause_probability": 1.1}, r"people.pause_probability must be in \[0, 1\], not 1.1"),
        ({"stop_after_share": -0.1}, r"people.stop_after_share must be in \[0, 1\], not -0.1"),
        ({"reach_m": 0.0}, "people.reach_m must be positive, not 0.0"),
        ({"keep_off_m": float("nan")}, "people.keep_off_m must be positive, not nan"),
        ({"along_min_m": 3.0}, "people need 0 < along_min_m <= along_max_m"),
    ],
)
def test_impossible_people_are_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        PeopleConfig(**changes)  # type: ignore[arg-type]


def test_there_are_no_fewer_than_no_people() -> None:
    with pytest.raises(ConfigError, match="the number of people must not be negative, not -2"):
        walk(ROOM_SPACE, STAMPS, STILL_ROBOT, -2, PeopleConfig(), np.random.default_rng(0))
    assert walk(ROOM_SPACE, STAMPS, STILL_ROBOT, 0, PeopleConfig(), np.random.default_rng(0)).shape == (
        300,
        0,
        4,
    )


def test_where_there_is_no_room_nobody_can_walk() -> None:
    with pytest.raises(ConfigError, match=r"no room for people: nowhere on the route is 0\.33 m clear"):
        free_space_of_segments(ROOM, np.array([5.95, 0.0]))
