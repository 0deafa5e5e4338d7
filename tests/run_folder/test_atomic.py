"""A file of a run folder is complete, or what was there before."""

from pathlib import Path

import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.run_folder.atomic import atomic_path, replacing, write_text


def test_a_file_is_replaced_on_success(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")
    with atomic_path(path) as temporary:
        temporary.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(KeyError), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise KeyError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_named_with_the_remedy(tmp_path: Path) -> None:
    with (
        pytest.raises(
            InputError, match=r"file\.txt: cannot be written \(No space left on device\); free some"
        ),
        replacing(tmp_path / "file.txt"),
    ):
        raise OSError(28, "No space left on device")
    with pytest.raises(InputError, match="No such file or directory"):
        write_text(tmp_path / "nowhere" / "file.txt", ["line"])
