from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slammot_graph import cli
from slammot_graph.logs import open_log, source_of, write_npz_log
from slammot_graph.run_folder.tum import read_trajectory
from slammot_graph.simulation import simulate
from tests.cli.test_cli import assert_one_line, run

N_SCANS = 60


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log without people, the truth left out as in a recorded one."""
    path = tmp_path_factory.mktemp("log") / "recorded [1].npz"
    arrays = simulate("two-walkers", seed=3, n_people=0).arrays()
    kept = {
        key: value
        for key, value in arrays.items()
        if key not in ("poses", "is_moving", "object_id", "objects")
    }
    for key in ("stamps", "ranges", "odometry"):
        kept[key] = kept[key][:N_SCANS]
    kept["ranges"][5, :7] = [np.nan, np.inf, 0.0, -1.0, 81.83, 0.05, 1e9]
    write_npz_log(path, **kept)
    return path


@pytest.fixture(scope="module")
def reference(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "graph"
    assert cli.main(["run", str(log), "--output", str(folder), "--rerun", "off"]) == 0
    return folder


def arrays_of(path: Path) -> dict[str, Any]:
    with np.load(path) as file:
        return {key: file[key] for key in file.files}


def assert_equal_logs(a: Path, b: Path) -> None:
    first, second = arrays_of(a), arrays_of(b)
    assert first.keys() == second.keys()
    for key, value in first.items():
        np.testing.assert_array_equal(value, second[key], err_msg=key)


def test_people_are_injected_with_exact_labels(
    capsys: pytest.CaptureFixture[str], log: Path, reference: Path, tmp_path: Path
) -> None:
    output = tmp_path / "deep" / "people.npz"
    arguments = ("inject", log, "--people", 2, "--seed", 4, "--output", output, "--reference", reference)
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (0, "")
    assert [path.name for path in output.parent.iterdir()] == ["people.npz"]
    before, scans = list(open_log(log)), list(open_log(output))
    assert len(scans) == N_SCANS
    was = np.array([scan.ranges for scan in before])
    ranges = np.array([scan.ranges for scan in scans])
    is_moving = np.array([scan.truth.is_moving for scan in scans])  # type: ignore[union-attr]
    object_id = np.array([scan.truth.object_id for scan in scans])  # type: ignore[union-attr]
    assert is_moving.sum() > 50
    np.testing.assert_array_equal(ranges[~is_moving], was[~is_moving])
    has_return = is_moving & np.isfinite(was) & (was > 0.0)
    assert (ranges[has_return] <= was[has_return]).all()
    assert (ranges[has_return] < was[has_return] - 0.05).mean() > 0.95
    np.testing.assert_array_equal(object_id >= 0, is_moving)
    assert set(np.unique(object_id)) <= {-1, 0, 1}
    for a, b in zip(before, scans, strict=True):
        assert (a.stamp, a.laser) == (b.stamp, b.laser)
        np.testing.assert_array_equal(a.T_odom_base, b.T_odom_base)
    poses = np.array([scan.truth.T_world_base for scan in scans])  # type: ignore[union-attr]
    np.testing.assert_array_equal(poses, read_trajectory(reference / "trajectory.tum")[1])
    n_valid = sum(int(scan.is_valid().sum()) for scan in scans)
    n_seen = len(np.unique(object_id[is_moving]))
    assert err == (
        f"recorded [1].npz with seed 4 is in {output}: 60 scans, 2 people, {n_seen} of them seen,"
        f" {is_moving.sum() / n_valid:.1%} of the valid beams on them\n"
    )


def test_the_same_seed_gives_the_same_log(
    capsys: pytest.CaptureFixture[str], log: Path, reference: Path, tmp_path: Path
) -> None:
    for name, seed in (("a", 4), ("b", 4), ("c", 5)):
        arguments = ("inject", log, "--people", 2, "--seed", seed, "--reference", reference)
        assert run(capsys, *arguments, "--output", tmp_path / f"{name}.npz")[0] == 0
    assert_equal_logs(tmp_path / "a.npz", tmp_path / "b.npz")
    first, other = arrays_of(tmp_path / "a.npz"), arrays_of(tmp_path / "c.npz")
    assert not np.array_equal(first["is_moving"], other["is_moving"])


def test_without_a_reference_graph_is_run(
    capsys: pytest.CaptureFixture[str], log: Path, reference: Path, tmp_path: Path
) -> None:
    a, b = tmp_path / "a.npz", tmp_path / "b.npz"
    code, _, err = run(capsys, "inject", log, "--people", 1, "--output", a)
    assert code == 0
    lines = err.splitlines()
    assert lines[0] == "graph on recorded [1].npz: 60 scans"
    assert lines[1].startswith("graph on recorded [1].npz: 60 scans in ")
    assert run(capsys, "inject", log, "--people", 1, "--output", b, "--reference", reference)[0] == 0
    np.testing.assert_allclose(arrays_of(a)["poses"], arrays_of(b)["poses"], atol=1e-8)


def test_the_first_scans_may_be_taken(
    capsys: pytest.CaptureFixture[str], log: Path, reference: Path, tmp_path: Path
) -> None:
    arguments = ("inject", log, "--people", 2, "--max-scans", 20, "--output", tmp_path / "a.npz")
    code, _, err = run(capsys, *arguments)
    assert code == 0
    assert err.splitlines()[0] == "graph on recorded [1].npz: 20 scans"
    assert err.splitlines()[1].startswith("graph on recorded [1].npz: 20 scans in ")
    assert len(arrays_of(tmp_path / "a.npz")["stamps"]) == 20
    # of a run over the whole log the first poses are taken; more scans than there are is all of them
    assert run(capsys, *arguments, "--reference", reference)[0] == 0
    assert len(arrays_of(tmp_path / "a.npz")["stamps"]) == 20
    arguments = ("inject", log, "--people", 0, "--max-scans", 500, "--output", tmp_path / "a.npz")
    assert run(capsys, *arguments)[0] == 0
    assert len(arrays_of(tmp_path / "a.npz")["stamps"]) == N_SCANS


def test_the_laser_may_be_placed_by_hand_and_the_poses_are_called_estimates(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    output = tmp_path / "a.npz"
    arguments = ("inject", log, "--people", 0, "--max-scans", 30, "--output", output)
    assert run(capsys, *arguments, "--laser-pose", 0.1, -0.02, 0)[0] == 0
    assert arrays_of(output)["laser_pose"].tolist() == [0.1, -0.02, 0.0]
    assert source_of(open_log(output))["poses"] == "estimates"


def test_nobody_leaves_the_log_as_it_is(
    capsys: pytest.CaptureFixture[str], log: Path, reference: Path, tmp_path: Path
) -> None:
    output = tmp_path / "people.npz"
    output.write_text("an older file, to be replaced")
    arguments = ("inject", log, "--people", 0, "--output", output, "--reference", reference)
    code, _, err = run(capsys, *arguments)
    assert code == 0
    assert "0 people, 0 of them seen, 0.0% of the valid beams" in err
    made, recorded = arrays_of(output), arrays_of(log)
    for key, value in recorded.items():
        np.testing.assert_array_equal(made[key], value, err_msg=key)
    assert not made["is_moving"].any()
    assert (made["object_id"] == -1).all()


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"LOG": "none.clf"}, ["none.clf", "no such file"]),
        ({"LOG": "bad.clf"}, ["bad.clf"]),
        ({"--people": "-1"}, ["--people", "at least 0", "-1"]),
        ({"--seed": "-3"}, ["--seed", "at least 0", "-3"]),
        ({"--max-scans": "0"}, ["--max-scans", "at least 1", "0"]),
        ({"--output": "out.clf"}, ["out.clf", "must end in .npz"]),
        ({"--output": "out"}, ["out: ", "must end in .npz"]),
        ({"--output": "LOG"}, ["is the recorded log itself", "--output"]),
        ({"--output": "folder.npz"}, ["folder.npz", "is no plain file"]),
        ({"--output": "bad.clf/out.npz"}, ["bad.clf"]),
        ({"--reference": "none"}, ["none/trajectory.tum", "cannot be read"]),
        ({"--reference": "bad.clf"}, ["bad.clf/trajectory.tum", "cannot be read"]),
        ({"--reference": "empty"}, ["the reference trajectory has 0 poses", "60 usable scans"]),
        ({"--reference": "short"}, ["the reference trajectory has 59 poses", "60 usable scans"]),
        ({"--reference": "short", "--max-scans": "60"}, ["has 59 poses", "60 usable scans"]),
        ({"--reference": "long"}, ["has 61 poses", "60 usable scans"]),
        ({"--reference": "late"}, ["late: its scans have other times", "recorded [1].npz"]),
        ({"--reference": "late", "--max-scans": "20"}, ["late: its scans have other times"]),
        ({"--reference": "damaged"}, ["trajectory.tum, line 2"]),
        ({"--scan-topic": "/scan"}, ["--scan-topic"]),
    ],
)
def test_a_mistake_is_one_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    log: Path,
    reference: Path,
    tmp_path: Path,
    changes: dict[str, str],
    parts: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("folder.npz").mkdir()
    Path("bad.clf").write_text("no log\n")
    lines = (reference / "trajectory.tum").read_text().splitlines(keepends=True)
    later = [f"{float(line.split()[0]) + 0.05:.9f} {line.split(maxsplit=1)[1]}" for line in lines]
    for name, content in {
        "empty": [],
        "short": lines[:-1],
        "long": [*lines, lines[-1]],
        "late": later,
        "damaged": [lines[0], "0 0\n"],
    }.items():
        Path(name).mkdir()
        (Path(name) / "trajectory.tum").write_text("".join(content))
    before = log.read_bytes()
    options = {"LOG": str(log), "--people": "2", "--output": "out.npz", "--reference": str(reference)}
    options |= {key: str(log) if value == "LOG" else value for key, value in changes.items()}
    words = [word for key, value in options.items() if key != "LOG" for word in (key, value)]
    code, out, err = run(capsys, "inject", options["LOG"], *words)
    assert (code, out) == (2, "")
    assert_one_line(err, *parts)
    assert not list(tmp_path.glob("**/*out*"))
    assert log.read_bytes() == before


def test_a_log_without_usable_scans_is_refused(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    arrays = arrays_of(log)
    arrays["ranges"][:] = np.nan
    write_npz_log(tmp_path / "blind.npz", **arrays)
    (tmp_path / "trajectory.tum").write_text("")
    arguments = ("inject", tmp_path / "blind.npz", "--people", 1, "--output", tmp_path / "out.npz")
    for more in ((), ("--reference", tmp_path)):
        code, _, err = run(capsys, *arguments, *more)
        assert code == 2
        assert_one_line(err.splitlines(keepends=True)[-1], "blind.npz: none of its 60 scans is usable")
        assert not (tmp_path / "out.npz").exists()


def test_a_write_that_fails_leaves_the_older_file(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    log: Path,
    reference: Path,
    tmp_path: Path,
) -> None:
    def fail(file: object, **_: object) -> None:
        file.write(b"half")  # type: ignore[attr-defined]
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", fail)
    output = tmp_path / "people.npz"
    output.write_text("older")
    arguments = ("inject", log, "--people", 1, "--output", output, "--reference", reference)
    code, _, err = run(capsys, *arguments)
    assert code == 2
    assert_one_line(err, "people.npz", "No space left on device")
    assert [path.name for path in tmp_path.iterdir()] == ["people.npz"]
    assert output.read_text() == "older"


def test_it_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "--help")
    assert code == 0
    assert "inject" in out
