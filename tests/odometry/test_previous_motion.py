import numpy as np
import pytest

from slammot_graph.core.errors import ConfigError
from slammot_graph.odometry.history import ScanClock
from slammot_graph.odometry.previous_motion import MAX_STEP_S, PreviousMotion, PreviousMotionConfig

STD = np.array([0.003, 0.003, 0.001])
STEP_S = 0.1


def clock_after(step_s: float = STEP_S, usual_s: float = STEP_S) -> ScanClock:
    """A clock whose latest step is given."""
    clock = ScanClock()
    for k in range(4):
        clock.advance(k * usual_s)
    clock.advance(3 * usual_s + step_s)
    return clock


CLOCK = clock_after()


def test_nothing_is_known_at_first() -> None:
    config = PreviousMotionConfig(first_std_m_per_s=0.4, first_std_rad_per_s=0.8)
    motion = PreviousMotion(config).motion(CLOCK)
    assert not motion.increment.any()
    np.testing.assert_allclose(motion.cov, 2.0 * np.diag([0.04, 0.04, 0.08]) ** 2)


def test_the_robot_goes_on_as_it_went_in_proportion_to_the_time() -> None:
    previous, increment = PreviousMotion(PreviousMotionConfig()), np.array([0.05, 0.01, -0.02])
    for _ in range(3):
        previous.learn(increment, np.diag((0.01 * STD) ** 2), CLOCK)
    np.testing.assert_allclose(previous.motion(CLOCK).increment, increment, rtol=1e-3)
    np.testing.assert_allclose(previous.motion(clock_after(0.2)).increment, 2.0 * increment, rtol=1e-3)
    longest = MAX_STEP_S / STEP_S * increment
    np.testing.assert_allclose(previous.motion(clock_after(1.8)).increment, longest, rtol=1e-3)


def test_over_a_gap_the_robot_may_have_stopped() -> None:
    previous, increment = PreviousMotion(PreviousMotionConfig()), np.array([0.0, 0.0, -0.1])
    for _ in range(400):
        previous.learn(increment, np.diag(STD**2), CLOCK)
    motion = previous.motion(clock_after(1.0))
    assert motion.cov[2, 2] > (8.0 * increment[2]) ** 2
    assert previous.motion(CLOCK).cov[2, 2] < increment[2] ** 2


@pytest.mark.parametrize("change_std", [0.1, 0.3])
def test_how_far_velocities_change_is_learnt(change_std: float) -> None:
    rng, previous = np.random.default_rng(0), PreviousMotion(PreviousMotionConfig())
    velocity, stds = np.zeros(3), list[np.ndarray]()
    for _ in range(600):
        velocity = velocity + rng.normal(0.0, change_std, 3)
        previous.learn(STEP_S * velocity, 1e-10 * np.eye(3), CLOCK)
        stds.append(previous.std)
    np.testing.assert_allclose(np.mean(stds[200:], axis=0), change_std, rtol=0.15)


def test_the_error_of_the_matches_is_not_taken_for_change() -> None:
    rng, config = np.random.default_rng(1), PreviousMotionConfig()
    previous, std, stds = PreviousMotion(config), np.array([0.01, 0.01, 0.01]), list[np.ndarray]()
    for _ in range(600):
        previous.learn(rng.normal(0.0, std), np.diag(std**2), CLOCK)
        stds.append(previous.std)
    assert (np.mean(stds[200:], axis=0) < 0.7 * np.sqrt(2.0) * std / STEP_S).all()
    assert (np.array(stds) >= config.least_std_m_per_s).all()


def test_one_wrong_match_counts_for_little() -> None:
    previous, change = PreviousMotion(PreviousMotionConfig(gain=0.03)), np.array([0.0, 0.0, 0.0])
    for k in range(200):
        change[0] = 0.01 * (-1) ** k
        previous.learn(change, np.diag(STD**2), CLOCK)
    usual = previous.std[0]
    previous.learn(np.array([5.0, 0.0, 0.0]), np.diag(STD**2), CLOCK)
    assert previous.std[0] < 1.5 * usual


def test_the_way_is_as_uncertain_as_one_velocity_where_nothing_corrects_it() -> None:
    """Monte Carlo: down a corridor the true velocity goes on to change, and no match tells of it."""
    rng, config = (
        np.random.default_rng(2),
        PreviousMotionConfig(first_std_m_per_s=0.05, least_std_m_per_s=0.05),
    )
    nothing, n_steps, n_runs, ends = np.diag([1e6, 1e6, 1e6]), 30, 300, list[float]()
    for _ in range(n_runs):
        previous, velocity, way = PreviousMotion(config), rng.normal(0.0, 0.05), 0.0
        variance = 0.0
        for _ in range(n_steps):
            velocity += rng.normal(0.0, 0.05)
            way += STEP_S * velocity
            variance += previous.motion(CLOCK).cov[0, 0]
            previous.learn(np.zeros(3), nothing, CLOCK)
        ends.append(way / np.sqrt(variance))
    np.testing.assert_allclose(np.std(ends), 1.0, rtol=0.1)


@pytest.mark.parametrize("is_stamped_elsewhere", [False, True])
def test_steps_count_as_equal_where_the_stamps_tell_less(is_stamped_elsewhere: bool) -> None:
    rng, previous, clock, now = (
        np.random.default_rng(3),
        PreviousMotion(PreviousMotionConfig()),
        ScanClock(),
        0.0,
    )
    clock.advance(now)
    for _ in range(200):
        step_s = rng.uniform(0.5, 1.5) * STEP_S
        now += step_s
        clock.advance(now)
        true_s = STEP_S if is_stamped_elsewhere else step_s
        increment = np.array([0.5 * true_s, 0.0, 0.0])
        previous.learn(increment, np.diag(STD**2), clock)
    assert previous.is_by_count == is_stamped_elsewhere
    np.testing.assert_allclose(previous.motion(clock).increment[0], increment[0], rtol=0.1)


def test_scans_without_a_match_make_it_less_certain_until_the_next_one() -> None:
    previous = PreviousMotion(PreviousMotionConfig())
    previous.learn(np.array([0.05, 0.0, 0.0]), np.diag(STD**2), CLOCK)
    before = previous.motion(CLOCK)
    for n in (1, 2, 3):
        previous.miss()
        after = previous.motion(CLOCK)
        np.testing.assert_array_equal(after.increment, before.increment)
        assert after.cov[0, 0] > n**2 * before.cov[0, 0]
    std = previous.std
    previous.learn(np.array([0.3, 0.0, 0.0]), np.diag(STD**2), CLOCK)
    np.testing.assert_array_equal(previous.std, std)  # a change over several scans tells nothing of one


@pytest.mark.parametrize("name", ["first_std_m_per_s", "least_std_rad_per_s", "gain"])
def test_impossible_settings_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"PreviousMotionConfig.{name} must be"):
        PreviousMotionConfig(**{name: 0.0})
