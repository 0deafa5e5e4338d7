"""``run.rrd`` of a run that was killed: it ends within a message, at which readers stop or fail.

A recording is a header of 12 bytes and messages one after the other: kind and length as 64 bit integers, then as many
bytes; the kind 0 ends it.
"""

import os
import struct
from pathlib import Path
from typing import IO

_MAGIC, _HEADER_BYTES = b"RRF2", 12
_MESSAGE = struct.Struct("<QQ")
_DATA = 2


def cut_to_whole_messages(path: Path) -> None:
    """Cut a recording off where its last whole message ends; remove it if none of them holds any data.

    What is no recording of this kind stays as it is.

    Raises
    ------
    OSError
        It cannot be read or cut.
    """
    with path.open("r+b") as file:
        n_bytes = os.fstat(file.fileno()).st_size
        head = file.read(_HEADER_BYTES)
        if head[:4] != _MAGIC[: len(head)]:
            return
        end, has_data = _end_of_messages(file, n_bytes)
        if has_data and end < n_bytes:
            file.truncate(end)
    if not has_data:
        path.unlink()


def _end_of_messages(file: IO[bytes], n_bytes: int) -> tuple[int, bool]:
    """Where the last whole message ends, and whether any holds data; all of a file that was ended is whole."""
    place, has_data = _HEADER_BYTES, False
    while place + _MESSAGE.size <= n_bytes:
        file.seek(place)
        kind, n = _MESSAGE.unpack(file.read(_MESSAGE.size))
        if place + _MESSAGE.size + n > n_bytes:
            break
        if kind == 0:
            return n_bytes, has_data
        place += _MESSAGE.size + n
        has_data = has_data or kind == _DATA
    return place, has_data
