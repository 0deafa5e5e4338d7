"""One run at a time writes into a folder."""

import subprocess
import sys
from pathlib import Path

import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.run_folder.directory import claimed_output, prepare_output
from slammot_graph.run_folder.lock import LOCK_FILE, folder_lock

HOLD = """
import sys, time
from pathlib import Path
from slammot_graph.run_folder.directory import claimed_output
with claimed_output(sys.argv[1], overwrite=False):
    Path(sys.argv[1], ".trajectory.tum.tmp").touch()
    print("held", flush=True)
    time.sleep(60)
"""


def test_a_second_run_is_refused_and_told_whose_the_folder_is(tmp_path: Path) -> None:
    with claimed_output(tmp_path, overwrite=False):
        for overwrite in (False, True):
            with (
                pytest.raises(
                    InputError, match=r"another run writes into it \(process \d+ on .+, for \d+ s\)"
                ),
                claimed_output(tmp_path, overwrite=overwrite),
            ):
                pass
    assert list(tmp_path.iterdir()) == []
    with claimed_output(tmp_path, overwrite=False):
        pass


def test_a_lock_is_given_back_after_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyError), folder_lock(tmp_path):
        raise KeyError
    with folder_lock(tmp_path):
        assert [path.name for path in tmp_path.iterdir()] == [LOCK_FILE]


def test_the_lock_of_a_process_that_was_killed_is_taken_over(tmp_path: Path) -> None:
    process = subprocess.Popen([sys.executable, "-c", HOLD, tmp_path], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process:
        assert process.stdout.readline() == "held\n"
        with (
            pytest.raises(InputError, match=f"process {process.pid} on"),
            claimed_output(tmp_path, overwrite=True),
        ):
            pass
        process.kill()
    assert {path.name for path in tmp_path.iterdir()} == {LOCK_FILE, ".trajectory.tum.tmp"}
    with pytest.raises(InputError, match="--overwrite"):
        prepare_output(tmp_path, overwrite=False)
    with claimed_output(tmp_path, overwrite=True):
        assert [path.name for path in tmp_path.iterdir()] == [LOCK_FILE]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", [".trajectory.tum.tmp", ".map.pgm.tmp"])
def test_a_lone_temporary_file_is_of_an_interrupted_run(tmp_path: Path, name: str) -> None:
    (tmp_path / name).touch()
    prepare_output(tmp_path, overwrite=True)
    assert list(tmp_path.iterdir()) == []


def test_pictures_of_somebody_else_are_no_run(tmp_path: Path) -> None:
    (tmp_path / "map.pgm").touch()
    with pytest.raises(InputError, match=r"map\.pgm"), claimed_output(tmp_path, overwrite=True):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["map.pgm"]


def test_a_lock_alone_leaves_the_folder_empty(tmp_path: Path) -> None:
    (tmp_path / LOCK_FILE).write_text("of a process that was killed")
    with claimed_output(tmp_path, overwrite=False):
        pass
    assert list(tmp_path.iterdir()) == []
