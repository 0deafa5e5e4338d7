"""Damaged checkpoints: one `SlammotError`, or the state that was kept."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given

from slammot_graph.core.errors import SlammotError
from slammot_graph.core.frozen_state import thaw
from slammot_graph.run import Run
from slammot_graph.run_folder.checkpoint import CHECKPOINT_FILE, SCANS_FILE, CheckpointFile
from tests.fuzz.test_readers import FEW, damages
from tests.rooms import drive


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder, run = tmp_path_factory.mktemp("sound"), Run(drive(6))
    for step in run:
        if step.scan.index == 4:
            CheckpointFile(folder).write(run.freeze())
    return {name: (folder / name).read_bytes() for name in (CHECKPOINT_FILE, SCANS_FILE)}


@pytest.mark.parametrize("name", [CHECKPOINT_FILE, SCANS_FILE])
@FEW
@given(damage=damages())
def test_checkpoints(
    name: str, sound: dict[str, bytes], tmp_path: Path, damage: Callable[[bytes], bytes]
) -> None:
    for other, data in sound.items():
        (tmp_path / other).write_bytes(damage(data) if other == name else data)
    try:
        frozen = CheckpointFile(tmp_path).read()
        assert frozen is not None
        assert frozen.n_scans == 5
    except SlammotError as error:
        assert str(tmp_path) in str(error)


@FEW
@given(damage=damages())
def test_states(sound: dict[str, bytes], tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    """As if the checksum were right: what is no state is refused, whatever it asks for."""
    for name, data in sound.items():
        (tmp_path / name).write_bytes(data)
    frozen = CheckpointFile(tmp_path).read()
    assert frozen is not None
    assert frozen.state is not None
    try:
        thaw(damage(frozen.state[-20_000:]), frozen.spools, None)
    except SlammotError as error:
        assert "not the state of a run" in str(error)
