"""The loop: whatever happens to the workers, each cell is answered once."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.study.cells import Cell, Outcome, Task
from slammot_graph.study.data_files import DataFile, data_file
from slammot_graph.study.processes import Here, Processes
from slammot_graph.study.runner import (
    Answer,
    ConnectionLostError,
    PoolBrokenError,
    Times,
    WorkerDiedError,
    compute,
)
from slammot_graph.study.store import CellStore
from slammot_graph.study.study_run import Progress, finish_cells
from tests.study.work import calls, cell


class Made:
    """Workers that answer as they are told, and note what they are given."""

    def __init__(self, n: int, answer: Callable[[Task], Answer]) -> None:
        self.n = n
        self.answer = answer
        self.tasks: list[Task] = []
        self.n_restarts = 0
        self.provided: list[DataFile] = []
        self.is_closed = False

    def submit(self, task: Task, done: Callable[[Answer], None]) -> None:
        self.tasks.append(task)
        done(self.answer(task))

    def is_alive(self) -> bool:
        return True

    def restart(self) -> None:
        self.n_restarts += 1

    def provide(self, file: DataFile) -> None:
        self.provided.append(file)

    def close(self) -> None:
        self.is_closed = True


def good(task: Task) -> Answer:
    return [Outcome(cell=one, scores={"x": one.arguments["x"]}, seconds=1.0) for one in task]


def numbers(n: int, folder: str = "") -> list[Cell]:
    return [cell(x=float(k), folder=folder) for k in range(n)]


def test_each_cell_is_answered_once() -> None:
    workers = Made(3, good)
    cells = numbers(50)
    outcomes = list(compute(cells, workers))
    assert sorted(outcome.cell.arguments["x"] for outcome in outcomes) == list(range(50))
    assert workers.is_closed


def test_cells_of_one_log_go_together_and_fewer_at_the_end() -> None:
    cells = [
        Cell(key=f"{g} {k}", function="f", code="", arguments={"x": k, "g": g}, group=f"{g}", kind="k")
        for g in range(8)
        for k in range(6)
    ]
    workers = Made(2, good)
    times = Times()
    times.add("k", 1.0)
    list(compute(cells, workers, times))
    assert all(len({one.group for one in task}) == 1 for task in workers.tasks)
    sizes = [len(task) for task in workers.tasks]
    assert max(sizes[:3]) > 2
    assert sizes[-3:] == [1, 1, 1]


@pytest.mark.parametrize("error", [WorkerDiedError, PoolBrokenError, ConnectionLostError])
def test_a_worker_that_dies_once_loses_no_cell(error: type[Exception]) -> None:
    n_died = 0

    def answer(task: Task) -> Answer:
        nonlocal n_died
        if n_died < 2 and len(workers.tasks) % 3 == 2:
            n_died += 1
            return error("gone")  # type: ignore[return-value]
        return good(task)

    workers = Made(2, answer)
    outcomes = list(compute(numbers(20), workers))
    assert n_died == 2
    assert sorted(outcome.cell.arguments["x"] for outcome in outcomes) == list(range(20))
    assert all(outcome.scores for outcome in outcomes)


def test_the_cell_that_kills_its_process_fails_and_the_others_do_not() -> None:
    def answer(task: Task) -> Answer:
        bad = any(one.arguments["x"] == 7.0 for one in task)
        return PoolBrokenError("gone") if bad else good(task)

    workers = Made(2, answer)
    outcomes = {o.cell.arguments["x"]: o for o in compute(numbers(20), workers)}
    assert len(outcomes) == 20
    assert [x for x, outcome in outcomes.items() if outcome.scores is None] == [7.0]
    assert "out of memory" in outcomes[7.0].error


def test_a_missing_file_is_brought_once(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_text("a", encoding="utf-8")
    file = data_file(path)

    def answer(task: Task) -> Answer:
        if not workers.provided:
            return [Outcome(cell=one, error="missing", missing=file) for one in task]
        return [Outcome(cell=one, scores={}) for one in task]

    workers = Made(1, answer)
    (outcome,) = compute([cell("content", files={"log": file})], workers)
    assert outcome.scores == {}
    assert workers.provided == [file]
    workers.answer = lambda task: [Outcome(cell=one, error="missing", missing=file) for one in task]
    (outcome,) = compute([cell("content", files={"log": file})], workers)
    assert outcome.error == "missing"


def test_time_left_is_that_of_each_kind() -> None:
    times = Times()
    assert times.left({"a": 1}, 1) is None
    times.add("a", 2.0)
    times.add("a", 4.0)
    times.add("b", 10.0)
    assert times.left({"a": 2, "b": 1}, 2) == pytest.approx((2 * 3.0 + 10.0) / 2)
    assert times.left({"c": 1}, 1) == pytest.approx(16.0 / 3)


def test_processes_that_are_killed_lose_no_cell(tmp_path: Path) -> None:
    """Two of the cells kill their process, one of them always; loky's processes are real."""
    folder = str(tmp_path)
    cells = [
        *(cell(x=float(k), folder=folder, seconds=0.05) for k in range(12)),
        cell("die", x=100.0, folder=folder, times=1),
        cell("die", x=200.0, folder=folder, times=99),
        *(cell(x=float(k), folder=folder, seconds=0.05) for k in range(20, 32)),
    ]
    outcomes = {outcome.cell.key: outcome for outcome in compute(cells, Processes(2))}
    assert len(outcomes) == len(cells)
    assert [key for key, outcome in outcomes.items() if outcome.scores is None] == ["die 200"]
    assert "its process died" in outcomes["die 200"].error


def test_processes_keep_what_they_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Packages and logs of a few hundred MB are no leak: a process that starts anew for them loads them again."""
    for name in ("OMP_NUM_THREADS", "LOKY_MAX_MEMORY_LEAK_SIZE"):
        monkeypatch.delenv(name, raising=False)
    cells = [cell("grow", x=float(k)) for k in range(12)]
    scores = [outcome.scores or {} for outcome in compute(cells, Processes(2))]
    assert len({one["pid"] for one in scores}) <= 2
    assert {one["n_threads"] for one in scores} == {"1"}


def test_a_changed_cell_is_the_only_one_computed_again(tmp_path: Path) -> None:
    store, progress = CellStore(tmp_path / "cells"), Progress()
    cells = numbers(5, str(tmp_path))
    records, errors = finish_cells(cells, store, Here, progress=progress)
    assert (len(records), errors, sum(progress.done.values())) == (5, {}, 5)
    cells[2] = cell(x=12.0, folder=str(tmp_path))
    records, _ = finish_cells(cells, CellStore(tmp_path / "cells"), Here)
    assert records[cells[2].digest]["scores"]["double"] == 24.0
    assert calls(tmp_path) == ["0", "1", "2", "3", "4", "12"]


def test_failed_cells_are_told_and_tried_again(tmp_path: Path) -> None:
    cells = [cell(x=x, folder=str(tmp_path)) for x in (1.0, -1.0, 2.0)]
    progress = Progress()
    for n_calls in (3, 4):
        records, errors = finish_cells(cells, CellStore(tmp_path / "cells"), Here, progress=progress)
        assert list(errors) == [cells[1].digest]
        assert "-1 is negative" in errors[cells[1].digest]
        assert len(calls(tmp_path)) == n_calls
        assert CellStore(tmp_path / "cells").errors() == errors
    assert cells[0].digest in records
    finish_cells(cells[::2], CellStore(tmp_path / "cells"), Here)
    assert CellStore(tmp_path / "cells").errors() == {}


def test_parts_write_files_of_their_own_and_read_all(tmp_path: Path) -> None:
    cells = numbers(6, str(tmp_path))
    for k in range(2):
        finish_cells(cells[k::2], CellStore(tmp_path / "cells", f"part-{k}"), Here)
    assert len(list((tmp_path / "cells").glob("*.jsonl"))) == 2
    assert len(CellStore(tmp_path / "cells").records()) == 6
    assert CellStore(tmp_path / "cells", "part-0", everybody=False).records().keys() == {
        one.digest for one in cells[::2]
    }


def test_a_half_line_costs_its_cell_alone(tmp_path: Path) -> None:
    cells = numbers(3, str(tmp_path))
    store = CellStore(tmp_path / "cells")
    finish_cells(cells, store, Here)
    store.path.write_bytes(store.path.read_bytes()[:-7])
    store = CellStore(tmp_path / "cells")
    records, _ = finish_cells(cells, store, Here)
    assert len(records) == 3
    assert "half written" in store.remarks[0]
    assert calls(tmp_path) == ["0", "1", "2", "2"]
    assert all(json.loads(line) for line in store.path.read_text(encoding="utf-8").splitlines())


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "cells").write_text("", encoding="utf-8")
    with pytest.raises(InputError, match="name another --output"):
        finish_cells(numbers(1), CellStore(tmp_path / "cells"), Here)


def test_results_do_not_depend_on_the_workers(tmp_path: Path) -> None:
    cells = numbers(4, str(tmp_path))
    scores = [
        [run[one.digest]["scores"]["double"] for one in cells]
        for run in (
            finish_cells(cells, CellStore(tmp_path / "here"), Here)[0],
            finish_cells(cells, CellStore(tmp_path / "processes"), lambda: Processes(2))[0],
        )
    ]
    assert scores[0] == scores[1] == [0.0, 2.0, 4.0, 6.0]
