"""The cells of the test are shown as it saw them, at scans with moving points, within their share of the file."""

import copy
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from slammot_graph import Run
from slammot_graph.core import se2
from slammot_graph.core.results import GridMap, StepResult
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.detection.ellipse_detector import LocalGridConfig
from slammot_graph.mapping.occupancy_grid import OccupancyGrid
from slammot_graph.observer import TestGrid
from slammot_graph.pipeline import Pipeline
from slammot_graph.viz.rerun import cells
from slammot_graph.viz.rerun.cells import COLOR_CELLS
from slammot_graph.viz.rerun.run import RerunRecording
from tests.rooms import drive
from tests.viz.rerun.recordings import begin, entries, rows

MARGIN_M = 2.0
"""How far around moving points cells are shown: up to the walls."""


@dataclass
class People:
    """A recorded run with a person, and for some scans with moving points the test's grid before and after them."""

    path: Path
    steps: list[StepResult] = field(default_factory=list)
    grids: dict[int, tuple[OccupancyGrid, OccupancyGrid, FloatArray]] = field(default_factory=dict)


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory, strict: None) -> People:
    """Recorded as the command does it."""
    people = People(tmp_path_factory.mktemp("people") / "run.rrd")
    run = Run(drive(230), observers=[RerunRecording(path=people.path)])
    before: OccupancyGrid | None = None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cells, "CELLS_MARGIN_M", MARGIN_M)
        for step in run:
            assert isinstance(run.pipeline, Pipeline)
            people.steps.append(step)
            after = copy.deepcopy(run.pipeline.detector.grid)
            assert after is not None
            if step.is_moving.any() and step.scan.index % 7 == 0 and before is not None:
                people.grids[step.scan.index] = before, after, run.pipeline.localizer.T_map_local
            before = after
    return people


@dataclass
class Picture:
    """Cells as they are recorded: states (rows, cols), row 0 the lowest; pose of the lower left corner in the map."""

    state: IntArray
    T_map_corner: FloatArray
    size_m: float

    def centres_map(self) -> FloatArray:
        """(rows * cols, 2) [m]."""
        rows, cols = np.indices(self.state.shape)
        xy = self.size_m * (np.column_stack([cols.ravel(), rows.ravel()]).astype(np.float64) + 0.5)
        return se2.transform(self.T_map_corner, xy)

    def at(self, points_map: FloatArray) -> IntArray:
        """(n,) states at points (n, 2) of the map; -1 outside."""
        cells = np.floor(se2.transform(se2.inverse(self.T_map_corner), points_map) / self.size_m).astype(int)
        is_inside = ((cells >= 0) & (cells < self.state.shape[::-1])).all(axis=1)
        i, j = np.where(is_inside, cells[:, ::-1].T, 0)
        return np.where(is_inside, self.state[i, j], -1)


def pictures(path: Path) -> dict[int, Picture | None]:
    """Read back the cells at each scan that has an entry, None where it says that there are none."""
    names = ("data", "format", "cell_size", "translation", "quaternion")
    columns = [entries(path, "/world/cells", f"GridMap:{name}") for name in names]
    found: dict[int, Picture | None] = dict.fromkeys(columns[0])
    light = np.array([[color >> shift & 0xFF for shift in (24, 16, 8)] for color in COLOR_CELLS])
    for scan in found:
        values = [column[scan] for column in columns]
        if not values[0]:
            assert not any(values)
            continue
        (data,), (form,), (size_m,), (place,), (quaternion,) = values
        rgb = np.array(list(data), dtype=int).reshape(form["height"], form["width"], 3)[::-1]
        apart = np.abs(rgb[..., None, :] - light).max(axis=-1)
        state = apart.argmin(axis=-1)
        np.testing.assert_array_less(apart.min(axis=-1), 16)
        yaw = 2.0 * np.arctan2(quaternion[2], quaternion[3])
        found[scan] = Picture(state, np.array([*place[:2], yaw]), size_m)
    return found


def states_of(p_occupied: FloatArray) -> IntArray:
    """States of cells: 0 unknown, 1 free, 2 occupied."""
    config = LocalGridConfig()
    with np.errstate(invalid="ignore"):
        return np.where(p_occupied < config.p_free, 1, np.where(p_occupied > config.p_occupied, 2, 0))


def test_the_cells_are_those_that_the_test_saw(people: People) -> None:
    shown = pictures(people.path)
    assert len(people.grids) >= 8
    seen, n_changed = set(), 0
    for scan, (before, after, T_map_local) in people.grids.items():
        picture = shown[scan]
        assert picture is not None
        assert picture.size_m == pytest.approx(before.config.resolution_m)
        centres = se2.transform(se2.inverse(T_map_local), picture.centres_map())
        expected = states_of(before.probability(centres)).reshape(picture.state.shape)
        np.testing.assert_array_equal(picture.state, expected)
        n_changed += (picture.state.ravel() != states_of(after.probability(centres))).sum()
        seen |= set(expected.ravel().tolist())
        # so far around the moving points
        step = people.steps[scan]
        points = step.scan.points(se2.between(T_map_local, step.T_map_base))[step.is_moving]
        extent = np.ptp(points, axis=0) + 2.0 * MARGIN_M
        n_cells = np.array(picture.state.shape[::-1])
        assert (n_cells * 0.1 >= extent - 1e-6).all()
        assert (n_cells * 0.1 <= extent + 0.2).all()
        assert entries(people.path, "/world/cells", "after_scan")[scan] == [scan - 1]
    assert seen == {0, 1, 2}
    assert n_changed  # what the scan itself did to them is not in the picture


def test_the_cells_explain_why_a_point_moves(people: People) -> None:
    from slammot_graph.detection.reasons import FREE

    shown = pictures(people.path)
    n_points = 0
    for step in people.steps:
        is_free = step.is_moving & (step.reason == FREE)
        if is_free.any():
            picture = shown[step.scan.index]
            assert picture is not None
            assert (picture.at(step.scan.points(step.T_map_base)[is_free]) == 1).all()
            n_points += is_free.sum()
    assert n_points > 200


def test_cells_are_shown_at_scans_with_moving_points_only(people: People) -> None:
    shown, now = pictures(people.path), None
    has_moving = [step.is_moving.any() for step in people.steps]
    assert 50 < sum(has_moving) < len(has_moving) - 10
    for scan, is_any in enumerate(has_moving):
        now = shown.get(scan, now)
        assert (now is not None) == is_any


def test_a_moving_point_of_a_run_tells_its_probability_and_its_reason(people: People) -> None:
    from slammot_graph.detection.reasons import REASONS

    for entity, drawn in (
        ("/world/robot/scan", "Points3D:positions"),
        ("/world/ellipses/moving", "Ellipsoids3D:centers"),
    ):
        told = {name: entries(people.path, entity, name) for name in ("beam", "p_moving", "reason", drawn)}
        for step in people.steps:
            k, beams = step.scan.index, np.flatnonzero(step.is_moving)
            of_scan = {name: values.get(k, []) for name, values in told.items()}
            assert len({len(values) for values in of_scan.values()}) == 1
            rows = [of_scan["beam"].index(beam) for beam in beams]
            p_moving = np.array(of_scan["p_moving"])[rows]
            np.testing.assert_allclose(p_moving, step.p_moving[beams], atol=6e-4)
            assert [of_scan["reason"][row] for row in rows] == [REASONS[code] for code in step.reason[beams]]


def test_cells_lie_where_the_local_frame_does(tmp_path: Path, rng: np.random.Generator) -> None:
    """After a closure it is turned in the map; and the window ends beside the moving points."""
    steps = list(Run(drive(30)))[-2:]
    T_map_local = np.array([3.0, -1.0, 0.7])
    points = steps[1].scan.points(steps[1].T_map_base)
    origin = np.floor(10.0 * points[20]) / 10.0 - 0.4
    p_occupied = rng.choice([np.nan, 0.05, 0.5, 0.95], (60, 60))
    around = GridMap(p_occupied=p_occupied, resolution_m=0.1, origin=origin)
    log = begin(tmp_path / "run.rrd")
    for step, kept, T in zip(
        steps, (around, replace(around, origin=np.zeros(2))), (np.zeros(3), T_map_local), strict=True
    ):
        grid = TestGrid(cells=kept, T_map_local=T, p_free=0.12, p_occupied=0.8)
        is_moving = np.arange(len(points)) == 20
        log.log_step(replace(step, T_map_base=se2.compose(T, step.T_map_base), is_moving=is_moving), grid)
    log.close()
    shown = pictures(tmp_path / "run.rrd")
    picture = shown[steps[1].scan.index]
    assert picture is not None
    assert shown[steps[0].scan.index] is None  # nothing is known of the scan before
    assert max(picture.state.shape) <= 16
    points_local = origin + rng.uniform(-0.5, 2.0, (500, 2))
    state = picture.at(se2.transform(T_map_local, points_local))
    is_inside = state >= 0
    assert 50 < is_inside.sum() < 450
    assert (points_local[is_inside] > origin - 1e-5).all()
    cell = np.floor((points_local[is_inside] - origin) / 0.1).astype(int)
    np.testing.assert_array_equal(state[is_inside], states_of(p_occupied)[cell[:, 1], cell[:, 0]])


def test_cells_stay_within_their_share_of_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cells, "CELLS_HEAD_START", 0)
    monkeypatch.setattr(cells, "CELLS_SHARE", 0.0)
    log = RerunRecording(path=tmp_path / "run.rrd")
    wanted = []
    for _ in Run(drive(60), observers=[log]):
        wanted.append(log.wants_cells())  # noqa: PERF401 - at each scan
    assert wanted[0]
    assert not wanted[-1]
    assert sum(picture is not None for picture in pictures(tmp_path / "run.rrd").values()) == 1


@pytest.mark.parametrize("method", ["odometry", "icp"])
def test_methods_without_a_test_show_no_cells(method: str, tmp_path: Path) -> None:
    Run(drive(20), method, observers=[RerunRecording(path=tmp_path / "run.rrd")]).complete()
    assert "/world/cells" not in rows(tmp_path / "run.rrd")


def test_no_cells_are_cropped_where_nothing_is_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    def crop(*_: object) -> None:
        pytest.fail("cells were cropped")

    monkeypatch.setattr(Pipeline, "crop_test_grid", crop)
    monkeypatch.setattr(OccupancyGrid, "crop", crop)
    Run(drive(30)).complete()
