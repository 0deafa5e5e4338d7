"""The moving picture of a run: its legend, its colours, and frames that come back out of the GIF as drawn."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL.GifImagePlugin import GifImageFile

from slammot_graph import Run
from slammot_graph.core.saved_run import RunFolder
from slammot_graph.run_folder.reader import read_run_folder
from slammot_graph.run_folder.writer import write_run_folder
from slammot_graph.viz.animation import _Stage, write_animation
from slammot_graph.viz.colors import track_color
from tests.rooms import ListLog, drive
from tests.viz.colours import as_numbers

N_SCANS = 40


@cache
def log() -> ListLog:
    return drive(N_SCANS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    path = tmp_path_factory.mktemp("runs") / "graph"
    write_run_folder(path, Run(log()).complete())
    return read_run_folder(path)


def labels(stage: _Stage) -> list[str]:
    legends = stage._canvas.figure.legends
    return [text.get_text() for legend in legends for text in legend.get_texts()]


def test_every_frame_says_what_is_what(folder: RunFolder) -> None:
    stage = _Stage(folder, log_name="list.log")
    assert labels(stage) == [
        *("points that stand still", "points that move", "robot and its path"),
        "tracked objects, and their paths in the last 30 scans",
        *("finished map: free", "unknown", "occupied"),
    ]
    assert stage._canvas.figure.texts[0].get_text() == "graph on list.log"
    first, last = stage.draw(0, log().scans[0]), stage.draw(N_SCANS - 1, log().scans[-1])
    height = stage.size[1]
    assert first.shape == (height, stage.size[0], 3)
    foot = slice(int(0.93 * height), height)  # below the scale bar
    np.testing.assert_array_equal(first[foot], last[foot])
    assert (first[foot] < 128).any()


def test_without_map_and_tracks_the_legend_does_not_name_them(folder: RunFolder, tmp_path: Path) -> None:
    for name in ("trajectory.tum", "points.npz"):
        (tmp_path / name).write_bytes((folder.path / name).read_bytes())
    stage = _Stage(read_run_folder(tmp_path), log_name="list.log")
    assert labels(stage) == ["points that stand still", "points that move", "robot and its path"]


def test_the_frames_of_a_gif_are_as_drawn(folder: RunFolder, tmp_path: Path) -> None:
    rows = range(0, N_SCANS, 3)
    told: list[int] = []
    path = tmp_path / "run.gif"
    write_animation(folder, log(), path, kind="gif", rows=rows, fps=10.0, tell=told.append)
    assert told == list(range(1, len(rows) + 1))
    stage = _Stage(folder, log_name=log().path.name)
    palette = as_numbers(stage.colors()[:32])
    with GifImageFile(path) as image:
        assert image.n_frames == len(rows)
        for number, row in enumerate(rows):
            image.seek(number)
            shown = np.asarray(image.convert("RGB")).astype(int)
            drawn = stage.draw(row, log().scans[row]).astype(int)
            off = np.abs(shown - drawn).max(axis=2)
            assert np.mean(off > 40) < 1e-3, "edges of what moves have not all their colours"
            is_of_palette = np.isin(as_numbers(drawn), palette)
            assert np.mean(off[is_of_palette] > 8) < 1e-3


def test_a_gif_holds_of_a_frame_what_has_changed(folder: RunFolder, tmp_path: Path) -> None:
    sizes = []
    for n in (1, 20):
        path = tmp_path / f"{n}.gif"
        write_animation(folder, log(), path, kind="gif", rows=range(n), fps=10.0)
        sizes.append(path.stat().st_size)
    assert sizes[1] < 7.5 * sizes[0]


def test_a_track_has_the_colour_of_the_overview(folder: RunFolder) -> None:
    stage = _Stage(folder, log_name="list.log")
    ids = np.unique(folder.tracks[:, 1]).astype(int).tolist()
    assert ids
    row = int(np.searchsorted(folder.stamps, folder.tracks[-1, 0] - 1e-4))
    drawn = stage.draw(row, log().scans[row])
    color = track_color(int(folder.tracks[-1, 1]))
    rgb = [color >> shift & 255 for shift in (24, 16, 8)]
    assert (np.abs(drawn.astype(int) - rgb).max(axis=2) < 4).sum() > 5
