"""The experiments that are sweeps of cells, in quick mode: tables and figures come out."""

import importlib
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from matplotlib import image

from experiments import (
    ablation,
    common,
    ladder,
    moving_points,
    noise_sweep,
    paper,
    paper_claim,
    paper_judge,
    paper_search,
    tracking,
    walking_along,
)
from slammot_graph.methods import METHODS
from slammot_graph.study.cells import Outcome
from slammot_graph.study.plan import plan
from slammot_graph.study.results import write_results
from slammot_graph.study.store import CellStore
from slammot_graph.study.study_file import read_study


def quick(name: str, output: Path, methods: Sequence[str], *more: str) -> str:
    """Run a script's quick mode in this process, and give its table's file."""
    module = importlib.import_module(f"experiments.{name}")
    arguments = ["--quick", *more, "--jobs", "1", "--output", str(output)]
    assert common.main(module.experiment, arguments) == 0
    text = (output / "tables" / f"{name}.md").read_text(encoding="utf-8")
    assert "Quick mode" in text
    assert f"python -m experiments.{name} {' '.join(['--quick', *more])} --jobs 1`" in text
    assert "nan" not in text.lower()
    assert [method for method in methods if method not in text] == []
    assert_rectangular(text)
    results = (output / "results" / f"{name}.jsonl").read_text(encoding="utf-8")
    assert len(results.splitlines()) > 1
    return text


def assert_rectangular(text: str) -> None:
    """All rows of a Markdown table have as many cells as its head."""
    for block in text.split("\n\n"):
        lines = [line for line in block.splitlines() if line.startswith("|")]
        assert len({line.count("|") for line in lines}) <= 1, block


def assert_drawn(path: Path) -> None:
    """A PNG with dark, light and coloured pixels on it."""
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    pixels = image.imread(path)[:, :, :3]
    assert min(pixels.shape[:2]) > 200
    assert pixels.min() < 0.3
    assert pixels.max() > 0.95
    assert np.mean(np.ptp(pixels, axis=2) > 0.2) > 0.001


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of dask.distributed, in threads of its own
def test_ablation(tmp_path: Path) -> None:
    """Killed in the middle and gone on, by Dask, by one worker and by two: the same results."""
    pytest.importorskip("distributed")
    text = quick("ablation", tmp_path, tuple(METHODS), "--seeds", "1")
    rows = [line.strip("| ").split(" | ") for line in text.splitlines()]
    assert [row[-1] for row in rows if row[0].startswith(("Dask", "turn"))] == ["yes"] * 3
    assert [[row[0] for row in rows].count(method) for method in METHODS] == [1] * len(METHODS)
    (n_kept,) = re.findall(r"with (\d+) cells, gone on", " ".join(text.split()))
    assert len(METHODS) // 2 <= int(n_kept) < len(METHODS)


def test_a_result_that_differs_is_told(tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text('methods = ["graph", "odometry"]\n[[scenario]]\nname = "one-walker"\n', encoding="utf-8")
    rows = plan(read_study(study), tmp_path)
    whole, folder = tmp_path / "whole", tmp_path / "part"
    store = CellStore(whole / "cells")
    with store.writing():
        for k, row in enumerate(rows):
            store.write(Outcome(cell=row.cell, scores={"ate_m": 0.1 * k}))
    part = ablation.Part(name="turn 1", way="1", n_seeds=1, study=study, folder=folder)
    for error, is_same in ((0.0, True), (1e-17, False)):
        folder.mkdir(exist_ok=True)
        scores = [{"ate_m": 0.1 * k + error} for k in range(2)]
        records = {
            row.cell.digest: {"scores": one, "seconds": 1.0, "host": ""}
            for row, one in zip(rows, scores, strict=True)
        }
        write_results(folder, rows, records, {}, {})
        assert ablation.is_same(part, whole) == is_same


@pytest.mark.real
def test_any_robot(tmp_path: Path, recorded_data: Path) -> None:
    if not (recorded_data / "freiburg" / "fr079.clf.bz2").is_file():
        pytest.skip("recorded logs are not here")
    text = quick("any_robot", tmp_path, ("wheels", "laser alone"))
    assert text.count("| fr079 |") == 2


def test_beam_times(tmp_path: Path) -> None:
    text = quick("beam_times", tmp_path, ("as told", "as found"), "--seeds", "1")
    assert "| fast-turns | none |" in text


def test_riding_along(tmp_path: Path) -> None:
    text = quick("riding_along", tmp_path, ("wheels", "laser alone"), "--seeds", "1")
    assert text.count("| lab | half covered |") == 2


def test_tracking(tmp_path: Path) -> None:
    text = quick("tracking", tmp_path, tuple(tracking.TRACKERS), "--seeds", "1")
    assert "one-walker: what each part gives" in text


def test_paper_claim(tmp_path: Path) -> None:
    text = quick("paper_claim", tmp_path, paper_claim.METHODS)
    assert "## crossing, 2" in text
    assert_drawn(tmp_path / "figures" / "paper_claim.png")


def test_paper_search(tmp_path: Path) -> None:
    text = quick("paper_search", tmp_path, paper_search.METHODS)
    assert text.count("| rejection: share of the pairs that is kept |") == 5


def test_paper_judge(tmp_path: Path) -> None:
    text = quick("paper_judge", tmp_path, paper_judge.METHODS)
    assert text.count("| one-walker |") == 2  # at two noises


def test_ladder(tmp_path: Path) -> None:
    text = quick("ladder", tmp_path, [preset.name for preset in ladder.presets()], "--seeds", "1")
    assert "one-walker, 1 seeds" in text


@pytest.mark.parametrize(
    ("name", "methods"),
    [
        ("noise_sweep", noise_sweep.METHODS),
        ("paper_map_and_ellipses", paper.METHODS),
        ("paper_one_walker", paper.METHODS),
        ("paper_two_walkers", paper.METHODS),
    ],
)
def test_tables_with_a_figure(name: str, methods: Sequence[str], tmp_path: Path) -> None:
    text = quick(name, tmp_path, methods, "--seeds", "1")
    assert f"figures/{name}.png" in text
    assert_drawn(tmp_path / "figures" / f"{name}.png")


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "methods"),
    [("moving_points", moving_points.METHODS), ("walking_along", walking_along.METHODS)],
)
def test_tables_of_recorded_logs(
    name: str, methods: Sequence[str], tmp_path: Path, recorded_data: Path
) -> None:
    if not (recorded_data / "freiburg" / "intel.clf.bz2").is_file():
        pytest.skip(f"no intel log in {recorded_data}")
    text = quick(name, tmp_path, methods)
    assert "intel" in text
    assert "aces:" not in text


@pytest.mark.parametrize("script", [noise_sweep, paper_claim])
def test_full_grids_are_made_of_cells_of_their_own(
    script: object, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Every cell of the full sweep has a key and fits what computes it; nothing is run."""
    asked: list[dict[str, object]] = []

    class StopError(Exception):
        pass

    def stop(name: str, function, cells, options) -> None:  # type: ignore[no-untyped-def]
        asked.extend(cells.values())
        raise StopError

    monkeypatch.setattr(script, "run_cells", stop)
    with pytest.raises(StopError):
        script.experiment(common.Options(output=tmp_path))  # type: ignore[attr-defined]
    unlike = {tuple(cell.items()) for cell in asked}
    assert len(unlike) == len(asked) > 100


def test_noise_sweep_ranks_the_methods() -> None:
    medians = {"graph": 0.2, "odometry": float("nan"), "icp": 0.1, "docpfo": 0.1, "kiss-icp": 0.3}
    assert noise_sweep.ranking(medians) == ["icp", "docpfo", "graph", "kiss-icp", "odometry"]
    assert noise_sweep.best_baseline({**medians, "kiss-icp-odometry": 0.05}) == "kiss-icp-odometry"


def test_noise_sweep_says_who_is_best_where(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def made(name, function, cells, options):  # type: ignore[no-untyped-def]
        return {key: {"ate_m": made_up(**cell)} for key, cell in cells.items()}

    def made_up(noise: float, people: int, seed: int, method: str, **_: object) -> float:
        own = {"graph": 0.05, "odometry": 0.1 * noise, "kiss-icp": 0.02 * people}.get(method, 1.0)
        return own + 0.001 * seed

    monkeypatch.setattr(noise_sweep, "run_cells", made)
    noise_sweep.experiment(common.Options(output=tmp_path))
    text = (tmp_path / "tables" / "noise_sweep.md").read_text(encoding="utf-8")
    winners, against = text.split("## ")[1:3]
    rows = {line.split(" | ")[0]: line.strip("| ").split(" | ") for line in winners.splitlines()}
    assert [cell.split()[0] for cell in rows["| 0"]] == ["0", *["odometry"] * 5]
    assert rows["| 4"][1:3] == ["kiss-icp 0.0020 (graph 0.0520)", "kiss-icp 0.0220 (graph 0.0520)"]
    assert rows["| 4"][3] == "**graph 0.0520** (kiss-icp 0.0620)"
    assert "-0.0100 [-0.0100, -0.0100], 5 of 5 (kiss-icp)" in against
    assert "graph has the least median in 12 of 25 fields" in text
    assert_rectangular(text)
    assert_drawn(tmp_path / "figures" / "noise_sweep.png")
