"""`merge` and `edit`: saved maps without a log."""

from pathlib import Path

import numpy as np
import pytest

from slammot_graph import SavedMap, load_run
from slammot_graph.run_folder.map_files import read_map
from slammot_graph.run_folder.tum import read_trajectory, write_trajectory
from tests.cli.test_cli import run
from tests.saved_maps.two_halves import errors_m, half, half_map, true_poses


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k in (0, 1):
        path = tmp_path / f"run{k}"
        path.mkdir()
        (path / "map.slam").write_bytes(half_map(k).to_bytes())
        write_trajectory(path / "trajectory.tum", half(k).stamps, half(k).T_map_base)
    return tmp_path


def test_merge_writes_one_map_of_two_runs(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    code, out, err = run(capsys, "merge", folder / "run0", folder / "run1", "--output", folder / "both")
    assert code == 0, err
    assert {path.name for path in (folder / "both").iterdir()} == {
        *("map.slam", "map.pgm", "map.yaml", "graph.g2o", "trajectory.tum", "closures.csv")
    }
    assert "run 1 - run 2" in out
    both = SavedMap.load(folder / "both")
    assert [one.first_scan for one in both.runs] == [0, len(half(0).stamps)]
    stamps, poses = read_trajectory(folder / "both" / "trajectory.tum")
    assert len(stamps) == len(half(0).stamps) + len(half(1).stamps)
    assert errors_m(poses, np.vstack([true_poses(0), true_poses(1)])).max() < 0.08
    rows = (folder / "both" / "closures.csv").read_text().splitlines()
    assert rows[0].startswith("from_run,to_run,from_node")
    assert len(rows) > 8
    whole = read_map(folder / "both" / "map.yaml").p_occupied
    assert np.nansum(whole) > 500
    load_run(folder / "both")


def test_a_merged_map_is_edited(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    run(capsys, "merge", folder / "run0", folder / "run1", "--output", folder / "both")
    both = SavedMap.load(folder / "both")
    edge = next(edge for edge in both.edges if edge.kind == "closure")
    words = ["--reject-closure", f"{edge.from_node}-{edge.to_node}", "--erase", 4, -2, 6, 0, 0, 0, 1, 1]
    code, out, err = run(capsys, "edit", folder / "both", "--output", folder / "edited", *words)
    assert code == 0, err
    edited = SavedMap.load(folder / "edited")
    assert edited.edits == (
        f"reject-closure {edge.from_node}-{edge.to_node}",
        "erase 4 -2 6 0",
        "erase 0 0 1 1",
    )
    assert len(edited.edges) == len(both.edges) - 1
    before, after = (read_trajectory(folder / name / "trajectory.tum")[1] for name in ("both", "edited"))
    assert before.shape == after.shape
    assert "2 runs" in out
    code, _, err = run(capsys, "edit", folder / "both", "--output", folder / "edited", *words)
    assert code == 2
    assert "--overwrite" in err


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["merge", "run0"], "two runs at least"),
        (["merge", "run0", "nowhere"], "nowhere: cannot be read"),
        (["edit", "run0"], "nothing to do"),
        (["edit", "run0", "--reject-closure", "1:2"], "--reject-closure 1:2: must be two numbers"),
        (["edit", "run0", "--add-closure", "0-123456"], "node 123456"),
        (["edit", "run0", "--erase", "0", "0", "0", "1"], "no rectangle"),
    ],
)
def test_mistakes_are_told_in_one_line(
    capsys: pytest.CaptureFixture[str], folder: Path, words: list[str], text: str
) -> None:
    given = [str(folder / word) if word.startswith(("run", "nowhere")) else word for word in words]
    code, _, err = run(capsys, *given, "--output", folder / "out")
    assert code == 2
    assert text in err
    assert len(err.strip().splitlines()) == 1
    assert not (folder / "out").exists()


def test_what_is_read_is_not_written_over(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    words = ["--output", folder / "run1", "--overwrite"]
    code, _, err = run(capsys, "merge", folder / "run0", folder / "run1", *words)
    assert code == 2
    assert "is also read" in err
    (folder / "run1" / "trajectory.tum").write_text("0 0 0 0 0 0 0 1\n")
    code, _, err = run(capsys, "merge", folder / "run0", folder / "run1", "--output", folder / "out")
    assert code == 2
    assert "were files of two runs mixed?" in err
