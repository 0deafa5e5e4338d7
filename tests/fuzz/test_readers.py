"""Damaged files: whatever is in them, a reader gives what is usable or one `SlammotError`."""

import io
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from slammot_graph.core.config import load_config
from slammot_graph.core.errors import SlammotError
from slammot_graph.logs import open_log
from slammot_graph.methods import get_method
from slammot_graph.run_folder.reader import read_run_folder
from tests.logs.bag_files import odometry, scan, write_bag
from tests.logs.carmen_text import flaser

IS_LONG = os.environ.get("SLAMMOT_HYPOTHESIS") == "long"

FEW = settings(
    max_examples=settings.get_profile("long").max_examples if IS_LONG else 60,
    deadline=None,
    derandomize=not IS_LONG,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)

ODD_WORDS = [
    b"nan",
    b"-inf",
    b"1e308",
    b"-1",
    b"0",
    b"9" * 400,
    b"\xff\xfe",
    b"\n" * 3,
    b"[" * 2000,
    b"",
    b"\x00" * 8,
]


@st.composite
def damages(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """A few changes of some bytes: overwritten, cut off, doubled, or odd words put in."""
    changes = draw(
        st.lists(
            st.tuples(
                st.sampled_from(["flip", "cut", "double", "word"]), st.floats(0.0, 1.0), st.integers(0, 255)
            ),
            min_size=1,
            max_size=4,
        )
    )

    def damage(data: bytes) -> bytes:
        for kind, place, value in changes:
            k = int(place * max(len(data) - 1, 0))
            if kind == "flip":
                data = data[:k] + bytes([value]) + data[k + 1 :]
            elif kind == "cut":
                data = data[:k]
            elif kind == "double":
                data = data[:k] + data[k : k + value] + data[k:]
            else:
                end = next((j for j in range(k, len(data)) if data[j : j + 1] in b" ,\n=]"), k)
                data = data[:k] + ODD_WORDS[value % len(ODD_WORDS)] + data[end:]
        return data

    return damage


def npz(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Small sound logs by their suffix."""
    folder = tmp_path_factory.mktemp("sound")
    messages = [m for k in range(3) for m in (scan(100.0 + k), odometry(100.0 + k, (0.1 * k, 0.0, 0.0)))]
    arrays = npz(
        stamps=np.arange(3.0),
        ranges=np.full((3, 20), 2.0),
        angle_min=np.array(-1.0),
        angle_increment=np.array(0.1),
        range_min=np.array(0.1),
        range_max=np.array(9.0),
        laser_pose=np.zeros(3),
        odometry=np.zeros((3, 3)),
    )
    lines = "\n".join(flaser((1.0, 2.0, 3.0), 100.0 + k) for k in range(3))
    return {
        ".npz": arrays,
        ".log": lines.encode(),
        ".bag": write_bag(folder, messages, "bag").read_bytes(),
    }


@pytest.mark.parametrize("suffix", [".npz", ".log", ".bag"])
@FEW
@given(damage=damages())
def test_logs(suffix: str, logs: dict[str, bytes], tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(damage(logs[suffix]))
    try:
        for item in open_log(path):
            assert np.isfinite(item.stamp)
    except SlammotError as error:
        assert "damaged" in str(error)  # the file's name, at least


RUN_FILES = {
    "trajectory.tum": b"1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0 1\n",
    "tracks.csv": b"stamp,id,x,y,vx,vy,var_x,cov_xy,var_y\n1.0,1,0.5,0.5,0,0,0.1,0,0.1\n",
    "map.yaml": b"image: map.pgm\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\nnegate: 0\nfree_thresh: 0.196\n",
    "map.pgm": b"P5\n4 3\n255\n" + bytes([0, 254, 205, 254] * 3),
    "summary.json": json.dumps({"method": "graph", "n_scans": 2}).encode(),
    "covariances.npz": npz(stamps=np.array([1.0, 2.0]), cov_map=np.tile(np.eye(3), (2, 1, 1))),
    "points.npz": npz(
        stamps=np.array([1.0, 2.0]),
        is_valid=np.ones((2, 5), bool),
        is_moving=np.zeros((2, 5), bool),
        is_moving_online=np.zeros((2, 5), bool),
        p_moving=np.zeros((2, 5), np.float16),
    ),
}


def test_the_sound_folder_is_read(tmp_path: Path) -> None:
    for name, data in RUN_FILES.items():
        (tmp_path / name).write_bytes(data)
    assert len(read_run_folder(tmp_path).stamps) == 2


@pytest.mark.parametrize("name", list(RUN_FILES))
@FEW
@given(damage=damages())
def test_run_folders(name: str, tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    for other, data in RUN_FILES.items():
        (tmp_path / other).write_bytes(damage(data) if other == name else data)
    try:
        folder = read_run_folder(tmp_path)
        assert np.isfinite(folder.T_map_base).all()
        assert np.isfinite(folder.grid.origin).all()
    except SlammotError as error:
        assert str(tmp_path) in str(error)


SETTINGS = b'max_range_m = 30.0\n[grid]\nresolution_m = 0.05\n[localizer]\nkind = "scan_to_map"\n'


@FEW
@given(damage=damages())
def test_settings(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "settings.toml"
    path.write_bytes(damage(SETTINGS))
    try:
        load_config(path, get_method("graph").config)
    except SlammotError as error:
        assert "settings.toml" in str(error)
