"""What never moves is not moving: things put down, doors, legs of chairs; and who came and stands."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from slammot_graph.core.results import GridMap, StepResult
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.detection.ellipse_detector import EllipseDetectorConfig
from slammot_graph.pipeline import Pipeline, PipelineConfig
from tests.rooms import LASER, box, is_person, take_scan

ROOM = box(-4.0, -3.0, 6.0, 3.5)
CRATE = box(2.0, -0.3, 2.6, 0.3)
WALL_WITH_DOOR = np.array([[2.5, -3.0, 2.5, -0.5], [2.5, 0.5, 2.5, 3.5]])
DOOR = np.array([[2.5, -0.5, 2.5, 0.5]])


def watch(
    n: int,
    walls_at: Callable[[int], FloatArray],
    discs_at: Callable[[int], Sequence[Sequence[float]]] = lambda _: (),
    place_at: Callable[[int], FloatArray] = lambda _: np.zeros(3),
    config: PipelineConfig | None = None,
) -> tuple[list[StepResult], list[BoolArray], GridMap]:
    """Steps, final labels and map of a robot in a room that changes."""
    rng, steps = np.random.default_rng(0), []
    with Pipeline(config or PipelineConfig()) as pipeline:
        for k in range(n):
            noise = rng.normal(0.0, 0.008, LASER.n_beams)
            scan = take_scan(place_at(k), index=k, walls=walls_at(k), discs=discs_at(k), noise=noise)
            steps.append(pipeline.step(scan))
        T_map_base = pipeline.final().T_map_base
        labels = pipeline.final_labels(T_map_base)
        assert labels is not None
        return steps, labels, pipeline.render_map(T_map_base, labels)


def n_occupied(grid: GridMap, low: tuple[float, float], high: tuple[float, float]) -> int:
    (j0, i0), (j1, i1) = (np.floor((np.array(at) - grid.origin) / grid.resolution_m) for at in (low, high))
    with np.errstate(invalid="ignore"):
        return int((grid.p_occupied[int(i0) : int(i1) + 1, int(j0) : int(j1) + 1] > 0.6).sum())


def carrier(k: int) -> list[list[float]]:
    """Somebody who brings the crate and goes."""
    if 30 <= k < 50:
        return [[2.0, 3.2 - 0.14 * (k - 30), 0.25]]
    return [[1.9, 0.5 + 0.12 * (k - 50), 0.25]] if 50 <= k < 72 else []


def nobody(k: int) -> list[list[float]]:
    """Nobody."""
    return []


def test_a_box_put_down_before_a_standing_robot_is_in_the_map() -> None:
    for discs_at in (nobody, carrier):
        steps, labels, grid = watch(450, lambda k: ROOM if k < 50 else np.vstack([ROOM, CRATE]), discs_at)
        assert n_occupied(grid, (1.85, -0.4), (2.1, 0.4)) >= 8
        assert steps[52].is_moving.any()  # it has come
        assert not labels[200].any()


def test_a_door_that_opens_and_closes_is_in_the_map() -> None:
    def walls(k: int) -> FloatArray:
        return np.vstack([ROOM, WALL_WITH_DOOR, *([] if 60 <= k < 160 else [DOOR])])

    _, labels, grid = watch(450, walls)
    assert n_occupied(grid, (2.4, -0.5), (2.6, 0.5)) >= 8
    assert not any(label.any() for label in labels[::10])


LEGS = np.vstack(
    [box(x, y, x + 0.03, y + 0.03) for x in (3.5, 4.0, 4.5, 5.0) for y in (-2.0, -1.5, 0.5, 1.5, 2.5)]
)


def there_and_back(k: int) -> FloatArray:
    """A robot that drives to and fro within the room, looking about."""
    return np.array([-2.2 + 1.5 * np.sin(0.02 * k), 0.3 * np.sin(0.033 * k), 0.25 * np.sin(0.05 * k)])


def test_legs_of_chairs_seen_now_and_then_from_afar_do_not_move() -> None:
    def n_moving(config: PipelineConfig) -> tuple[int, int]:
        steps, labels, _ = watch(
            600, lambda k: np.vstack([ROOM, LEGS]), place_at=there_and_back, config=config
        )
        return sum(int(s.is_moving.sum()) for s in steps), sum(int(label.sum()) for label in labels)

    with_memory = n_moving(PipelineConfig())
    without = n_moving(PipelineConfig(detector=replace(EllipseDetectorConfig(), hit_memory=None)))
    assert without[0] > 100
    assert with_memory[0] <= 0.5 * without[0]
    assert with_memory[1] <= 0.2 * without[1]


def test_who_comes_and_stands_for_a_while_moves() -> None:
    def person(k: int) -> list[list[float]]:
        return [[2.0, 2.8 - 0.1 * min(max(k - 40, 0), 25), 0.25]] if 40 <= k < 110 else []

    steps, labels, _ = watch(150, lambda k: ROOM, person)
    for k in (70, 90, 105):
        truth = is_person(steps[k].scan)
        assert truth.sum() > 5
        assert (steps[k].is_moving & truth).sum() > 0.8 * truth.sum()
        assert (labels[k] & truth).sum() > 0.8 * truth.sum()
