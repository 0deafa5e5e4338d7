"""Damaged checkpoints: one `SlammotError`, or the state that was kept."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given

from experiments.damaged_files import sound_files
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.frozen_state import FrozenRun, thaw
from slammot_graph.run_folder.checkpoint import CHECKPOINT_FILE, SCANS_FILE, CheckpointFile
from tests.fuzz.test_readers import FEW, damages

NAMES = (CHECKPOINT_FILE, SCANS_FILE)


@pytest.mark.parametrize("name", NAMES)
@FEW
@given(damage=damages())
def test_checkpoints(name: str, tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    for other in NAMES:
        data = sound_files()[f"checkpoint {other}"]
        (tmp_path / other).write_bytes(damage(data) if other == name else data)
    try:
        frozen = CheckpointFile(tmp_path).read()
        assert frozen is not None
        assert frozen.n_scans == 8
    except SlammotError as error:
        assert str(tmp_path) in str(error)


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> FrozenRun:
    folder = tmp_path_factory.mktemp("sound")
    for name in NAMES:
        (folder / name).write_bytes(sound_files()[f"checkpoint {name}"])
    frozen = CheckpointFile(folder).read()
    assert frozen is not None
    return frozen


@FEW
@given(damage=damages())
def test_states(sound: FrozenRun, damage: Callable[[bytes], bytes]) -> None:
    """As if the checksum were right: what is no state is refused, whatever it asks for."""
    assert sound.state is not None
    try:
        thaw(damage(sound.state[-20_000:]), sound.spools, None)
    except SlammotError as error:
        assert "not the state of a run" in str(error)
