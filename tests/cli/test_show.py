import json
import shutil
import stat
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL.GifImagePlugin import GifImageFile

from slammot_graph import cli
from slammot_graph.logs import write_npz_log
from slammot_graph.simulation import simulate
from slammot_graph.viz.rerun import primitives
from tests.cli.test_cli import assert_one_line, run

N_SCANS = 40
RED = (0xE3, 0x34, 0x2F)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "walkers.npz"
    arrays = simulate("two-walkers", seed=0).arrays()
    for key in ("stamps", "ranges", "odometry"):
        arrays[key] = arrays[key][:N_SCANS]
    for key in ("poses", "is_moving", "object_id", "objects"):
        del arrays[key]
    write_npz_log(path, **arrays)
    return path


@pytest.fixture(scope="module")
def graph(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "graph"
    assert cli.main(["run", str(log), "--output", str(folder), "--rerun", "off"]) == 0
    return folder


@pytest.fixture
def folder(graph: Path, tmp_path: Path) -> Path:
    return shutil.copytree(graph, tmp_path / "graph")


def script(path: Path, text: str) -> Path:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def set_log(folder: Path, log: object) -> None:
    path = folder / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "log": log}))


# ---------------------------------------------------------------------------------------------------- view


def test_the_recording_is_opened_in_the_viewer(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    viewer = script(tmp_path / "rerun", f'echo "$@" > {tmp_path}/opened')
    monkeypatch.setattr(primitives, "viewer_executable", lambda: viewer)
    recording = tmp_path / "a run" / "run.rrd"
    recording.parent.mkdir()
    recording.write_bytes(b"RRF2")
    for what in (recording.parent, recording):
        assert run(capsys, "view", what) == (0, "", "")
        assert (tmp_path / "opened").read_text() == f"{recording}\n"
        (tmp_path / "opened").unlink()


def test_the_viewer_is_that_of_the_environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.executable", str(tmp_path / "bin" / "python"))
    monkeypatch.setenv("PATH", str(tmp_path / "path"))
    assert primitives.viewer_executable() is None
    for name in ("path", "bin"):
        (tmp_path / name).mkdir()
        viewer = script(tmp_path / name / "rerun", "true")
        assert primitives.viewer_executable() == viewer


def test_what_cannot_be_viewed_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    recording = tmp_path / "other.rrd"
    for what, parts in (
        (folder, ["run.rrd: no such recording", "run it again without --rerun off"]),
        (tmp_path / "none", ["none: no such run folder"]),
        (recording, ["other.rrd: no such run folder or recording"]),
    ):
        code, out, err = run(capsys, "view", what)
        assert (code, out) == (2, "")
        assert_one_line(err, *parts)
    recording.write_bytes(b"RRF2")
    monkeypatch.setattr(primitives, "viewer_executable", lambda: None)
    code, _, err = run(capsys, "view", recording)
    assert code == 2
    assert_one_line(err, "no rerun viewer", "pip install rerun-sdk")


def test_a_viewer_that_fails_is_one_line(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    viewer = script(tmp_path / "rerun", "echo a word; echo an INFO >&2; exit 3")
    monkeypatch.setattr(primitives, "viewer_executable", lambda: viewer)
    recording = tmp_path / "a run" / "run.rrd"
    recording.parent.mkdir()
    recording.write_bytes(b"RRF2")
    code, out, err = run(capfd, "view", recording.parent)
    assert (code, out) == (2, "")
    assert_one_line(err, f"{recording}: ", "code 3", "copy run.rrd to a machine with a display")
    assert err.endswith(f"slammot-graph animate '{recording.parent}' --output run.gif\n")
    code, out, err = run(capfd, "view", recording)
    assert (code, out) == (2, "")
    assert err.endswith("copy run.rrd to a machine with a display\n")


# -------------------------------------------------------------------------------------------------- animate


def test_a_run_becomes_a_gif(
    capsys: pytest.CaptureFixture[str], folder: Path, log: Path, tmp_path: Path
) -> None:
    output = tmp_path / "deep" / "run.gif"
    code, out, err = run(capsys, "animate", folder, "--output", output, "--every", 4, "--fps", 5)
    assert (code, out) == (0, "")
    lines = err.splitlines()
    assert lines[0] == f"run.gif of {folder}: 10 frames"
    assert lines[-1].startswith(f"{output}: 10 frames, 0.")
    assert [path.name for path in output.parent.iterdir()] == ["run.gif"]
    with np.load(folder / "points.npz") as file:
        n_moving = (file["is_moving"] & file["is_valid"]).sum(axis=1)[::4]
    with GifImageFile(output) as image:
        assert (image.format, image.n_frames) == ("GIF", 10)
        assert image.info["duration"] == 200
        assert image.info["loop"] == 0
        n_red = []
        for number in range(10):
            image.seek(number)
            pixels = np.asarray(image.convert("RGB"))
            n_red.append(int((pixels == RED).all(axis=2).sum()))
    assert min(pixels.shape[:2]) > 300
    assert n_moving.max() > 3 * n_moving.min()
    assert n_red[np.argmax(n_moving)] > 2 * n_red[np.argmin(n_moving)] > 0


def test_some_scans_of_a_log_that_has_moved(
    capsys: pytest.CaptureFixture[str], folder: Path, log: Path, tmp_path: Path
) -> None:
    set_log(folder, str(tmp_path / "gone.npz"))
    (folder / "map.yaml").unlink()
    (folder / "tracks.csv").unlink()
    words = ("animate", folder, "--output", tmp_path / "run.gif", "--log", log, "--first", 11, "--last", 13)
    code, _, err = run(capsys, *words)
    assert code == 0
    assert "run.gif: 3 frames" in err.splitlines()[-1]


@pytest.mark.parametrize("damaged", ["0 0", [0.0, 0.0], [0.0, 0.0, "far"], None])
def test_a_laser_pose_that_is_damaged_is_one_line(
    capsys: pytest.CaptureFixture[str], folder: Path, tmp_path: Path, damaged: object
) -> None:
    path = folder / "summary.json"
    source = {"laser_pose": damaged, "laser_pose_from": "given"}
    path.write_text(json.dumps({**json.loads(path.read_text()), "source": source}))
    code, out, err = run(capsys, "animate", folder, "--output", tmp_path / "run.gif")
    assert (code, out) == (2, "")
    assert_one_line(err, str(path), "three numbers", "run it again")


def test_a_long_run_is_thinned() -> None:
    from slammot_graph.cli.showing import _rows

    assert _rows(5000, 1, None, None, max_frames=100) == range(0, 5000, 50)
    assert len(_rows(5001, 1, None, None, max_frames=100)) <= 100
    assert _rows(5000, 101, 300, 1, max_frames=100) == range(100, 300)
    assert _rows(50, 1, 300, None, max_frames=100) == range(50)


def test_an_mp4_is_made_by_ffmpeg(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "bin").mkdir()
    script(
        tmp_path / "bin" / "ffmpeg", f'for out; do :; done; /bin/cat > "$out"; echo "$@" > {tmp_path}/words'
    )
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    words = ("animate", folder, "--output", tmp_path / "run.mp4", "--last", 3, "--every", 1)
    code, _, err = run(capsys, *words)
    assert code == 0
    size = (tmp_path / "words").read_text().split(" -s ")[1].split()[0]
    width, height = map(int, size.split("x"))
    assert (tmp_path / "run.mp4").stat().st_size == 3 * width * height * 3
    script(tmp_path / "bin" / "ffmpeg", "echo 'no encoder\nfor that' >&2; exit 1")
    (tmp_path / "run.mp4").unlink()
    code, _, err = run(capsys, *words)
    assert code == 2
    assert_one_line(err.splitlines(keepends=True)[-1], "ffmpeg failed: for that", ".gif")
    assert not list(tmp_path.glob("*run.mp4*"))


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["none", "--output", "out.gif"], ["none: no such run folder"]),
        (["graph", "--output", "out.png"], ["out.png", ".gif or .mp4"]),
        (["graph", "--output", "out"], ["out: ", ".gif or .mp4"]),
        (["graph", "--output", "out.mp4"], ["ffmpeg", "not installed", ".gif"]),
        (["graph", "--output", "folder.gif"], ["folder.gif", "is no plain file"]),
        (["graph", "--output", "out.gif", "--fps", "0"], ["--fps", "0"]),
        (["graph", "--output", "out.gif", "--fps", "60"], ["--fps", "at most 50"]),
        (["graph", "--output", "out.gif", "--every", "0"], ["--every", "0"]),
        (["graph", "--output", "out.gif", "--first", "0"], ["--first", "1 to 40"]),
        (["graph", "--output", "out.gif", "--first", "41"], ["--first", "1 to 40"]),
        (["graph", "--output", "out.gif", "--first", "9", "--last", "8"], ["--last", "9", "8"]),
        (["graph", "--output", "out.gif", "--log", "none.npz"], ["none.npz", "no such file"]),
        (["graph", "--output", "out.gif", "--scan-topic", "/scan"], ["--scan-topic"]),
        (["graph", "--output", "out.gif", "--log", "other.npz"], ["other.npz", "other times", "graph"]),
        (["unnamed", "--output", "out.gif"], ["unnamed", "--log"]),
        (["moved", "--output", "out.gif"], ["gone.npz", "no longer there", "--log"]),
    ],
)
def test_a_mistake_is_one_line(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    folder: Path,
    log: Path,
    tmp_path: Path,
    arguments: list[str],
    parts: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    Path("folder.gif").mkdir()
    for name, named in (("unnamed", None), ("moved", str(tmp_path / "gone.npz"))):
        shutil.copytree(folder, name)
        set_log(Path(name), named)
    with np.load(log) as file:
        arrays = dict(file)
    write_npz_log("other.npz", **{**arrays, "stamps": arrays["stamps"] + 0.05})
    code, out, err = run(capsys, "animate", *arguments)
    assert (code, out) == (2, "")
    assert_one_line(err.splitlines(keepends=True)[-1], *parts)
    assert not list(tmp_path.glob("*out*"))
