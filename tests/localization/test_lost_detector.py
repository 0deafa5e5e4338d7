import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.core.match_result import MatchResult
from slammot_graph.localization.lost_detector import Loss, LostDetector
from tests.localization.matches import CONTRADICTING, FAILED, MATCH

N_LOST, KIDNAPPED_M = 3, 0.2
HERE = np.array([5.0, 1.0, 0.3])


def update(
    detector: LostDetector, match: MatchResult | None, x_m: float = 0.0, *, sees: bool = True
) -> Loss | None:
    """One scan `x_m` along."""
    place = HERE + np.array([x_m, 0.0, 0.0])
    return detector.update(match, place, has_points=sees, has_local_map=match is not None)


@pytest.fixture
def detector() -> LostDetector:
    return LostDetector(N_LOST, KIDNAPPED_M)


def test_matches_that_fail_in_a_row(detector: LostDetector) -> None:
    assert [update(detector, FAILED) for _ in range(2)] == [None, None]
    assert update(detector, MATCH) is None
    assert [update(detector, FAILED) for _ in range(2)] == [None, None]
    assert update(detector, FAILED) == Loss(cause="failed matches", n_scans=N_LOST)
    assert detector.n_failed == 0  # a new local map gets a new chance
    assert update(detector, FAILED) is None


def test_what_only_contradicts_the_odometry_is_no_loss_and_neither_is_an_occluded_laser(
    detector: LostDetector,
) -> None:
    assert all(update(detector, CONTRADICTING) is None for _ in range(20))
    assert all(update(detector, FAILED, 0.5 * k, sees=False) is None for k in range(20))
    assert (detector.n_failed, detector.n_blind) == (0, 20)


@pytest.mark.parametrize(
    ("x_m", "match", "is_lost"),
    [
        (0.0, MATCH, True),
        (0.19, MATCH, True),
        (0.21, MATCH, False),
        (5.0, MATCH, False),
        (5.0, FAILED, True),
        (0.0, None, False),  # there is no local map to have been kidnapped from
    ],
)
def test_who_saw_nothing_may_have_been_kidnapped(
    detector: LostDetector, x_m: float, match: MatchResult | None, is_lost: bool
) -> None:
    update(detector, MATCH)
    for _ in range(N_LOST + 1):
        assert update(detector, FAILED, x_m, sees=False) is None
    loss = update(detector, match, x_m)
    assert loss == (Loss(cause="kidnapped", n_scans=N_LOST + 1) if is_lost else None)
    assert detector.n_blind == 0
    assert update(detector, MATCH, x_m) is None


def test_a_short_occlusion_is_none(detector: LostDetector) -> None:
    update(detector, MATCH)
    for _ in range(N_LOST - 1):
        update(detector, FAILED, sees=False)
    assert update(detector, MATCH) is None


@given(st.lists(st.sampled_from(["ok", "failed", "contradicting", "blind"]), max_size=60))
def test_losses_follow_from_the_counts(outcomes: list[str]) -> None:
    detector, n_failed, n_blind = LostDetector(N_LOST, KIDNAPPED_M), 0, 0
    update(detector, MATCH)
    for outcome in outcomes:
        sees = outcome != "blind"
        match = {"ok": MATCH, "failed": FAILED, "contradicting": CONTRADICTING, "blind": FAILED}[outcome]
        loss = update(detector, match, sees=sees)
        n_failed = 0 if outcome in ("ok", "contradicting") else n_failed + (outcome == "failed")
        expected = None
        if sees and n_blind >= N_LOST:
            expected = Loss(cause="kidnapped", n_scans=n_blind)
        elif n_failed >= N_LOST:
            expected = Loss(cause="failed matches", n_scans=N_LOST)
        assert loss == expected
        n_failed = 0 if loss else n_failed
        n_blind = 0 if sees else n_blind + 1
        assert (detector.n_failed, detector.n_blind) == (n_failed, n_blind)


def test_wheels_tell_of_a_drive_with_nothing_in_sight(detector: LostDetector) -> None:
    update(detector, MATCH)
    for _ in range(N_LOST + 1):
        assert update(detector, FAILED, 5.0, sees=False) is None
    place = HERE + np.array([5.0, 0.0, 0.0])
    loss = detector.update(FAILED, place, has_points=True, has_local_map=True, has_odometry=True)
    assert loss == Loss(cause="blind drive", n_scans=N_LOST + 1)


def test_a_match_that_fails_where_nothing_was_known_of_the_motion_is_a_loss_at_once(
    detector: LostDetector,
) -> None:
    words = {"has_points": True, "has_local_map": True, "is_adrift": True}
    assert detector.update(MATCH, HERE, **words) is None
    assert detector.update(FAILED, HERE, **words) == Loss(cause="gap", n_scans=1)


def failing(
    detector: LostDetector, step_m: float, standing_out: tuple[bool, ...], *, has_odometry: bool = False
) -> list[Loss | None]:
    """What is told of matches that fail one after the other, on a drive."""
    update(detector, MATCH)
    return [
        detector.update(
            FAILED,
            HERE + np.array([step_m * (k + 1), 0.0, 0.0]),
            has_points=True,
            has_local_map=True,
            has_odometry=has_odometry,
            stands_out=stands,
        )
        for k, stands in enumerate(standing_out)
    ]


@pytest.mark.parametrize(
    ("step_m", "standing_out", "cause"),
    [
        (0.1, (True, True, True), "changing view"),
        (0.1, (True, False, True), "changing view"),
        (0.1, (True, False, False), "failed matches"),
        (0.0, (True, True, True), "failed matches"),
    ],
)
def test_where_the_prediction_stands_out_on_a_drive_only_the_view_has_changed(
    detector: LostDetector, step_m: float, standing_out: tuple[bool, ...], cause: str
) -> None:
    losses = failing(detector, step_m, standing_out)
    assert losses[:-1] == [None, None]
    assert losses[-1] is not None
    assert (losses[-1].cause, losses[-1].is_known) == (cause, cause == "changing view")


@pytest.mark.parametrize(("has_odometry", "cause"), [(True, "changing view"), (False, "failed matches")])
def test_with_odometry_the_prediction_need_stand_out_most_times_only(has_odometry: bool, cause: str) -> None:
    standing_out = (True, False, True, False, True)
    losses = failing(LostDetector(5, 0.2), 0.1, standing_out, has_odometry=has_odometry)
    assert losses[:-1] == [None] * 4
    assert losses[-1] is not None
    assert losses[-1].cause == cause
