"""The real viewer, without a display, shows what is recorded; its pictures are kept in `artifacts`."""

import contextlib
import io
import os
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from scipy.ndimage import binary_dilation

from slammot_graph import cli
from slammot_graph.core.types import BoolArray, FloatArray
from slammot_graph.viz import colors
from slammot_graph.viz.rerun import cells
from slammot_graph.viz.rerun.primitives import viewer_executable
from tests.viz.colours import as_numbers
from tests.walkers import write_walkers

N_SCANS = 170
"""So many of two-walkers: straight on along x, then a turn to the left."""
SCAN = 160
ARTIFACTS = Path(os.environ.get("SLAMMOT_ARTIFACTS") or Path(__file__).parents[3] / "build" / "artifacts")
"""Where the pictures are put."""
PACKAGES = "apt-get install mesa-vulkan-drivers libvulkan1"
MAX_WAIT_S = 10.0
LEAST_COLORS = 8
"""A picture with fewer is taken for empty."""

MAIN_VIEWS = {
    "Map",
    "Graph on the map",
    "Scan, robot's frame",
    "Graph",
    "NIS of the match, 95% bound",
    "Points",
    "Tracks",
    "Time per stage [ms]",
    "Position std [m]",
    "Heading std [degrees]",
    "Residual [m]",
    "Share of inliers",
    "Distance from the truth [m]",
    "Turn [degrees]",
    "State of the match",
    "Legend and configuration",
    "Events",
    "Summary",
}
COMPARED_VIEWS = {
    "Map",
    "Distance from the truth [m]",
    "Turn from the truth [degrees]",
    "Distance from the first run [m]",
    "Turn from the first run [degrees]",
    "Moving points",
    "Uncertainty of the position [m]",
    "Runs and legend",
}
MAY_BE_EMPTY = {"Events"}


@dataclass
class Pictures:
    """What the viewer showed at one scan: RGB pictures (rows, cols, 3) in [0, 1] by view, and its complaints."""

    of_view: dict[str, FloatArray]
    reports: list[str]
    errors: list[str]


@pytest.fixture(scope="module")
def show(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[Path, int, str], Pictures]]:
    """Show a recording at a scan and keep a picture of each view under a name; skipped without a driver."""
    named = os.environ.get("VK_ICD_FILENAMES", os.environ.get("VK_DRIVER_FILES", ""))
    drivers = [Path(name) for name in named.split(os.pathsep) if name]
    for folder in ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d"):
        drivers += Path(folder).glob("*.json")
    if not any(driver.is_file() for driver in drivers):
        pytest.skip(f"no Vulkan driver to draw with: {PACKAGES}")
    if viewer_executable() is None:
        pytest.skip("no rerun viewer in this environment: pip install rerun-sdk")
    with pytest.MonkeyPatch.context() as patch:
        if "XDG_RUNTIME_DIR" not in os.environ:
            patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("xdg")))
        yield _show


def _show(path: Path, scan: int, name: str) -> Pictures:
    from rerun.experimental import ViewerClient

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    folder = ARTIFACTS / "viewer" / name
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.png"):
        old.unlink()
    pictures = Pictures({}, [], [])
    with ViewerClient.spawn(headless=True, port=port, executable_path=str(viewer_executable())) as viewer:
        viewer.open(str(path.resolve()))
        _wait(lambda: not viewer.get_state().loading)
        viewer.set_time("scan", sequence=scan, play_state="paused")
        viewer.take_screenshot(max_size=64)  # the first frame makes the views
        layout = viewer.get_blueprint().blueprint
        panels = {
            key[1:]: entity["ContainerBlueprint"] for key, entity in layout.items() if "container" in key
        }
        tabs = [panel for panel in panels.values() if panel["container_kind"] == "Tabs"]
        own = _shown(panels)
        # first all views side by side; the layout's own tabs last, when the viewer's notes on itself have gone
        for kind in ("Grid", "Tabs"):
            for panel in tabs:
                panel["container_kind"] = kind
            viewer.set_blueprint(layout, of="recording")
            _settle(viewer, next(view.view_id for view in viewer.get_state().views if view.name == "Map"))
            shown = _shown(panels)
            views = [view for view in viewer.get_state().views if f"view/{view.view_id}" in shown]
            for view in views:
                if kind == "Tabs" or f"view/{view.view_id}" not in own:
                    png = _picture(viewer, view.view_id)
                    (folder / f"{_file_name(view.name)}.png").write_bytes(png)
                    pictures.of_view[view.name] = _decoded(png)
            pictures.reports += [
                f"{view.name}: {report.summary}" for view in views for report in view.reports
            ]
        (folder / "whole.png").write_bytes(_picture(viewer))
        pictures.errors += [entry.message for entry in viewer.get_logs() if entry.level == "ERROR"]
    return pictures


def _file_name(view: str) -> str:
    return "-".join("".join(letter if letter.isalnum() else " " for letter in view).split()).lower()


def _shown(panels: dict[str, Any]) -> set[str]:
    """Give the views and panels that are not behind a tab, from the panel that is in no other."""
    held = {name for panel in panels.values() for name in panel["contents"]}
    shown: set[str] = set()
    todo = [name for name in panels if name not in held]
    while todo:
        shown.add(name := todo.pop())
        if name in panels:
            is_tabs = panels[name]["container_kind"] == "Tabs"
            todo += [panels[name]["active_tab"]] if is_tabs else panels[name]["contents"]
    return shown


def _settle(viewer: Any, view_id: str) -> None:
    """Wait until two pictures of a view are equal: the layout and the data come in over several frames."""
    viewer.take_screenshot(max_size=64)
    last = b""
    end = time.monotonic() + MAX_WAIT_S
    while time.monotonic() < end and last != (last := _picture(viewer, view_id, max_size=640)):
        pass


def _picture(viewer: Any, view_id: str | None = None, max_size: int | None = None) -> bytes:
    for _ in range(5):
        with contextlib.suppress(TimeoutError, ConnectionError):  # not found: not laid out yet
            png: bytes = viewer.take_screenshot(view_id, max_size=max_size)
            return png
    pytest.fail("the viewer does not answer")


def _wait(is_done: Callable[[], bool]) -> None:
    end = time.monotonic() + MAX_WAIT_S
    while not is_done() and time.monotonic() < end:
        time.sleep(0.05)


def _decoded(png: bytes) -> FloatArray:
    return np.asarray(imread(io.BytesIO(png), format="png")[..., :3], dtype=np.float64)


def _n_colors(picture: FloatArray) -> int:
    return len(np.unique(as_numbers(np.round(255.0 * picture))))


def _is_colored(picture: FloatArray, rgba: int, tolerance: float = 0.08) -> BoolArray:
    """Pixels (rows, cols) of about a colour."""
    color = np.array([rgba >> shift & 0xFF for shift in (24, 16, 8)]) / 255.0
    near: BoolArray = np.abs(picture - color).max(axis=-1) < tolerance
    return near


def _assert_shown(pictures: Pictures, views: set[str]) -> None:
    assert not pictures.reports
    assert not pictures.errors
    assert set(pictures.of_view) == views
    blank = {name for name, picture in pictures.of_view.items() if _n_colors(picture) < LEAST_COLORS}
    assert blank <= MAY_BE_EMPTY


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_walkers(tmp_path_factory.mktemp("log") / "walkers.npz", N_SCANS)


def _run(log: Path, output: Path, method: str, rerun: str) -> Path:
    words = ["run", str(log), "--output", str(output / method), "--method", method, "--rerun", rerun]
    assert cli.main(words) == 0
    return output / method


def test_every_view_of_a_run_is_drawn(
    show: Callable[[Path, int, str], Pictures], log: Path, tmp_path: Path
) -> None:
    folder = _run(log, tmp_path, "graph", "file")
    pictures = show(folder / "run.rrd", SCAN, "two-walkers")
    _assert_shown(pictures, MAIN_VIEWS)
    for name in ("Map", "Scan, robot's frame"):
        picture = pictures.of_view[name]
        is_static = _is_colored(picture, colors.COLOR_STATIC)
        assert is_static.sum() > 100
        assert _is_colored(picture, colors.COLOR_MOVING).sum() > 10
        # the cells that the test saw, in the view of the scan only
        is_free = _is_colored(picture, cells.COLOR_CELLS[1], 0.03)
        if name == "Map":
            assert is_free.sum() < 10
        else:
            assert is_free.sum() > 1000
            is_red = _is_colored(picture, colors.COLOR_MOVING)
            assert is_red[binary_dilation(is_free, iterations=8)].sum() > 0.9 * is_red.sum()
        # what is seen lies on the map's walls, in each view: none of them is mirrored
        is_wall = _is_colored(picture, 0x0F0F0FFF)
        assert is_static[binary_dilation(is_wall, iterations=8)].sum() > 0.3 * is_static.sum()
    rows, cols = np.nonzero(_is_colored(pictures.of_view["Map"], colors.COLOR_ESTIMATE, 0.04))
    assert len(rows) > 200
    # y is up: the path starts in the lower left corner and turns to the left
    assert rows[cols.argmin()] > np.percentile(rows, 40)
    assert cols[rows.argmin()] > np.percentile(cols, 40)


def test_every_view_of_a_comparison_is_drawn(
    show: Callable[[Path, int, str], Pictures], log: Path, tmp_path: Path
) -> None:
    folders = [str(_run(log, tmp_path, method, "off")) for method in ("graph", "odometry")]
    words = ["compare", *folders, "--output", str(tmp_path / "both.rrd"), "--truth", str(log)]
    assert cli.main(words) == 0
    pictures = show(tmp_path / "both.rrd", SCAN, "comparison")
    _assert_shown(pictures, COMPARED_VIEWS)
    for color in (*colors.RUN_COLORS[:2], colors.COLOR_TRUTH):
        assert _is_colored(pictures.of_view["Map"], color).sum() > 20
