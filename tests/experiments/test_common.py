"""Sweeps that can be resumed, and the mistakes that the command line reports."""

import fcntl
import json
import math
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import pytest

from experiments import common
from experiments.common import Options, Scores, main, run_cells
from slammot_graph.core.errors import InputError

NAME = "made"


def count(x: float, calls: str) -> Scores:
    """Write down that it was called."""
    with (Path(calls) / "calls").open(
        "a", encoding="utf-8"
    ) as file:  # a folder: files count by their content
        file.write(f"{x:g}\n")
    if x < 0.0:
        raise ValueError(f"{x:g} is negative")
    return {"double": 2.0 * x, "none": math.nan, "deep": {"none": math.inf, "x": x}}


def size(log: str, calls: str) -> Scores:
    """Read a file, and write down that it was called."""
    with (Path(calls) / "calls").open("a", encoding="utf-8") as file:
        file.write("x")
    return {"size": Path(log).read_text(encoding="utf-8")}


@pytest.fixture
def options(tmp_path: Path) -> Options:
    return Options(output=tmp_path, jobs=1)


@pytest.fixture
def cells(tmp_path: Path) -> Callable[..., dict[str, dict[str, Any]]]:
    """Make cells of numbers."""
    return lambda *numbers: {f"x {x:g}": {"x": float(x), "calls": str(tmp_path)} for x in numbers}


def results(options: Options) -> Path:
    return options.output / "results" / f"{NAME}.jsonl"


def calls(options: Options) -> list[str]:
    return (options.output / "calls").read_text(encoding="utf-8").split()


def test_finished_cells_are_not_computed_again(options: Options, cells: Callable[..., Any]) -> None:
    first = run_cells(NAME, count, cells(1, 2), options)
    assert [first[key]["double"] for key in ("x 1", "x 2")] == [2.0, 4.0]
    both = run_cells(NAME, count, cells(3, 2, 1), options)
    assert list(both) == ["x 3", "x 2", "x 1"]
    assert [both[key]["double"] for key in both] == [6.0, 4.0, 2.0]
    assert calls(options) == ["1", "2", "3"]
    again = run_cells(NAME, count, cells(1, 2), options)
    assert math.isnan(again["x 1"]["none"])
    assert math.isnan(again["x 1"]["deep"]["none"])
    assert again["x 1"]["deep"]["x"] == 1.0
    assert calls(options) == ["1", "2", "3"]


def test_results_are_strict_json(options: Options, cells: Callable[..., Any]) -> None:
    run_cells(NAME, count, cells(1), options)

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    line = json.loads(results(options).read_text(encoding="utf-8"), parse_constant=refuse)
    assert line["key"] == "x 1"
    assert line["code"] == common.version_of(f"{__name__}:count")
    assert line["scores"] == {"double": 2.0, "none": None, "deep": {"none": None, "x": 1.0}}


def test_fresh_computes_all_anew(options: Options, cells: Callable[..., Any]) -> None:
    run_cells(NAME, count, cells(1), options)
    run_cells(NAME, count, cells(1), Options(output=options.output, jobs=1, fresh=True))
    assert calls(options) == ["1", "1"]
    assert len(results(options).read_text(encoding="utf-8").splitlines()) == 1


def test_a_half_written_line_is_cut_off(
    options: Options, cells: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    run_cells(NAME, count, cells(1, 2), options)
    whole = results(options).read_bytes()
    results(options).write_bytes(whole[:-9])
    capsys.readouterr()
    done = run_cells(NAME, count, cells(1, 2), options)
    (line,) = (x for x in capsys.readouterr().err.splitlines() if "half written" in x)
    assert line.startswith(str(results(options)))
    assert done["x 2"]["double"] == 4.0
    assert calls(options) == ["1", "2", "2"]
    lines = results(options).read_bytes().splitlines()  # but for the times
    assert [json.loads(line)["key"] for line in lines] == ["x 1", "x 2"]


def test_a_line_that_is_not_a_cell_is_computed_again(
    options: Options, cells: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    run_cells(NAME, count, cells(1, 2), options)
    lines = results(options).read_text(encoding="utf-8").splitlines()
    results(options).write_text(f'{{"key": "x 1"}}\n[1]\n\n{lines[1]}\n', encoding="utf-8")
    capsys.readouterr()
    done = run_cells(NAME, count, cells(1, 2), options)
    error = capsys.readouterr().err
    assert all(f"line {number}: not a finished cell" in error for number in (1, 2))
    assert "line 4" not in error
    assert done["x 1"]["double"] == 2.0
    assert calls(options) == ["1", "2", "1"]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_failing_cell_leaves_the_others(
    jobs: int, options: Options, cells: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    options = Options(output=options.output, jobs=jobs)
    with pytest.raises(InputError, match="1 of 3 cells failed"):
        run_cells(NAME, count, cells(1, -2, 3), options)
    assert f"{NAME}: cell x -2 failed: ValueError: -2 is negative (test_common.py" in capsys.readouterr().err
    assert sorted(calls(options)) == ["-2", "1", "3"]
    done = run_cells(NAME, count, cells(1, 3), options)
    assert [done[key]["double"] for key in done] == [2.0, 6.0]
    assert len(calls(options)) == 3
    with pytest.raises(InputError, match="1 of 3 cells failed"):
        run_cells(NAME, count, cells(1, -2, 3), options)
    assert len(calls(options)) == 4


def test_cells_of_other_code_are_computed_anew(
    options: Options, cells: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    run_cells(NAME, count, cells(1, 2), options)
    monkeypatch.setattr(common, "version_of", lambda _: "changed")
    run_cells(NAME, count, cells(1, 2, 3), options)
    assert calls(options) == ["1", "2", "1", "2", "3"]
    monkeypatch.undo()
    run_cells(NAME, count, cells(1, 2), options)  # those of the first code are still there
    assert len(calls(options)) == 5


def test_a_file_counts_by_its_content(options: Options, tmp_path: Path) -> None:
    log = tmp_path / "log"
    for content, n_calls in (("a", 1), ("a", 1), ("b", 2), ("a", 2)):
        log.write_text(content, encoding="utf-8")
        cells = {"log": {"log": str(log), "calls": str(tmp_path)}}
        assert run_cells(NAME, size, cells, options)["log"]["size"] == content
        assert len((tmp_path / "calls").read_text(encoding="utf-8")) == n_calls


def hold(path: str, held: Event, done: Event) -> None:
    """Lock the results until told to let go."""
    with Path(path).open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        held.set()
        done.wait(60.0)


@contextmanager
def other_process(path: Path) -> Iterator[None]:
    context = multiprocessing.get_context("spawn")
    held, done = context.Event(), context.Event()
    process = context.Process(target=hold, args=(str(path), held, done))
    process.start()
    try:
        assert held.wait(60.0)
        yield
    finally:
        done.set()
        process.join(60.0)
        process.close()


def test_results_that_another_process_writes_are_left_alone(
    options: Options, cells: Callable[..., Any]
) -> None:
    run_cells(NAME, count, cells(1), options)
    before = results(options).read_bytes()
    with other_process(results(options).with_suffix(".lock")):
        with pytest.raises(InputError, match="another process"):
            run_cells(NAME, count, cells(1, 2), options)
        assert results(options).read_bytes() == before
        assert calls(options) == ["1"]
    assert len(run_cells(NAME, count, cells(1, 2), options)) == 2


def test_fresh_does_not_take_what_another_process_writes(options: Options, cells: Callable[..., Any]) -> None:
    run_cells(NAME, count, cells(1), options)
    before = results(options).read_bytes()
    with (
        other_process(results(options).with_suffix(".lock")),
        pytest.raises(InputError, match="another process"),
    ):
        run_cells(NAME, count, cells(1), Options(output=options.output, jobs=1, fresh=True))
    assert results(options).read_bytes() == before


def nothing(options: Options) -> None:
    """Do nothing."""


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--seeds", "0"], "--seeds must be at least 1, not 0"),
        (["--seeds", "-3"], "--seeds must be at least 1, not -3"),
        (["--jobs", "0"], "--jobs must be at least 1, not 0"),
    ],
)
def test_wrong_options_are_one_line(
    arguments: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(nothing, [*arguments, "--output", str(tmp_path)]) == 2
    captured = capsys.readouterr()
    assert captured.err.splitlines() == [text]
    assert captured.out == ""


@pytest.mark.parametrize("by_variable", [True, False])
def test_a_missing_recorded_log_is_one_line(
    by_variable: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from experiments import walking_along

    arguments = ["--quick", "--output", str(tmp_path / "out")]
    if by_variable:
        monkeypatch.setenv("SLAMMOT_DATA", str(tmp_path))
    else:
        arguments += ["--data", str(tmp_path)]
    assert main(walking_along.experiment, arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{tmp_path}{os.sep}freiburg{os.sep}intel.clf.bz2: no such recorded log")
    assert "SLAMMOT_DATA" in line


def test_a_failed_sweep_is_exit_code_2(
    options: Options, cells: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    def experiment(asked: Options) -> None:
        run_cells(NAME, count, cells(-1), asked)

    assert main(experiment, ["--jobs", "1", "--output", str(options.output)]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_an_interrupted_sweep_says_how_to_go_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def experiment(_: Options) -> None:
        raise KeyboardInterrupt

    assert main(experiment, ["--output", str(tmp_path)]) == 130
    assert "run the same command to go on" in capsys.readouterr().err


def test_seeds_as_asked_for() -> None:
    assert Options().seed_range(20) == range(20)
    assert Options(quick=True).seed_range(20) == range(2)
    assert Options(quick=True).seed_range(20, quick=1) == range(1)
    assert Options(quick=True, seeds=7).seed_range(20) == range(7)


PROGRAM = """
import sys
from experiments.common import main, run_cells

def cell(x):
    return {"double": 2.0 * x}

def experiment(options):
    scores = run_cells("doubles", cell, {f"{x}": {"x": x} for x in (1.0, 2.0)}, options)
    print(sorted(one["double"] for one in scores.values()))

if __name__ == "__main__":
    sys.exit(main(experiment))
"""


def test_a_program_computes_its_cells_in_processes_of_their_own(tmp_path: Path) -> None:
    """There its functions are those of the module that was asked for, not of the program that runs."""
    (tmp_path / "doubles.py").write_text(PROGRAM, encoding="utf-8")
    root = Path(common.__file__).parents[1]
    told = subprocess.run(
        [sys.executable, "-m", "doubles", "--jobs", "2", "--output", str(tmp_path)],
        env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{root}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr
    assert "[2.0, 4.0]" in told.stdout
