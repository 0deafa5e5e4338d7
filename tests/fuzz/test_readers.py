"""Damaged files: whatever is in them, a reader gives what is usable or one `SlammotError`."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from experiments.damaged_files import CHANGES, FILES, changed, sound_files
from slammot_graph.core.config import load_config
from slammot_graph.core.errors import SlammotError
from slammot_graph.logs import open_log
from slammot_graph.methods import get_method
from slammot_graph.run_folder.reader import read_run_folder

IS_LONG = os.environ.get("SLAMMOT_HYPOTHESIS") == "long"

FEW = settings(
    max_examples=settings.get_profile("long").max_examples if IS_LONG else 60,
    deadline=None,
    derandomize=not IS_LONG,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@st.composite
def damages(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """A few changes of some bytes."""
    changes = draw(
        st.lists(
            st.tuples(st.sampled_from(CHANGES), st.floats(0.0, 1.0), st.integers(0, 255)),
            min_size=1,
            max_size=4,
        )
    )

    def damage(data: bytes) -> bytes:
        for change in changes:
            data = changed(data, *change)
        return data

    return damage


@pytest.mark.parametrize("suffix", [".npz", ".log", ".bag"])
@FEW
@given(damage=damages())
def test_logs(suffix: str, tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(damage(sound_files()[f"log {suffix}"]))
    try:
        for item in open_log(path):
            assert np.isfinite(item.stamp)
    except SlammotError as error:
        assert "damaged" in str(error)  # the file's name, at least


def test_the_sound_folder_is_read(tmp_path: Path) -> None:
    for name in FILES:
        (tmp_path / name).write_bytes(sound_files()[f"folder {name}"])
    assert len(read_run_folder(tmp_path).stamps) == 12


@pytest.mark.parametrize("name", FILES)
@FEW
@given(damage=damages())
def test_run_folders(name: str, tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    for other in FILES:
        data = sound_files()[f"folder {other}"]
        (tmp_path / other).write_bytes(damage(data) if other == name else data)
    try:
        folder = read_run_folder(tmp_path)
        assert np.isfinite(folder.T_map_base).all()
        assert np.isfinite(folder.grid.origin).all()
    except SlammotError as error:
        assert str(tmp_path) in str(error)


@FEW
@given(damage=damages())
def test_settings(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "settings.toml"
    path.write_bytes(damage(sound_files()["settings"]))
    try:
        load_config(path, get_method("graph").config)
    except SlammotError as error:
        assert "settings.toml" in str(error)
