"""Bytes of a whole run: in memory while they are few, then in a temporary file; in memory where that fails."""

import logging
import tempfile
import weakref
from contextlib import suppress
from typing import IO

MOST_IN_MEMORY = 8 << 20
"""Beyond this [bytes] what a run keeps of its scans is many, and goes into a temporary file."""

_PIECE_BYTES = 1 << 20
"""Once there is a file, so many wait in memory for it."""

_logger = logging.getLogger(__name__)


class Spool:
    """Bytes that are added at the end and read anywhere; a temporary file that cannot be written loses none.

    Parameters
    ----------
    most_in_memory : int
        Beyond it [bytes] they go into a temporary file.

    Attributes
    ----------
    n_bytes : int
    """

    def __init__(self, most_in_memory: int) -> None:
        self.n_bytes = 0
        self._limit = most_in_memory
        self._latest = bytearray()  # what is not in the file
        self._file: IO[bytes] | None = None
        self._in_file = 0
        self._is_at_end = True
        self._is_closed = False

    def add(self, data: bytes) -> int:
        """Add some at the end; returns where they begin. ValueError once it is closed."""
        if self._is_closed:
            raise ValueError("closed: nothing can be added")
        place = self.n_bytes
        self._latest += data
        self.n_bytes += len(data)
        if len(self._latest) > self._limit:
            self._move_into_file()
        return place

    def read(self, place: int, n: int) -> bytes:
        """Give n bytes that were added as one."""
        if place >= self._in_file or self._file is None:
            first = place - self._in_file
            return bytes(self._latest[first : first + n])
        self._is_at_end = False
        self._file.seek(place)
        data = self._file.read(n)
        while len(data) < n and (more := self._file.read(n - len(data))):  # the system gives 2 GB at a time
            data += more
        return data

    def read_some(self, place: int, most: int) -> bytes:
        """Give at most so many bytes from any place on; none at the end."""
        if place < self._in_file:
            return self.read(place, min(most, self._in_file - place))
        return self.read(place, min(most, self.n_bytes - place))

    def since(self, place: int) -> bytes:
        """Give all from a place on, where something was added."""
        n_in_file = max(self._in_file - place, 0)
        return self.read(place, n_in_file) + bytes(self._latest[max(place - self._in_file, 0) :])

    def close(self) -> None:
        """Give the temporary file back."""
        self._is_closed = True
        if self._file is not None:
            self._file.close()

    def _move_into_file(self) -> None:
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
                weakref.finalize(self, self._file.close)
            if not self._is_at_end:
                self._file.seek(self._in_file)
                self._is_at_end = True
            with memoryview(self._latest) as latest:
                n = 0
                while n < len(latest):
                    n += self._file.write(latest[n:])
        except OSError as error:
            self._is_at_end = False
            with suppress(OSError, AttributeError):
                self._file.truncate(self._in_file)  # type: ignore[union-attr]  # the disk may be short for others
            self._limit = 2 * len(self._latest)  # only then again
            _logger.warning(
                "the temporary file of the scans cannot be written (%s): they stay in memory; free some space, or"
                " set TMPDIR to a folder that has some",
                error.strerror or error,
            )
            return
        self._in_file = self.n_bytes
        self._latest = bytearray()
        self._limit = _PIECE_BYTES
