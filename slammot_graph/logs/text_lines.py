"""Lines of a text file that may be compressed by gzip or bzip2."""

import bz2
import gzip
import io
import zlib
from collections.abc import Generator
from pathlib import Path
from typing import BinaryIO, cast

from slammot_graph.core.errors import InputError
from slammot_graph.logs.base import one_line

_BUFFER_BYTES = 1 << 18

MAX_LINE_BYTES = 1 << 24
"""No line of a log is longer: a scan of 100,000 beams takes a tenth of it."""


def open_decompressed(path: Path) -> BinaryIO:
    """Open a file for reading, decompressed as its first bytes require."""
    with path.open("rb") as file:
        magic = file.read(3)
    if magic.startswith(b"\x1f\x8b"):
        return cast(BinaryIO, gzip.open(path, "rb"))
    if magic == b"BZh":
        return cast(BinaryIO, bz2.open(path, "rb"))
    return path.open("rb")


def numbered_lines(path: Path) -> Generator[tuple[int, bytes], None, None]:
    """Lines of a file with their numbers from 1.

    Raises
    ------
    InputError
        The file cannot be read, or its compressed data is truncated or damaged.
    """
    number = 0
    try:
        with (
            open_decompressed(path) as raw,
            io.BufferedReader(cast(io.RawIOBase, raw), _BUFFER_BYTES) as lines,
        ):
            for number, line in enumerate(iter(lambda: lines.readline(MAX_LINE_BYTES), b""), start=1):
                if len(line) == MAX_LINE_BYTES:
                    raise InputError(
                        f"{path}: line {number} is longer than {MAX_LINE_BYTES} bytes; this is no log"
                    )
                yield number, line
    except EOFError:
        raise InputError(
            f"{path}: the compressed file ends too early, after line {number}; copy or download it again"
        ) from None
    except (OSError, zlib.error) as err:
        raise InputError(
            f"{path}: cannot be read after line {number} ({one_line(err)}); check the file, or copy it again"
        ) from None


def read_start(path: Path, n_bytes: int = 4096) -> bytes:
    """First bytes of a file, seen through its compression.

    Raises
    ------
    InputError
        The file cannot be read, or is truncated or damaged right at its start.
    """
    try:
        with open_decompressed(path) as file:
            return file.read(n_bytes)
    except (OSError, EOFError, zlib.error) as err:
        raise InputError(
            f"{path}: cannot be read ({one_line(err)}); check the file, or copy it again"
        ) from None
