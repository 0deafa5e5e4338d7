"""What was added is read back, whatever becomes of the temporary file."""

import numpy as np
import pytest

from slammot_graph.core import spool
from slammot_graph.core.spool import Spool


class DiskOf:
    """A temporary file on a disk of so many bytes."""

    def __init__(self, n_bytes: int) -> None:
        self.n_bytes, self.data, self.at = n_bytes, bytearray(), 0

    def __call__(self, **_: object) -> "DiskOf":
        return self

    def seek(self, at: int) -> None:
        self.at = at

    def truncate(self, n: int) -> None:
        del self.data[n:]

    def read(self, n: int) -> bytes:
        return bytes(self.data[self.at : self.at + n])

    def write(self, data: memoryview) -> int:
        n = min(len(data), self.n_bytes - self.at, 100)  # a raw file may take less than it was given
        if n <= 0:
            raise OSError(28, "No space left on device")
        self.data[self.at : self.at + n] = data[:n]
        self.at += n
        return n

    def close(self) -> None:
        pass


@pytest.mark.parametrize("disk_bytes", [0, 150, 1000, 2600, 1 << 20])
def test_what_was_added_is_read_back(
    disk_bytes: int, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    disk = DiskOf(disk_bytes)
    monkeypatch.setattr("tempfile.TemporaryFile", disk)
    monkeypatch.setattr(spool, "_PIECE_BYTES", 300)
    kept = Spool(500)
    pieces = [rng.bytes(int(n)) for n in rng.integers(1, 120, 80)]
    places = []
    for k, piece in enumerate(pieces):
        places.append(kept.add(piece))
        j = k // 2
        assert kept.read(places[j], len(pieces[j])) == pieces[j]
    assert [kept.read(place, len(piece)) for place, piece in zip(places, pieces, strict=True)] == pieces
    assert kept.n_bytes == sum(map(len, pieces))
    assert len(disk.data) <= disk_bytes
    assert (len(disk.data) > 0) == (disk_bytes > 600)
    kept.close()


def test_a_real_file(rng: np.random.Generator) -> None:
    kept = Spool(1000)
    pieces = [rng.bytes(700) for _ in range(5)]
    places = [kept.add(piece) for piece in pieces]
    assert [kept.read(place, 700) for place in places] == pieces
    kept.close()


@pytest.mark.parametrize("most_in_memory", [10, 10_000])
def test_all_from_any_place_on(most_in_memory: int) -> None:
    spool, data = Spool(most_in_memory), bytes(range(256)) * 4
    places = [spool.add(data[k : k + 8]) for k in range(0, len(data), 8)]
    for place in (places[0], places[5], places[-1], len(data)):
        assert spool.since(place) == data[place:]
    found = b""
    while piece := spool.read_some(len(found), 100):
        found += piece
    assert found == data
    spool.add(b"more")
    assert spool.since(len(data)) == b"more"
    spool.close()
