"""Index records of ROS 1 bags, also those of 2010, whose told length is not that of their entries."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import IndexData, ReaderError

_MOST_BYTES = 1 << 28
_LONGEST_HEADER = 4096


def read_long_indices(reader: Reader) -> None:
    """Let a reader that is not open yet take an index record that says it is longer than its entries.

    Its entries are as ever. The next record begins right after them, or where the length says: where a record's header
    is found.
    """
    read: Callable[..., None] = partial(_read_index_data, reader)
    reader.read_index_data = read  # type: ignore[method-assign]


def _read_index_data(reader: Reader, pos: int, indexes: dict[int, list[Any]]) -> None:
    file = reader.bio
    if file is None:
        raise ReaderError("the bag is closed")
    n_header = _number(file.read(4))
    fields = _fields(file.read(min(n_header, _MOST_BYTES)))
    if fields.get(b"ver") != (1).to_bytes(4, "little"):
        raise ReaderError("an index record of another version than 1")
    connection, count = _number(fields[b"conn"]), _number(fields[b"count"])
    size = _number(file.read(4))
    if size < 12 * count or 12 * count > _MOST_BYTES:
        raise ReaderError(f"an index record of {size} bytes for {count} entries")
    data = file.read(12 * count)
    end = file.tell()
    if size > 12 * count and not _starts_a_record(file.read(_LONGEST_HEADER)):
        end += size - 12 * count
    file.seek(end)
    for start in range(0, 12 * count, 12):
        seconds, nanoseconds, offset = (_number(data[start + k : start + k + 4]) for k in (0, 4, 8))
        indexes[connection].append(IndexData(seconds * 10**9 + nanoseconds, pos, offset))


def _starts_a_record(data: bytes) -> bool:
    """Whether bytes are those of a record: the length of its header, and in it the field `op`."""
    n_header = int.from_bytes(data[:4], "little")
    return b"\x04\x00\x00\x00op=" in data[4 : 4 + n_header] and n_header <= _LONGEST_HEADER


def _fields(header: bytes) -> dict[bytes, bytes]:
    """Fields of a record's header: each its length, then ``name=value``."""
    found, place = {}, 0
    while place < len(header):
        length = _number(header[place : place + 4])
        name, _, value = header[place + 4 : place + 4 + length].partition(b"=")
        found[name] = value
        place += 4 + length
    return found


def _number(data: bytes) -> int:
    if len(data) != 4:
        raise ReaderError("an index record ends too early")
    return int.from_bytes(data, "little")
