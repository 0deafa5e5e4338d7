"""Files that are read: regular ones, of a size that a reader can take."""

import stat
from pathlib import Path
from zipfile import BadZipFile, ZipFile

from slammot_graph.core.errors import InputError

MOST_TEXT_BYTES = 512 << 20
"""Of a text file that is read in one piece; a trajectory of a week at 10 Hz has as many."""

MOST_SETTINGS_BYTES = 64 << 20
"""Of a file of settings or a summary."""

_MOST_UNPACKED_BYTES, _MOST_RATIO = 1 << 30, 100


def check_regular(path: Path, most_bytes: int | None = None) -> None:
    """Refuse what is there but no regular file, such as a pipe or a device, which may never end.

    Parameters
    ----------
    path : Path
        What is not there, or is a folder, is left to the reader.
    most_bytes : int, optional
        A larger file is refused.

    Raises
    ------
    InputError
    """
    try:
        status = path.stat()
    except (OSError, ValueError):
        return
    if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
        raise InputError(f"{path}: a pipe or a device, not a file; copy what it gives into a file first")
    if most_bytes is not None and status.st_size > most_bytes:
        raise InputError(
            f"{path}: {status.st_size / 2**20:.0f} MB, more than the {most_bytes / 2**20:.0f} MB that such a file"
            " may have; check that it is the right one"
        )


def check_npz(path: Path) -> None:
    """Refuse an ``.npz`` that is no regular file, or that unpacks to a multiple of what arrays of a log would.

    Raises
    ------
    InputError
    """
    check_regular(path)
    try:
        packed = path.stat().st_size
        with path.open("rb") as raw, ZipFile(raw) as file:
            unpacked = sum(member.file_size for member in file.infolist())
    except (OSError, ValueError, BadZipFile, NotImplementedError):
        return  # its reader says what is wrong
    if unpacked > max(_MOST_UNPACKED_BYTES, _MOST_RATIO * packed):
        raise InputError(
            f"{path}: {packed / 2**20:.1f} MB that unpack to {unpacked / 2**20:.0f} MB, which no log does;"
            " write it again"
        )
