"""Observers see everything of a run and change nothing of it."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slammot_graph import Run
from slammot_graph.core.results import GraphEdge, GridMap, RunResult, StepResult
from slammot_graph.observer import Observer, RunInfo, RunView, read_only
from slammot_graph.pipeline import Pipeline
from tests.loop_closure.ring import ring_log
from tests.rooms import drive
from tests.viz.rerun.recordings import assert_same_results


class Diary(Observer):
    """Notes which hook was called at which scan; asks for a map at every tenth."""

    def __init__(self, *, map_every: int = 10) -> None:
        self.calls: list[tuple[str, int]] = []
        self.infos: list[RunInfo] = []
        self.results: list[RunResult] = []
        self.map_every = map_every
        self.n_steps = 0

    def on_start(self, info: RunInfo) -> None:
        self.infos.append(info)
        self.calls.append(("start", -1))

    def on_step(self, step: StepResult, view: RunView) -> None:
        self.n_steps += 1
        self.calls.append(("step", step.scan.index))

    def on_closure(self, step: StepResult, view: RunView) -> None:
        self.calls.append(("closure", step.scan.index))

    def wants_map(self) -> bool:
        return self.n_steps % self.map_every == 0

    def on_map(self, step: StepResult, grid: GridMap) -> None:
        self.calls.append(("map", step.scan.index))

    def on_finish(self, result: RunResult) -> None:
        self.results.append(result)
        self.calls.append(("finish", -1))

    def close(self) -> None:
        self.calls.append(("close", -1))

    def scans(self, hook: str) -> list[int]:
        return [scan for name, scan in self.calls if name == hook]


class Curious(Observer):
    """Asks for all there is, for the map (which takes long) at every fifth scan."""

    n_steps = 0

    def on_step(self, step: StepResult, view: RunView) -> None:
        assert len(view.nodes()) == len({edge.to_node for edge in view.edges()} | {0})
        view.test_grid(5.0)
        self.n_steps += 1
        if self.n_steps % 5 == 1:
            assert np.isfinite(view.map().p_occupied).any()
            assert view.map() is view.map()


def test_an_observer_of_three_lines() -> None:
    class Count(Observer):
        n = 0

        def on_step(self, step: StepResult, view: RunView) -> None:
            self.n += 1

    count = Count()
    Run(drive(7), observers=[count]).complete()
    assert count.n == 7


def test_the_hooks_come_in_their_order() -> None:
    first, second = Diary(), Diary(map_every=20)
    run = Run(drive(30), observers=[first, second], max_scans=25)
    steps = list(run)
    assert first.calls[0] == ("start", -1)
    assert first.calls[-2:] == [("finish", -1), ("close", -1)]
    assert first.scans("step") == [step.scan.index for step in steps] == list(range(25))
    assert (first.scans("map"), second.scans("map")) == ([9, 19], [19])
    assert first.calls[first.calls.index(("map", 9)) - 1] == ("step", 9)
    (info,) = first.infos
    assert (info.method, info.n_scans, info.log_path) == ("graph", 25, Path("list.log"))
    assert info.config["max_range_m"] == 40.0
    (result,) = first.results
    assert_same_results(result, run.result())


def test_closures_are_told_at_their_scan() -> None:
    diary = Diary(map_every=10**9)
    steps = list(Run(ring_log(3), observers=[diary]))
    closed = [
        step.scan.index for step in steps if any(attempt.status == "accepted" for attempt in step.closures)
    ]
    assert diary.scans("closure") == closed
    assert len(closed) >= 5


def test_a_map_is_rendered_only_where_an_observer_wants_it_and_once_for_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    n_maps = 0

    def render(pipeline: Pipeline, *given: Any) -> GridMap:
        nonlocal n_maps
        n_maps += 1
        return render_map(pipeline, *given)

    render_map = Pipeline.render_map
    monkeypatch.setattr(Pipeline, "render_map", render)
    Run(drive(20), observers=[Observer()]).complete()
    assert n_maps == 1  # that of the result
    Run(drive(20), observers=[Diary(), Diary()]).complete()
    assert n_maps == 2 + 2


@pytest.mark.parametrize("method", ["graph", "docpfo", "odometry"])
def test_what_observers_ask_does_not_change_the_estimate(method: str) -> None:
    plain = Run(drive(120), method).complete()
    if method == "graph":
        assert_same_results(Run(drive(120), method, observers=[Curious(), Diary()]).complete(), plain)
    else:
        assert_same_results(Run(drive(120), method, observers=[Diary()]).complete(), plain)


def test_closing_loops_is_the_same_under_observation() -> None:
    plain = Run(ring_log(2)).complete()
    assert_same_results(Run(ring_log(2), observers=[Curious()]).complete(), plain)


def arrays_of(value: Any) -> list[np.ndarray]:
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, tuple | list):
        return [array for item in value for array in arrays_of(item)]
    if isinstance(value, Mapping):
        return [array for item in value.values() for array in arrays_of(item)]
    if is_dataclass(value):
        return [a for f in fields(value) if f.name != "laser" for a in arrays_of(getattr(value, f.name))]
    return []


def test_nothing_that_observers_get_can_be_written_to() -> None:
    seen: list[np.ndarray] = []

    class Greedy(Observer):
        def on_step(self, step: StepResult, view: RunView) -> None:
            grid = view.test_grid(5.0)
            seen.extend(arrays_of((step, view.nodes(), view.edges(), view.map(), grid)))
            seen.append(step.scan.points_base())
            with pytest.raises(TypeError):
                step.stage_ms["step"] = 0.0  # type: ignore[index]

        def on_finish(self, result: RunResult) -> None:
            seen.extend(arrays_of(result))

    steps = list(Run(drive(60), observers=[Greedy()]))
    assert len(seen) > 1000
    assert not any(array.flags.writeable for array in seen)
    assert steps[-1].is_moving.flags.writeable  # whoever iterates over the run has the step itself


def test_read_only_copies_share_their_numbers() -> None:
    edge = GraphEdge(kind="match", from_node=0, to_node=1, T_from_to=np.arange(3.0), information=np.eye(3))
    (copy,) = read_only((edge,))
    assert (copy.kind, copy.to_node) == ("match", 1)
    assert np.shares_memory(copy.T_from_to, edge.T_from_to)
    assert not copy.information.flags.writeable
    assert edge.information.flags.writeable


def test_an_observer_that_fails_ends_the_run_and_all_are_closed() -> None:
    class Fails(Observer):
        def on_step(self, step: StepResult, view: RunView) -> None:
            if step.scan.index == 5:
                raise OSError("disk full")

        def on_finish(self, result: RunResult) -> None:
            raise OSError("still full")

    diary = Diary()
    run = Run(drive(20), observers=[Fails(), diary])
    with pytest.raises(OSError, match="disk full") as caught:
        run.complete()
    assert caught.value.__notes__ == ["at the end of the run: still full"]
    assert [len(result.stamps) for result in diary.results] == [6]
    assert diary.calls[-1] == ("close", -1)
    assert len(run.result().stamps) == 6


def test_an_observer_that_cannot_begin_ends_the_run_before_its_first_scan() -> None:
    class Fails(Observer):
        def on_start(self, info: RunInfo) -> None:
            raise OSError("no such folder")

    diary = Diary()
    with pytest.raises(OSError, match="no such folder"):
        Run(drive(20), observers=[diary, Fails()]).complete()
    assert diary.calls == [("start", -1), ("close", -1)]


def test_a_run_left_early_is_finished_for_its_observers() -> None:
    diary = Diary()
    with Run(drive(20), observers=[diary]) as run:
        steps = iter(run)
        for _ in range(3):
            next(steps)
        assert diary.results == []
    assert [(len(result.stamps), result.is_complete) for result in diary.results] == [(3, False)]
    assert diary.calls[-1] == ("close", -1)
