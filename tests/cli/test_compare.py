import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from slammot_graph import cli
from slammot_graph.logs import write_npz_log
from tests.cli.test_cli import assert_one_line, run
from tests.viz.rerun.recordings import entries
from tests.walkers import write_walkers

N_SCANS = 40


@pytest.fixture(autouse=True, scope="module")
def strict() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_walkers(tmp_path_factory.mktemp("log") / "walkers.npz", N_SCANS)


@pytest.fixture(scope="module")
def runs(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    for method in ("graph", "odometry"):
        words = ["run", str(log), "--output", str(folder / method), "--method", method, "--rerun", "off"]
        assert cli.main(words) == 0
    return folder


@pytest.fixture
def copies(runs: Path, tmp_path: Path) -> Path:
    shutil.copytree(runs, tmp_path / "runs")
    return tmp_path / "runs"


def cells(out: str) -> dict[str, list[str]]:
    """Rows of a table by their first cell."""
    rows = [[cell.strip() for cell in line.split("│")[1:-1]] for line in out.splitlines() if "│" in line]
    return {row[0]: row[1:] for row in rows}


def test_runs_are_put_side_by_side(
    capsys: pytest.CaptureFixture[str], runs: Path, log: Path, tmp_path: Path
) -> None:
    from rerun.chunk import RrdReader

    output = tmp_path / "deep" / "both.rrd"
    relations = tmp_path / "my.relations"
    relations.write_text("0.0 2.0 0.5 0 0 0 0 0\n0.0 99 1 0 0 0 0 0\n")
    code, out, err = run(
        capsys,
        *("compare", runs / "graph", runs / "odometry", "--output", output),
        *("--truth", log, "--relations", relations),
    )
    assert (code, err) == (0, "")
    assert f"slammot-graph view {output}" in out
    assert f"against the true poses in {log.name}" in out
    rows = cells(out)
    assert list(rows) == ["graph", "odometry"]
    assert [len(row) for row in rows.values()] == [8, 8]
    assert rows["graph"][0] == str(N_SCANS)
    assert 0.0 < float(rows["graph"][4]) < float(rows["odometry"][4]) < 0.5
    assert float(rows["graph"][5]) > 0.0
    assert float(rows["graph"][7]) < float(rows["odometry"][7]) < 0.3

    assert [path.name for path in output.parent.iterdir()] == ["both.rrd"]
    reader = RrdReader(output)
    assert len(reader.recordings()) == len(reader.blueprints()) == 1
    shown = {str(chunk.entity_path): chunk.is_static for chunk in reader.stream()}
    assert "/world/truth" in shown
    for name in ("graph", "odometry"):
        for below in ("map", "path", "robot", "moving"):
            assert f"/world/runs/{name}/{below}" in shown
        for plot in ("truth_m", "truth_deg", "distance_m", "turn_deg", "moving", "position_std_m"):
            assert f"/plots/{plot}/{name}" in shown
    found = entries(output, "/world/runs/graph/moving", "Points3D:positions")
    with np.load(runs / "graph" / "points.npz") as file:
        n_moving = (file["is_moving"] & file["is_valid"]).sum(axis=1)
    assert n_moving.sum() > 20
    assert [len(found[row]) for row in range(N_SCANS)] == n_moving.tolist()
    distances = entries(output, "/plots/distance_m/odometry", "Scalars:scalars")
    assert distances[0] == pytest.approx([0.0], abs=1e-6)


def set_log(folder: Path, log: object) -> None:
    path = folder / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "log": log}))


def test_a_simulated_log_is_the_truth_without_being_named(
    capsys: pytest.CaptureFixture[str], runs: Path, log: Path
) -> None:
    """A bad run may come first: nobody is judged by it."""
    plain = run(capsys, "compare", runs / "odometry", runs / "graph", "--rerun", "off")
    named = run(capsys, "compare", runs / "odometry", runs / "graph", "--rerun", "off", "--truth", log)
    assert plain == named
    assert "from the truth, rms [m]" in plain[1]
    rows = cells(plain[1])
    assert float(rows["graph"][4]) < float(rows["odometry"][4])


def test_poses_that_are_no_truth_are_not_taken_for_it(
    capsys: pytest.CaptureFixture[str], copies: Path, log: Path, tmp_path: Path
) -> None:
    with np.load(log) as file:
        arrays = dict(file)
    later = {**arrays, "stamps": arrays["stamps"] + 9.0}
    write_npz_log(tmp_path / "injected.npz", **arrays, poses_are_estimates=True)
    write_npz_log(tmp_path / "other.npz", **later)
    (tmp_path / "broken.npz").write_text("no log")
    for name in ("injected.npz", "other.npz", "broken.npz", "gone.npz"):
        for method in ("graph", "odometry"):
            set_log(copies / method, str(tmp_path / name))
        code, out, err = run(capsys, "compare", copies / "graph", copies / "odometry", "--rerun", "off")
        assert (code, err) == (0, "")
        assert "from the first, rms [m]" in out
        assert [len(row) for row in cells(out).values()] == [5, 5]


def test_other_programs_folders_start_where_the_first_run_does(
    capsys: pytest.CaptureFixture[str], copies: Path, tmp_path: Path
) -> None:
    """A bare trajectory in a frame of its own: turned by a right angle and moved."""
    lines = []
    for line in (copies / "graph" / "trajectory.tum").read_text().splitlines():
        stamp, x, y, *_, qz, qw = map(float, line.split())
        yaw = 2.0 * np.arctan2(qz, qw) + 0.5 * np.pi
        quaternion = f"{np.sin(yaw / 2):.9f} {np.cos(yaw / 2):.9f}"
        lines.append(f"{stamp:.6f} {5.0 - y:.9f} {7.0 + x:.9f} 0 0 0 {quaternion}\n")
    set_log(copies / "graph", None)
    (copies / "their slam").mkdir()
    (copies / "their slam" / "trajectory.tum").write_text("".join(lines[: N_SCANS - 10]))
    code, out, err = run(
        capsys,
        *("compare", copies / "graph", copies / "their slam", "--output", tmp_path / "both.rrd"),
    )
    assert (code, err) == (0, "")
    assert cells(out)["their slam"] == [str(N_SCANS - 10), "-", "-", "-", "0.0000"]
    translation = entries(tmp_path / "both.rrd", "/world/runs/their\\ slam/robot", "Transform3D:translation")
    assert len(translation) == N_SCANS - 10


def test_without_the_log_the_moving_points_are_left_out(
    capsys: pytest.CaptureFixture[str], copies: Path, tmp_path: Path
) -> None:
    set_log(copies / "graph", str(tmp_path / "gone.npz"))
    code, _, err = run(
        capsys, "compare", copies / "graph", copies / "odometry", "--output", tmp_path / "both.rrd"
    )
    assert code == 0
    assert err.startswith("warning: no moving points of graph: ")
    assert "gone.npz" in err
    assert err.count("\n") == 1


def test_a_table_alone(capsys: pytest.CaptureFixture[str], copies: Path, tmp_path: Path) -> None:
    (copies / "odometry").rename(copies / "wheels")
    shutil.copytree(copies / "wheels", copies / "again")
    before = sorted(tmp_path.rglob("*.rrd"))
    code, out, _ = run(
        capsys, "compare", copies / "graph", copies / "wheels", copies / "again", "--rerun", "off"
    )
    assert code == 0
    assert list(cells(out)) == ["graph", "wheels", "again"]  # the methods are equal: by their folders
    assert sorted(tmp_path.rglob("*.rrd")) == before


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ([], ["at least two"]),
        (["graph"], ["at least two"]),
        (["graph", "none"], ["none: no such run folder"]),
        (["graph", "empty"], ["empty/trajectory.tum", "cannot be read"]),
        (["graph", "./graph"], ["graph: is named twice"]),
        (["graph", "late"], ["graph and late: their scans have different times"]),
        (["graph", "odometry", "--output", "out.rec"], ["out.rec", ".rrd"]),
        (["graph", "odometry", "--output", "folder.rrd"], ["folder.rrd", "is no plain file"]),
        (["graph", "odometry", "--relations", "none.relations"], ["none.relations", "cannot be read"]),
        (["graph", "odometry", "--relations", "other.relations"], ["none of its 1 relations", "graph/traj"]),
        (["graph", "odometry", "--truth", "none.npz"], ["none.npz", "no such file"]),
        (["graph", "odometry", "--truth", "blind.npz"], ["blind.npz", "`poses`"]),
        (["graph", "odometry", "--truth", "short.npz"], ["short.npz", "other times than those of graph"]),
    ],
)
def test_a_mistake_is_one_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    copies: Path,
    log: Path,
    arguments: list[str],
    parts: list[str],
) -> None:
    monkeypatch.chdir(copies)
    Path("empty").mkdir()
    Path("folder.rrd").mkdir()
    Path("late").mkdir()
    lines = Path("graph/trajectory.tum").read_text().splitlines(keepends=True)
    later = [f"{float(line.split()[0]) + 0.05:.9f} {line.split(maxsplit=1)[1]}" for line in lines]
    Path("late/trajectory.tum").write_text("".join(later))
    Path("other.relations").write_text("901 902 0 0 0 0 0 0\n")
    with np.load(log) as file:
        arrays = dict(file)
    write_npz_log("blind.npz", **{key: value for key, value in arrays.items() if key != "poses"})
    per_scan = ("stamps", "ranges", "odometry", "poses", "is_moving", "object_id", "objects")
    write_npz_log(
        "short.npz", **{key: value[:9] if key in per_scan else value for key, value in arrays.items()}
    )
    code, out, err = run(capsys, "compare", *arguments)
    assert (code, out) == (2, "")
    assert_one_line(err, *parts)
    assert not [path for path in Path.cwd().iterdir() if path.suffix == ".rrd" and path.is_file()]
    assert not list(Path.cwd().glob(".*.tmp"))
