"""The recording is read back from its file; not recording costs nothing, not even the import."""

import copy
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import rerun as rr

from slammot_graph import Run, get_method
from slammot_graph.cli.running import _record
from slammot_graph.core import se2
from slammot_graph.core.config import to_plain
from slammot_graph.core.errors import InputError
from slammot_graph.core.events import Event
from slammot_graph.core.results import ClosureAttempt, ClosureStatus, GridMap, RunResult, StepResult
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.localization import ScanToMap
from slammot_graph.mapping.occupancy_grid import OccupancyGrid
from slammot_graph.pipeline import Pipeline
from slammot_graph.viz.rerun import recording
from slammot_graph.viz.rerun.recording import COLOR_CELLS, NoRunLog, RerunLog
from tests.loop_closure.ring import ring_log
from tests.rooms import drive

N_SCANS = 40
MARGIN_M = 2.0
"""How far around moving points cells are shown: up to the walls."""


@pytest.fixture(autouse=True, scope="module")
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def record(path: Path) -> RunResult:
    config = get_method("graph").config
    log = RerunLog(path=path, method="graph", config=to_plain(config))
    run = Run(drive(N_SCANS), config=config)
    for step in run:
        log.log_step(step)
    result = run.result()
    log.finish(result)
    log.close()
    return result


def rows(path: Path) -> Counter[str]:
    from rerun.chunk import RrdReader

    counts: Counter[str] = Counter()
    for chunk in RrdReader(path).stream():
        counts[str(chunk.entity_path)] += chunk.num_rows
    return counts


def entries(path: Path, entity: str, component: str) -> dict[int, list[Any]]:
    """Instances of a component of an entity, by scan."""
    from rerun.chunk import RrdReader

    found: dict[int, list[Any]] = {}
    for chunk in RrdReader(path).stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if not chunk.is_static and component in batch.schema.names:
            values = (value or [] for value in batch.column(component).to_pylist())
            found.update(zip(batch.column("scan").to_pylist(), values, strict=True))
    return found


def strips(path: Path, entity: str) -> dict[int, list[FloatArray]]:
    """Line strips of an entity in the plane, by scan."""
    found = entries(path, entity, "LineStrips3D:strips")
    return {scan: [np.array(strip)[:, :2] for strip in lines] for scan, lines in found.items()}


def entity_of(status: ClosureStatus) -> str:
    return f"/world/closures/{status.replace(' ', '_')}"


@dataclass
class Ring:
    """What a recorded run that closes loops did."""

    path: Path
    steps: list[StepResult] = field(default_factory=list)
    before: dict[int, FloatArray] = field(default_factory=dict)
    after: dict[int, FloatArray] = field(default_factory=dict)


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory, strict: None) -> Ring:
    """A recording whose nodes were told at each closure that was accepted."""
    ring = Ring(tmp_path_factory.mktemp("ring") / "run.rrd")
    log, run = RerunLog(path=ring.path, method="graph", config={}), Run(ring_log(3))
    nodes = np.empty((0, 3))
    for step in run:
        log.log_step(step)
        ring.steps.append(step)
        assert log.wants_nodes == any(attempt.status == "accepted" for attempt in step.closures)
        assert isinstance(run.pipeline.localizer, ScanToMap)
        nodes_before = nodes
        if step.node is not None:
            nodes = run.pipeline.localizer.graph.poses()
        if log.wants_nodes:
            ring.before[step.scan.index], ring.after[step.scan.index] = nodes_before, nodes
            log.log_nodes(nodes)
    log.close()
    return ring


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
    log, run = RerunLog(path=people.path, method="graph", config={}), Run(drive(230))
    before = None
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording, "CELLS_MARGIN_M", MARGIN_M)
        for step in run:
            assert isinstance(run.pipeline, Pipeline)
            _record(run, log, step)
            people.steps.append(step)
            after = copy.deepcopy(run.pipeline.detector.grid)
            if step.is_moving.any() and step.scan.index % 7 == 0 and before is not None:
                people.grids[step.scan.index] = before, after, run.pipeline.localizer.T_map_local
            before = after
    log.close()
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
        xy = self.size_m * (np.column_stack([cols.ravel(), rows.ravel()]) + 0.5)
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
    config = get_method("graph").config.detector.local_grid
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
    cells = GridMap(p_occupied=p_occupied, resolution_m=0.1, origin=origin)
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    for step, kept, T in zip(
        steps, (cells, replace(cells, origin=np.zeros(2))), (np.zeros(3), T_map_local), strict=True
    ):
        log.log_cells(kept, T, (0.12, 0.8))
        is_moving = np.arange(len(points)) == 20
        log.log_step(replace(step, T_map_base=se2.compose(T, step.T_map_base), is_moving=is_moving))
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
    monkeypatch.setattr(recording, "CELLS_HEAD_START", 0)
    monkeypatch.setattr(recording, "CELLS_SHARE", 0.0)
    log, run = RerunLog(path=tmp_path / "run.rrd", method="graph", config={}), Run(drive(60))
    assert log.wants_cells
    for step in run:
        _record(run, log, step)
    assert not log.wants_cells
    log.close()
    assert sum(picture is not None for picture in pictures(tmp_path / "run.rrd").values()) == 1


@pytest.mark.parametrize("method", ["odometry", "icp"])
def test_methods_without_a_test_show_no_cells(method: str, tmp_path: Path) -> None:
    log, run = RerunLog(path=tmp_path / "run.rrd", method=method, config={}), Run(drive(20), method)
    for step in run:
        _record(run, log, step)
    log.close()
    assert "/world/cells" not in rows(tmp_path / "run.rrd")


def test_no_cells_are_cropped_where_nothing_is_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    def crop(*_: object) -> None:
        pytest.fail("cells were cropped")

    monkeypatch.setattr(Pipeline, "crop_test_grid", crop)
    monkeypatch.setattr(OccupancyGrid, "crop", crop)
    run = Run(drive(30))
    for step in run:
        _record(run, NoRunLog(), step)


def test_a_recording_holds_scan_map_graph_plots_and_config(tmp_path: Path) -> None:
    result = record(tmp_path / "run.rrd")
    counts = rows(tmp_path / "run.rrd")
    assert counts["/world/map/grid"] >= 1
    assert counts["/world/graph/nodes"] >= 1
    assert counts["/doc/config"] >= 1
    plots = [name for name in counts if name.startswith("/plots/")]
    assert any("timing" in name for name in plots)
    assert any("count" in name for name in plots)
    assert max(counts[name] for name in plots) >= N_SCANS
    points = [name for name in counts if name.startswith("/world/") and counts[name] >= N_SCANS]
    assert points, counts
    assert result.is_complete


def test_a_recording_carries_its_layout(tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    record(tmp_path / "run.rrd")
    reader = RrdReader(tmp_path / "run.rrd")
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) >= 1


def test_a_short_run_has_its_map_and_graph(tmp_path: Path) -> None:
    """Also before the first scans are sent."""
    log, run = RerunLog(path=tmp_path / "run.rrd", method="graph", config={}), Run(drive(60))
    for step in run:
        _record(run, log, step)
    log.close()
    for entity, component in (
        ("/world/map/grid", "GridMap:cell_size"),
        ("/world/graph/nodes", "Points3D:positions"),
        ("/world/estimate/way", "LineStrips3D:strips"),
    ):
        assert max(entries(tmp_path / "run.rrd", entity, component)) >= 40


@pytest.mark.parametrize(
    ("nis", "top"), [([], 10.0), ([np.nan], 10.0), ([1.0, np.nan], 10.0), ([15.0], 16.5), ([900.0], 20.0)]
)
def test_plots_end_above_most_of_their_values(nis: list[float], top: float, tmp_path: Path) -> None:
    result = replace(record(tmp_path / "run.rrd"), nis=np.array(nis))
    tops = recording._tops(result)
    assert tops["nis"] == pytest.approx(top)
    assert tops["count"] == pytest.approx(1.4 * result.is_valid.sum(axis=1).max())
    assert np.nanmedian(result.stage_ms["step"]) < tops["timing"]
    without = recording._tops(replace(result, stage_ms={}, is_valid=np.zeros((0, 0), dtype=bool)))
    assert set(without) == {"nis"}


def test_events_name_their_scan(tmp_path: Path) -> None:
    failed = Event(kind="match failed", severity="warning", scan=7, data={"reason": "so it is"})
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    for k, step in enumerate(Run(drive(10))):
        log.log_step(replace(step, events=(failed,) if k == 7 else ()))
    log.close()
    texts = entries(tmp_path / "run.rrd", "/log/events", "TextLog:text")
    assert texts == {7: ["scan 7: match failed: so it is"]}
    assert entries(tmp_path / "run.rrd", "/log/events", "TextLog:level") == {7: ["WARN"]}


def test_a_recording_is_small(tmp_path: Path) -> None:
    record(tmp_path / "run.rrd")
    assert (tmp_path / "run.rrd").stat().st_size < 750_000 + N_SCANS * 11_000  # the layouts, and the scans


def test_a_folder_that_is_not_there_is_a_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--rerun off"):
        RerunLog(path=tmp_path / "no" / "such" / "run.rrd", method="graph", config={})


def test_close_may_come_twice(tmp_path: Path) -> None:
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    log.close()
    log.close()


def test_off_means_off() -> None:
    log = NoRunLog()
    assert not log.wants_cells
    assert not log.wants_map
    assert not log.wants_graph
    assert not log.wants_nodes
    code = (
        "import sys; from slammot_graph.viz.rerun.recording import NoRunLog; import slammot_graph; NoRunLog().close(); "
        "sys.exit('rerun' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_step_is_not_changed_by_recording(tmp_path: Path) -> None:
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    step = next(iter(Run(drive(5))))
    before = step.scan.ranges.copy()
    log.log_step(step)
    log.close()
    np.testing.assert_array_equal(step.scan.ranges, before)


def test_every_closure_that_was_tried_is_there_with_its_reason(ring: Ring) -> None:
    tried = [(step.scan.index, attempt) for step in ring.steps for attempt in step.closures]
    assert {attempt.status for _, attempt in tried} >= {"accepted", "refused"}
    for status in get_args(ClosureStatus):
        texts = entries(ring.path, entity_of(status), "LineStrips3D:labels")
        told = [(scan, text) for scan in sorted(texts) for text in texts[scan]]
        assert told == [(scan, attempt.text) for scan, attempt in tried if attempt.status == status]
        lines = strips(ring.path, entity_of(status))
        assert {k: len(v) for k, v in lines.items()} == {k: len(v) for k, v in texts.items()}
    refused = entries(ring.path, entity_of("refused"), "LineStrips3D:labels")
    reasons = [attempt.reason for _, attempt in tried if attempt.status == "refused"]
    assert all(reasons)
    assert all(reason in str(refused) for reason in reasons)


def test_a_closure_joins_the_places_of_its_nodes(ring: Ring) -> None:
    drawn = strips(ring.path, entity_of("accepted"))
    for step in ring.steps:
        accepted = [attempt for attempt in step.closures if attempt.status == "accepted"]
        for attempt, line in zip(accepted, drawn.get(step.scan.index, []), strict=True):
            ends = ring.before[step.scan.index][[attempt.target_node, attempt.source_node], :2]
            np.testing.assert_allclose(line, ends, atol=0.02)


def test_the_graph_is_there_before_and_after_a_closure(ring: Ring) -> None:
    before = strips(ring.path, "/world/closures/graph_before")
    after = strips(ring.path, "/world/estimate/way")
    assert set(before) == set(after) == set(ring.after)
    assert len(after) >= 5
    for scan, nodes in ring.after.items():
        (old,), (new,) = before[scan], after[scan]
        np.testing.assert_allclose(new, nodes[:, :2], atol=1e-5)
        np.testing.assert_allclose(old[:-1], ring.before[scan][:, :2], atol=0.03)
        way = np.diff(old[-2:], axis=0)  # the closing node has not jumped yet
        np.testing.assert_allclose(way, np.diff(new[-2:], axis=0), atol=0.02)
    first = min(after)
    assert np.hypot(*(after[first][0] - before[first][0]).T).max() > 0.05


def test_closures_of_the_graph_follow_its_nodes(ring: Ring) -> None:
    """Each closure moves those before it."""
    drawn = strips(ring.path, "/world/graph/closure")
    accepted: list[tuple[int, int]] = []
    assert set(drawn) == set(ring.after)
    for step in ring.steps:
        of_step = [attempt for attempt in step.closures if attempt.status == "accepted"]
        assert all(attempt.status != "outlier" for attempt in step.closures)
        accepted += [(attempt.target_node, attempt.source_node) for attempt in of_step]
        if of_step:
            nodes = ring.after[step.scan.index]
            np.testing.assert_allclose(drawn[step.scan.index], nodes[accepted][..., :2], atol=1e-5)


def test_a_closure_that_is_taken_back_is_no_longer_drawn(tmp_path: Path) -> None:
    def attempt(source: int, status: ClosureStatus) -> ClosureAttempt:
        return ClosureAttempt(
            target_node=0, source_node=source, status=status, reason="", T_target_source=np.zeros(3)
        )

    tried = {40: [attempt(1, "accepted")], 60: [attempt(2, "accepted"), attempt(1, "outlier")]}
    log, run = RerunLog(path=tmp_path / "run.rrd", method="graph", config={}), Run(drive(70))
    for k, step in enumerate(run):
        log.log_step(replace(step, closures=tuple(tried.get(k, ()))))
        if log.wants_nodes:
            nodes = run.pipeline.nodes_and_edges()[0]
            log.log_nodes(nodes)
    log.close()
    drawn = strips(tmp_path / "run.rrd", "/world/graph/closure")
    assert {k: len(lines) for k, lines in drawn.items()} == {40: 1, 60: 1}
    np.testing.assert_allclose(drawn[60][0], nodes[[0, 2], :2], atol=1e-5)


def test_the_graph_view_joins_nodes_that_it_has(ring: Ring) -> None:
    """An edge to a node of another entity would make a node of its own, somewhere."""
    log, run = RerunLog(path=ring.path.with_name("graph.rrd"), method="graph", config={}), Run(ring_log(3))
    for step in run:
        log.log_step(step)
    result = run.result()
    log.finish(result)
    log.close()
    path = ring.path.with_name("graph.rrd")
    assert [name for name in rows(path) if name.startswith("/graph/")] == ["/graph/chain"]
    (names,) = entries(path, "/graph/chain", "GraphNodes:node_ids").values()
    (edges,) = entries(path, "/graph/chain", "GraphEdges:edges").values()
    ends = {(edge["first"], edge["second"]) for edge in edges}
    closures = {(str(e.from_node), str(e.to_node)) for e in result.edges if e.kind == "closure"}
    assert len(closures) >= 5
    assert closures <= ends
    assert {end for edge in ends for end in edge} <= set(names)


def test_only_the_latest_attempts_are_drawn_each_with_its_status(tmp_path: Path) -> None:
    """Over several batches; a status without an attempt is cleared by the next step that tried any."""

    def attempt(status: ClosureStatus) -> ClosureAttempt:
        return ClosureAttempt(
            target_node=0, source_node=1, status=status, reason=f"so {status}", T_target_source=np.zeros(3)
        )

    steps = list(Run(drive(250)))
    tried: dict[int, tuple[ClosureStatus, ...]] = {
        40: ("refused", "waiting", "refused"),
        120: ("accepted", "outlier"),
        130: ("waiting",),
        210: ("outlier",),
    }
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    for k, step in enumerate(steps):
        log.log_step(replace(step, closures=tuple(attempt(status) for status in tried.get(k, ()))))
        assert log.wants_nodes == (k >= 120)  # nobody tells it the nodes
    log.close()
    expected = {
        "accepted": {120: 1, 130: 0},
        "waiting": {40: 1, 120: 0, 130: 1, 210: 0},
        "refused": {40: 2, 120: 0, 130: 0},
        "outlier": {120: 1, 130: 0, 210: 1},
    }
    for status in get_args(ClosureStatus):
        texts = entries(tmp_path / "run.rrd", entity_of(status), "LineStrips3D:labels")
        assert {scan: len(of_scan) for scan, of_scan in texts.items()} == expected[status]
        assert all(f"so {status}" in text for of_scan in texts.values() for text in of_scan)


def test_the_graph_before_and_after_waits_for_the_nodes(tmp_path: Path) -> None:
    """Where nobody tells the nodes at the closure, the next graph shows what it did."""
    closure = ClosureAttempt(
        target_node=0, source_node=1, status="accepted", reason="", T_target_source=np.zeros(3)
    )
    log, run = RerunLog(path=tmp_path / "run.rrd", method="graph", config={}), Run(drive(30))
    nodes: list[FloatArray] = []
    for k, step in enumerate(run):
        log.log_step(replace(step, closures=(closure,)) if k == 20 else step)
        if step.node is not None and k <= 20:
            nodes.append(step.T_map_base)
    log.finish(run.result())
    assert not log.wants_nodes
    log.close()
    ((scan, (before,)),) = strips(tmp_path / "run.rrd", "/world/closures/graph_before").items()
    assert scan == 29
    np.testing.assert_allclose(before, np.array(nodes)[:, :2], atol=1e-3)
    ((scan, (after,)),) = strips(tmp_path / "run.rrd", "/world/estimate/way").items()
    assert scan == 29
    np.testing.assert_allclose(after, run.result().nodes[:, :2], atol=1e-5)


def test_a_point_tells_its_beam_its_probability_its_reason_and_its_ellipse(tmp_path: Path) -> None:
    from slammot_graph.detection.reasons import REASONS

    step = list(Run(drive(30)))[-1]
    p_moving = np.where(step.is_valid, np.linspace(0.0, 1.0, len(step.p_moving)), np.nan)
    step = replace(step, p_moving=p_moving, is_moving=p_moving > 0.75)
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    log.log_step(step)
    log.close()
    semi_mm = 2448.0 * np.sqrt(np.linalg.eigvalsh(step.point_cov_map))
    k = step.scan.index
    for entity, beams in (
        ("/world/robot/scan", np.flatnonzero(step.is_valid)),
        ("/world/ellipses/moving", np.flatnonzero(step.is_moving)),
    ):
        told = {
            name: entries(tmp_path / "run.rrd", entity, name)[k]
            for name in ("beam", "p_moving", "reason", "ellipse_long_mm", "ellipse_short_mm")
        }
        assert told["beam"] == beams.tolist()
        np.testing.assert_allclose(told["p_moving"], p_moving[beams], atol=6e-4)
        assert told["reason"] == [REASONS[code] for code in step.reason[beams]]
        np.testing.assert_allclose(told["ellipse_long_mm"], semi_mm[beams, 1], atol=1.0)
        np.testing.assert_allclose(told["ellipse_short_mm"], semi_mm[beams, 0], atol=1.0)
    classes = entries(tmp_path / "run.rrd", "/world/robot/scan", "Points3D:class_ids")[k]
    expected = np.where(p_moving > 0.75, 2, np.where(p_moving > 0.5, 3, 1))[step.is_valid]
    assert classes == expected.tolist()


def test_the_anchor_is_drawn_where_it_changes(tmp_path: Path) -> None:
    steps = list(Run(drive(250)))
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    for step in steps:
        log.log_step(step)
    log.close()
    labels = entries(tmp_path / "run.rrd", "/world/anchor", "Points3D:labels")
    before = [-1, *(step.anchor_scan for step in steps)]
    changed = [k for k, step in enumerate(steps) if step.anchor_scan != before[k]]
    assert len(changed) >= 2
    assert {k: text for k, text in labels.items() if text} == {
        k: [f"scan {steps[k].anchor_scan}"] for k in changed
    }
    places = entries(tmp_path / "run.rrd", "/world/anchor", "Points3D:positions")
    for k in changed:
        np.testing.assert_allclose(places[k][0][:2], steps[steps[k].anchor_scan].T_map_base[:2], atol=0.05)


def test_maps_are_asked_for_less_often_in_a_longer_run(tmp_path: Path) -> None:
    """Their number grows with the logarithm of the run, so that rendering them costs a fixed time a scan."""
    steps = list(Run(drive(30)))
    log = RerunLog(path=tmp_path / "run.rrd", method="graph", config={})
    asked = []
    for k in range(2000):
        log.log_step(steps[-1])
        if log.wants_map:
            asked.append(k)
            log.log_map(GridMap(p_occupied=np.full((2, 2), 0.1), resolution_m=0.1, origin=np.zeros(2)))
    log.close()
    assert 20 <= len(asked) <= 45
    assert sum(asked) < 12 * 2000
