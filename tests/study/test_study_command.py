"""The commands `study` and `report`: results, whatever interrupts them."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from slammot_graph.cli import main

ROOT = Path(__file__).parents[2]


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Ctrl-C reaches children also where these tests run in a shell's background, which has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def run(study: Path, output: Path, *more: str) -> int:
    return main(["study", str(study), "--output", str(output), *more])


def same(a: Path, b: Path) -> bool:
    return all(
        (a / name).read_bytes() == (b / name).read_bytes() for name in ("results.csv", "results.parquet")
    )


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_study_from_file_to_report(tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "out"
    assert run(tiny, output, "--jobs", "1") == 0
    rows = rows_of(output / "results.csv")
    assert [(row["method"], row["seed"]) for row in rows] == [
        (m, f"{s}") for s in range(3) for m in ("odometry", "icp")
    ]
    assert all(float(row["ate_m"]) > 0.0 for row in rows)
    table = pq.read_table(output / "results.parquet")
    assert [repr(value) for value in table["ate_m"].to_pylist()] == [row["ate_m"] for row in rows]
    assert table["recall"].type == "double"
    assert len(rows_of(output / "times.csv")) == 6
    assert rows_of(output / "failed.csv") == []
    origin = json.loads((output / "origin.json").read_text(encoding="utf-8"))
    assert origin["n_finished"] == 6
    report = output / "report"
    text = (report / "tables.md").read_text(encoding="utf-8")
    assert all(
        word in text for word in ("Command: `slammot-graph", "Revision: ", "| icp |", "(better in 3 of 3)")
    )
    tex = (report / "tables.tex").read_text(encoding="utf-8")
    assert tex.count(r"\begin{tabular}") == tex.count(r"\end{tabular}") == 1
    assert "cells/m\\^{}2" in tex
    page = (report / "index.html").read_text(encoding="utf-8")
    assert "http" not in page.replace("https://", "http://").split("<body>")[1]  # nothing from elsewhere
    assert page.count("data:image/png;base64,") == page.count("<figcaption>") >= 1
    assert page.count("revision ") >= page.count("<figcaption>")
    capsys.readouterr()
    before = (output / "cells" / "cells.jsonl").read_bytes()
    assert run(tiny, output, "--jobs", "1") == 0
    assert "6 of 6 cells done" in capsys.readouterr().err
    assert (output / "cells" / "cells.jsonl").read_bytes() == before
    assert main(["report", str(output)]) == 0


def test_a_study_that_is_killed_goes_on(tiny: Path, tmp_path: Path, environment: dict[str, str]) -> None:
    """kill -9 on the whole study in the middle; the table is the one of a study that was left alone."""
    tiny.write_text(tiny.read_text(encoding="utf-8").replace("seeds = 3", "seeds = 6"), encoding="utf-8")
    output, words = tmp_path / "out", ["slammot-graph", "study", str(tiny), "--output", str(tmp_path / "out")]
    process = subprocess.Popen(
        [*words, "--jobs", "2"], env=environment, stderr=subprocess.DEVNULL, start_new_session=True
    )
    cells = output / "cells" / "cells.jsonl"
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and not (cells.exists() and cells.read_bytes().count(b"\n") >= 2):
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    n_kept = cells.read_bytes().count(b"\n")
    assert 2 <= n_kept < 12
    assert run(tiny, output, "--jobs", "1") == 0
    assert cells.read_bytes().count(b"\n") == 12
    assert run(tiny, tmp_path / "other", "--jobs", "1") == 0
    assert same(output, tmp_path / "other")


def test_an_interrupted_study_writes_what_there_is(
    tiny: Path, tmp_path: Path, environment: dict[str, str], interruptible: None
) -> None:
    output = tmp_path / "out"
    tiny.write_text(tiny.read_text(encoding="utf-8").replace("seeds = 3", "seeds = 50"), encoding="utf-8")
    words = ["-m", "slammot_graph", "study", str(tiny), "--output", str(output), "--jobs", "2"]
    process = subprocess.Popen(
        [sys.executable, *words], env=environment, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    cells = output / "cells" / "cells.jsonl"
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline and not (cells.exists() and cells.read_bytes().count(b"\n") >= 2):
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60.0)
    assert process.returncode == 130, told
    assert told.splitlines()[-1] == "interrupted"
    assert len(rows_of(output / "results.csv")) == cells.read_bytes().count(b"\n") >= 2


def test_a_failed_cell_is_told_and_stops_no_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.log").write_text("no log\n", encoding="utf-8")
    study = tmp_path / "study.toml"
    study.write_text(
        'methods = ["odometry"]\n[[log]]\npath = "bad.log"\n[[scenario]]\nname = "one-walker"\nrate_hz = 5.0\n',
        encoding="utf-8",
    )
    assert run(study, tmp_path / "out", "--jobs", "1") == 1
    told = capsys.readouterr().err
    assert "failed: bad.log, odometry: InputError: " in told
    assert "1 of 2 cells failed" in told
    (failed,) = rows_of(tmp_path / "out" / "failed.csv")
    assert failed["world"] == "bad.log"
    assert len(rows_of(tmp_path / "out" / "results.csv")) == 1
    assert "**1 of 2 cells are finished, 1 failed" in (tmp_path / "out/report/tables.md").read_text(
        encoding="utf-8"
    )


def test_the_slurm_example_computes_the_same(tiny: Path, tmp_path: Path, environment: dict[str, str]) -> None:
    script = ROOT / "experiments" / "cluster" / "study_array.sbatch"
    for k in (1, 2):
        slurm = {"SLURM_ARRAY_TASK_ID": f"{k}", "SLURM_ARRAY_TASK_COUNT": "2", "SLURM_CPUS_PER_TASK": "1"}
        subprocess.run(
            ["bash", str(script)],
            env={**environment, **slurm, "STUDY": str(tiny), "OUTPUT": str(tmp_path / "array")},
            check=True,
            capture_output=True,
        )
    assert len(list((tmp_path / "array" / "cells").glob("part-?-of-2.jsonl"))) == 2
    assert run(tiny, tmp_path / "one", "--jobs", "1") == 0
    assert same(tmp_path / "array", tmp_path / "one")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["study", "nowhere.toml"], "nowhere.toml: cannot be read"),
        (["study", "paper", "--part", "3/2"], "--part must be I/N"),
        (["study", "paper", "--part", "all"], "--part must be I/N"),
        (["study", "paper", "--jobs", "0"], "--jobs must be at least 1"),
        (["study", "paper", "--jobs", "2", "--scheduler", "tcp://a:1"], "exclude each other"),
        (["report", "nowhere"], "nowhere: no results of a study"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert told in line


def test_damaged_results_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "results.parquet").write_bytes(b"PAR1 and no more")
    (tmp_path / "origin.json").write_text("{}", encoding="utf-8")
    assert main(["report", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "its results are damaged" in line
