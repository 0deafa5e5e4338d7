import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slammot_graph.core import se2
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.detection import _kernels
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.detection.visibility_check import VisibilityCheck, VisibilityCheckConfig
from slammot_graph.pipeline import Pipeline, PipelineConfig
from tests.rooms import LASER, box, take_scan

AT_REST = np.array([0.0, 0.0, 0.0])
ROOM = box(-6.0, -4.0, 6.0, 4.0)


def seen_through_twin(
    points: FloatArray,
    is_used: BoolArray,
    T_laser: FloatArray,
    angles: FloatArray,
    ranges: FloatArray,
    is_valid: BoolArray,
    margin: float,
    min_run: int,
) -> FloatArray:
    """The kernel in plain NumPy: nearest beam by angle, both its neighbours, runs among the used points."""
    local = se2.transform(se2.inverse(T_laser), points)
    step = angles[1] - angles[0]
    m = np.rint(np.mod(np.arctan2(local[:, 1], local[:, 0]) - angles[0], np.sign(step) * 2 * np.pi) / step)
    m = m.astype(int)
    inside = (m >= 1) & (m < len(angles) - 1)
    around = np.clip(m, 1, len(angles) - 2)[:, None] + [-1, 0, 1]
    past = np.hypot(*local.T)[:, None] + margin
    passes = inside & (is_valid[around] & (ranges[around] > past)).all(axis=1)
    used = np.flatnonzero(is_used)
    out = np.zeros(len(points), dtype=bool)
    run: list[int] = []
    for k in [*used, -1]:
        if k >= 0 and passes[k]:
            run.append(k)
            continue
        if len(run) >= min_run:
            out[run] = True
        run = []
    return points[out]


@settings(deadline=None, max_examples=100)
@given(st.integers(0, 2**32 - 1), st.sampled_from([-1.0, 1.0]), st.sampled_from([4.0, 6.2]), st.booleans())
def test_the_kernel_equals_its_twin(seed: int, sense: float, field_rad: float, is_smooth: bool) -> None:
    rng = np.random.default_rng(seed)
    n, n_beams = 40, 61
    angles = sense * (-2.0 + np.linspace(0.0, field_rad, n_beams))
    if is_smooth:  # as one scan sees another: each point near the beam of its own number
        about = np.linspace(angles[0] - 0.2 * sense, angles[-1] + 0.2 * sense, n) + rng.normal(0.0, 0.02, n)
        points = rng.uniform(1.0, 6.0, n)[:, None] * np.column_stack([np.cos(about), np.sin(about)])
        T_base, T_base_laser = rng.normal(0.0, 0.1, (2, 3))
    else:
        points = np.cumsum(rng.normal(0.0, 0.4, (n, 2)), axis=0) + rng.normal(0.0, 2.0, 2)
        T_base, T_base_laser = rng.normal(0.0, 1.0, (2, 3))
    ranges, is_valid, is_used = (
        rng.uniform(0.5, 8.0, n_beams),
        rng.random(n_beams) > 0.05,
        rng.random(n) > 0.1,
    )
    in_base = angles + T_base_laser[2]
    for min_run in (1, 3):
        out = np.empty((n, 2))
        n_gone = _kernels.seen_through(
            points,
            is_used,
            T_base,
            T_base_laser[None, :2].copy(),
            np.column_stack([np.cos(in_base), np.sin(in_base)]),
            in_base[0],
            angles[1] - angles[0],
            ranges,
            is_valid,
            0.1,
            min_run,
            out,
        )
        T_laser = se2.compose(T_base, T_base_laser)
        twin = seen_through_twin(points, is_used, T_laser, angles, ranges, is_valid, 0.1, min_run)
        np.testing.assert_array_equal(out[:n_gone], twin)


@pytest.mark.parametrize("sense", [-1.0, 1.0])
def test_the_beam_of_a_sweep_is_found_from_where_it_starts(rng: np.random.Generator, sense: float) -> None:
    """The robot turns by 0.4 rad and drives 0.2 m meanwhile: a point on a beam's line is seen by that beam."""
    n = 180
    share = np.arange(n) / (n - 1)
    in_laser = sense * (-1.5 + 3.0 * share)
    turned = in_laser + 0.4 * share
    directions = np.column_stack([np.cos(turned), np.sin(turned)])
    origins = np.outer(share, [0.2, 0.05])
    reach = rng.uniform(1.0, 4.0, n)
    points, ranges = origins + reach[:, None] * directions, np.full(n, 10.0)
    out = np.empty((n, 2))
    for k in range(5, n - 5, 9):
        is_valid = np.zeros(n, dtype=bool)
        is_valid[k - 1 : k + 2] = True  # any other beam sees nothing
        n_gone = _kernels.seen_through(
            points,
            np.arange(n) == k,
            np.zeros(3),
            origins,
            directions,
            float(in_laser[0]),
            float(in_laser[1] - in_laser[0]),
            ranges,
            is_valid,
            0.1,
            1,
            out,
        )
        assert n_gone == 1
        np.testing.assert_array_equal(out[0], points[k])


def vacated(before: list[list[float]], after: list[list[float]], seconds: float = 2.0) -> FloatArray:
    """Places that are empty after `seconds`, with discs (x, y, radius) before and after."""
    memory = VisibilityCheck(VisibilityCheckConfig())
    first = take_scan(AT_REST, walls=ROOM, discs=before)
    memory.remember(first.stamp, AT_REST, first.points(AT_REST), first.is_valid())
    later = take_scan(AT_REST, index=1, walls=ROOM, discs=after)
    object.__setattr__(later, "stamp", first.stamp + seconds)
    return memory.vacated(later, AT_REST, later.is_valid())


def test_where_somebody_stood_is_empty_when_he_has_gone_on() -> None:
    places = vacated([[2.0, 0.0, 0.25]], [[2.6, 0.0, 0.25]])
    assert len(places) >= 3
    assert (np.hypot(*(places - [2.0, 0.0]).T) < 0.3).all()


def test_who_stays_or_comes_nearer_leaves_no_empty_place() -> None:
    assert len(vacated([[2.0, 0.0, 0.25]], [[2.0, 0.0, 0.25]])) == 0
    assert len(vacated([[2.6, 0.0, 0.25]], [[2.0, 0.0, 0.25]])) == 0
    assert len(vacated([], [[2.0, 0.0, 0.25]])) == 0


def test_a_scan_of_just_now_is_not_compared() -> None:
    assert len(vacated([[2.0, 0.0, 0.25]], [[2.6, 0.0, 0.25]], seconds=0.5)) == 0


def company_recall(config: PipelineConfig) -> float:
    """Share of the beams called moving on a person who always walks 1.5 m ahead of the robot, in the last half."""
    rng, pipeline, found, seen = np.random.default_rng(0), Pipeline(config), 0, 0
    for k in range(60):
        T = np.array([-5.0 + 0.1 * k, 0.3, 0.0])
        scan = take_scan(
            T,
            index=k,
            walls=box(-7.0, -2.0, 9.0, 2.0),
            discs=[[T[0] + 1.5, 0.3, 0.25]],
            noise=rng.normal(0.0, 0.008, LASER.n_beams),
        )
        step = pipeline.step(scan)
        if k >= 30:
            assert scan.truth is not None and scan.truth.is_moving is not None
            seen += int(scan.truth.is_moving.sum())
            found += int((step.is_moving & scan.truth.is_moving).sum())
    pipeline.close()
    return found / seen


def test_who_walks_ahead_of_the_robot_from_the_start_is_found() -> None:
    with_it = company_recall(PipelineConfig())
    without = company_recall(PipelineConfig(detector=EllipseDetectorConfig(visibility_check=None)))
    assert with_it > 0.8
    assert with_it > without + 0.3


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"reach_m": 0.0}, "VisibilityCheckConfig.reach_m must be positive, not 0.0"),
        ({"margin_m": -1.0}, "VisibilityCheckConfig.margin_m must not be negative, not -1.0"),
        ({"distance_m": 0.0}, "VisibilityCheckConfig.distance_m must be positive, not 0.0"),
        ({"min_run": 0}, "VisibilityCheckConfig.min_run must be at least 1, not 0"),
    ],
)
def test_an_impossible_afterimage_is_refused(changes: dict[str, float], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        VisibilityCheckConfig(**changes)  # type: ignore[arg-type]
