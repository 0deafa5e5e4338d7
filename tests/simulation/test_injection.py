from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.types import FloatArray
from slammot_graph.logs import open_log
from slammot_graph.simulation import PeopleConfig, SimulatedLog, inject, inject_along
from slammot_graph.simulation.people import circles
from tests.rooms import LASER, ROOM, ListLog, drive, truth_from_start, wall_distance

SPECIAL = [np.nan, np.inf, -np.inf, -1.0, 0.0, 29.5, 30.0, 1e9]


@pytest.fixture(scope="module")
def recorded() -> ListLog:
    """A log without people, some beams of which are no measurements."""
    log, rng = drive(120, with_person=False), np.random.default_rng(1)
    for scan in log:
        bad = rng.random(LASER.n_beams) < 0.1
        scan.ranges[bad] = rng.choice(SPECIAL, bad.sum())
    return log


@pytest.fixture(scope="module")
def reference(recorded: ListLog) -> FloatArray:
    return truth_from_start(recorded)


@pytest.fixture(scope="module")
def injected(recorded: ListLog, reference: FloatArray) -> SimulatedLog:
    return inject(recorded, reference, n_people=3, seed=5)


def recorded_ranges(log: ListLog) -> FloatArray:
    return np.array([scan.ranges for scan in log])


def assert_only_shortened(log: SimulatedLog, recorded: ListLog) -> None:
    """No ray is longer than recorded, and none but the labelled ones differs in a bit."""
    before = recorded_ranges(recorded)
    np.testing.assert_array_equal(log.ranges[~log.is_moving], before[~log.is_moving])
    shortened, was = log.ranges[log.is_moving], before[log.is_moving]
    has_return = np.isfinite(was) & (was > 0.0)
    assert (shortened[has_return] <= was[has_return]).all()
    assert np.isfinite(shortened).all()
    assert shortened.min() >= log.laser.range_min
    assert shortened.max() < 10.0


def test_people_shorten_rays_and_touch_no_other(injected: SimulatedLog, recorded: ListLog) -> None:
    assert_only_shortened(injected, recorded)
    assert injected.is_moving.sum() > 500
    # people are seen where there was no return as well
    assert (~np.isfinite(recorded_ranges(recorded)[injected.is_moving])).any()


def test_all_else_stays_as_it_was(injected: SimulatedLog, recorded: ListLog, reference: FloatArray) -> None:
    assert injected.laser == LASER
    assert str(injected.path) == "list.log with people"
    np.testing.assert_array_equal(injected.stamps, [scan.stamp for scan in recorded])
    np.testing.assert_array_equal(injected.T_odom_base, [scan.T_odom_base for scan in recorded])
    np.testing.assert_array_equal(injected.T_world_base, reference)


def test_the_recorded_log_is_not_changed(recorded: ListLog, reference: FloatArray) -> None:
    before, path = recorded_ranges(recorded).copy(), reference.copy()
    inject(recorded, reference, n_people=2, seed=1)
    inject_along(recorded, reference, share=0.3, seed=1)
    np.testing.assert_array_equal(recorded_ranges(recorded), before)
    np.testing.assert_array_equal(reference, path)


def test_labelled_beams_end_on_the_person_they_name(injected: SimulatedLog) -> None:
    np.testing.assert_array_equal(injected.object_id >= 0, injected.is_moving)
    assert set(np.unique(injected.object_id)) == {-1, 0, 1, 2}
    ends = np.stack([scan.points(scan.truth.T_world_base) for scan in injected])  # type: ignore[union-attr, arg-type]
    legs, person = circles(injected.objects, injected.stamps, PeopleConfig())
    for p in range(3):
        scan, beam = np.nonzero(injected.object_id == p)
        own = legs[scan][:, person == p]
        to_surface = np.abs(np.linalg.norm(ends[scan, beam, None] - own[:, :, :2], axis=2) - own[:, :, 2])
        assert np.quantile(to_surface.min(axis=1), 0.98) < 0.05


def test_people_walk_where_the_scans_saw_free_space(injected: SimulatedLog, recorded: ListLog) -> None:
    position = injected.objects[:, :, :2]
    is_here = ~np.isnan(position[:, :, 0])
    start = recorded.scans[0].truth.T_world_base  # type: ignore[union-attr]
    world = se2.transform(start, position[is_here])  # type: ignore[arg-type]
    assert is_here.mean() > 0.7
    assert wall_distance(world, ROOM).min() > 0.1
    assert ((world > [-6.0, -4.0]) & (world < [6.0, 4.5])).all()
    distance = np.linalg.norm(position - injected.T_world_base[:, None, :2], axis=2)
    assert np.nanmin(distance) > 0.4


def test_the_same_seed_gives_the_same_bits(
    injected: SimulatedLog, recorded: ListLog, reference: FloatArray
) -> None:
    again, other = (inject(recorded, reference, n_people=3, seed=seed) for seed in (5, 6))
    for key, value in injected.arrays().items():
        np.testing.assert_array_equal(value, again.arrays()[key])
    assert not np.array_equal(injected.is_moving, other.is_moving)


def test_more_people_leave_the_first_ones_alone(
    injected: SimulatedLog, recorded: ListLog, reference: FloatArray
) -> None:
    more = inject(recorded, reference, n_people=5, seed=5)
    np.testing.assert_array_equal(more.objects[:, :3], injected.objects)
    same = (injected.object_id == more.object_id) & injected.is_moving
    assert same.sum() > 0.7 * injected.is_moving.sum()
    np.testing.assert_array_equal(more.ranges[same], injected.ranges[same])


def test_nobody_injected_is_the_log_itself(recorded: ListLog, reference: FloatArray) -> None:
    log = inject(recorded, reference, n_people=0, seed=0)
    np.testing.assert_array_equal(log.ranges, recorded_ranges(recorded))
    assert not log.is_moving.any()
    assert (log.object_id == -1).all()


@pytest.mark.parametrize("share", [0.2, 0.4, 0.6])
def test_people_along_take_the_wanted_share_of_the_beams(
    recorded: ListLog, reference: FloatArray, share: float
) -> None:
    log = inject_along(recorded, reference, share=share, seed=3)
    with np.errstate(invalid="ignore"):
        n_valid = np.count_nonzero(recorded_ranges(recorded) < 0.97 * LASER.range_max)
    # as many people as it takes: more than wanted by less than one person
    assert share <= log.is_moving.sum() / n_valid < share + 0.08
    assert_only_shortened(log, recorded)
    distance = np.linalg.norm(log.objects[:, :, :2] - reference[:, None, :2], axis=2)
    assert 0.6 < distance.min() < distance.max() < 2.6


def test_the_first_scans_alone_may_be_taken(recorded: ListLog, reference: FloatArray) -> None:
    log = inject(recorded, reference, n_people=2, seed=5, max_scans=40)
    assert log.n_scans == 40
    np.testing.assert_array_equal(log.T_world_base, reference[:40])
    assert inject(recorded, reference[:40], n_people=2, seed=5, max_scans=40).n_scans == 40


def test_scans_of_another_laser_are_left_out(reference: FloatArray) -> None:
    log = drive(120, with_person=False)
    half = replace(LASER, n_beams=91, angle_increment=2 * LASER.angle_increment)
    log.scans[50:60] = [replace(scan, laser=half, ranges=scan.ranges[::2]) for scan in log.scans[50:60]]
    made = inject(log, reference, n_people=1, seed=0)
    np.testing.assert_array_equal(made.T_world_base, np.delete(reference, np.s_[50:60], axis=0))
    assert made.ranges.shape == (110, 181)


@pytest.mark.parametrize("n", [0, 119, 121])
def test_a_trajectory_of_another_length_is_refused(recorded: ListLog, n: int) -> None:
    text = f"list.log: the reference trajectory has {n} poses, the log 120 usable scans"
    calls: tuple[Callable[[FloatArray], SimulatedLog], ...] = (
        lambda T: inject(recorded, T, n_people=1, seed=0),
        lambda T: inject_along(recorded, T, share=0.2, seed=0),
    )
    for call in calls:
        with pytest.raises(InputError, match=text):
            call(np.zeros((n, 3)))
    with pytest.raises(InputError, match="has 30 poses, the log 40 usable scans"):
        inject(recorded, np.zeros((30, 3)), n_people=1, seed=0, max_scans=40)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_trajectory_that_is_not_finite_is_refused(
    recorded: ListLog, reference: FloatArray, bad: float
) -> None:
    broken = reference.copy()
    broken[60, 1] = bad
    with pytest.raises(InputError, match=r"list.log: the reference trajectory needs finite \(n, 3\) poses"):
        inject(recorded, broken, n_people=1, seed=0)
    with pytest.raises(InputError, match=r"needs finite \(n, 3\) poses"):
        inject(recorded, reference[:, :2], n_people=1, seed=0)


@pytest.mark.parametrize("share", [-0.1, 1.0, float("nan")])
def test_an_impossible_share_is_refused(recorded: ListLog, reference: FloatArray, share: float) -> None:
    with pytest.raises(ConfigError, match=rf"the share of beams must be in \[0, 1\), not {share}"):
        inject_along(recorded, reference, share=share, seed=0)


def test_fewer_than_no_people_are_refused(recorded: ListLog, reference: FloatArray) -> None:
    with pytest.raises(ConfigError, match="the number of people must not be negative, not -1"):
        inject(recorded, reference, n_people=-1, seed=0)


def test_an_injected_log_is_read_back_as_it_was_written(injected: SimulatedLog, tmp_path: Path) -> None:
    injected.write(tmp_path / "people.npz")
    scans = list(open_log(tmp_path / "people.npz"))
    np.testing.assert_array_equal([scan.ranges for scan in scans], injected.ranges)
    np.testing.assert_array_equal([scan.truth.object_id for scan in scans], injected.object_id)  # type: ignore[union-attr]
