"""What is no file is refused before it is read, and what unpacks to more than a log would."""

import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from slammot_graph.core.config import load_config
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.files import check_npz, check_regular
from slammot_graph.core.number_rows import read_number_rows
from slammot_graph.logs import open_log
from slammot_graph.methods import get_method


def test_pipes_and_devices_are_refused(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.npz"
    os.mkfifo(pipe)
    readers: list[Callable[[Path], object]] = [
        open_log,
        lambda p: read_number_rows(p, 3),
        lambda p: load_config(p, get_method("graph").config),
    ]
    for path in (pipe, Path("/dev/zero")):
        for read in readers:
            with pytest.raises(SlammotError, match="a pipe or a device, not a file"):
                read(path)


def test_what_is_too_large_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "long.txt"
    with path.open("wb") as file:
        file.truncate(10 << 20)
    check_regular(path)
    check_regular(tmp_path / "not there", 1)
    with pytest.raises(SlammotError, match=r"long\.txt: 10 MB, more than the 1 MB"):
        check_regular(path, 1 << 20)


def test_an_archive_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("ranges.npy", "w") as member,
    ):
        for _ in range(70):
            member.write(bytes(16 << 20))
    with pytest.raises(SlammotError, match=r"that unpack to 1120 MB, which no log does"):
        check_npz(path)
    with pytest.raises(SlammotError, match="unpack to 1120 MB"):
        open_log(path)
