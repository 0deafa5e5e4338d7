import numpy as np
import pytest

from slammot_graph.core.errors import ConfigError
from slammot_graph.odometry.previous_motion import MAX_STEP_S, PreviousMotion, PreviousMotionConfig

STD = np.array([0.003, 0.003, 0.001])
STEP_S = 0.1


def test_nothing_is_known_at_first() -> None:
    config = PreviousMotionConfig(first_std_m_per_s=0.4, first_std_rad_per_s=0.8)
    motion = PreviousMotion(config).motion(STEP_S)
    assert not motion.increment.any()
    np.testing.assert_allclose(motion.cov, np.diag([0.04, 0.04, 0.08]) ** 2)


def test_the_robot_goes_on_as_it_went_in_proportion_to_the_time() -> None:
    previous, increment = PreviousMotion(PreviousMotionConfig()), np.array([0.05, 0.01, -0.02])
    previous.learn(increment, np.diag(STD**2), STEP_S)
    np.testing.assert_allclose(previous.motion(STEP_S).increment, increment)
    np.testing.assert_allclose(previous.motion(3.0 * STEP_S).increment, 3.0 * increment)
    np.testing.assert_allclose(previous.motion(60.0).increment, MAX_STEP_S / STEP_S * increment)


@pytest.mark.parametrize("change_std", [0.1, 0.3])
def test_how_far_velocities_change_is_learnt(change_std: float) -> None:
    rng, previous = np.random.default_rng(0), PreviousMotion(PreviousMotionConfig())
    velocity, stds = np.zeros(3), list[np.ndarray]()
    for _ in range(600):
        velocity = velocity + rng.normal(0.0, change_std, 3)
        previous.learn(STEP_S * velocity, np.zeros((3, 3)), STEP_S)
        stds.append(previous.std)
    np.testing.assert_allclose(np.mean(stds[200:], axis=0), change_std, rtol=0.1)


def test_the_error_of_the_matches_is_not_taken_for_change() -> None:
    rng, config = np.random.default_rng(1), PreviousMotionConfig()
    previous, std, stds = PreviousMotion(config), np.array([0.01, 0.01, 0.01]), list[np.ndarray]()
    for _ in range(600):
        # an increment is between two matches, and a change between two increments
        previous.learn(rng.normal(0.0, std / np.sqrt(2.0)), np.diag(std**2), STEP_S)
        stds.append(previous.std)
    assert (np.mean(stds[200:], axis=0) < 0.5 * std / STEP_S).all()
    assert (np.array(stds) >= config.least_std_m_per_s).all()


def test_one_wrong_match_counts_for_little() -> None:
    previous, change = PreviousMotion(PreviousMotionConfig()), np.array([0.0, 0.0, 0.0])
    for k in range(200):
        change[0] = 0.01 * (-1) ** k
        previous.learn(change, np.diag(STD**2), STEP_S)
    usual = previous.std[0]
    previous.learn(np.array([5.0, 0.0, 0.0]), np.diag(STD**2), STEP_S)
    assert previous.std[0] < 1.5 * usual


def test_scans_without_a_match_make_it_less_certain_until_the_next_one() -> None:
    previous = PreviousMotion(PreviousMotionConfig())
    previous.learn(np.array([0.05, 0.0, 0.0]), np.diag(STD**2), STEP_S)
    before = previous.motion(STEP_S)
    for n in (1, 2, 3):
        previous.miss()
        after = previous.motion(STEP_S)
        np.testing.assert_array_equal(after.increment, before.increment)
        np.testing.assert_allclose(after.cov, (1 + n) ** 2 * before.cov)
    std = previous.std
    previous.learn(
        np.array([0.3, 0.0, 0.0]), np.diag(STD**2), STEP_S
    )  # a change over several scans tells nothing of one
    np.testing.assert_array_equal(previous.std, std)
    np.testing.assert_allclose(previous.motion(STEP_S).cov, before.cov)


@pytest.mark.parametrize("name", ["first_std_m_per_s", "least_std_rad_per_s", "gain"])
def test_impossible_settings_are_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"PreviousMotionConfig.{name} must be"):
        PreviousMotionConfig(**{name: 0.0})
