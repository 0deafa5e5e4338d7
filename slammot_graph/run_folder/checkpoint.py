"""``run.checkpoint`` and ``run.checkpoint.scans``: from which an interrupted run goes on.

``run.checkpoint`` is written anew each time, atomically: a line that names the format, a line of JSON (what it is bound
to, lengths and checksums), and the compressed state. ``run.checkpoint.scans`` is only added to: what is kept of each
scan; where an end of it belongs to no checkpoint, it is cut off.
"""

import hashlib
import json
import os
import zlib
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from slammot_graph.core.errors import InputError
from slammot_graph.core.frozen_state import FrozenRun
from slammot_graph.core.spool import MOST_IN_MEMORY, Spool
from slammot_graph.run_folder.atomic import replacing, write_errors

CHECKPOINT_FILE = "run.checkpoint"
SCANS_FILE = "run.checkpoint.scans"
MAGIC = b"slammot-graph checkpoint 1\n"

_MOST_HEADER_BYTES = 16 << 20
_MOST_STATE_BYTES = 8 << 30
_PIECE_BYTES = 1 << 20


class CheckpointFile:
    """The checkpoint of a run folder, written again and again.

    Parameters
    ----------
    folder : Path
    notes : mapping of str to str
        Kept with it.
    """

    def __init__(self, folder: Path, notes: dict[str, str] | None = None) -> None:
        self.notes = notes or {}
        self._path = folder / CHECKPOINT_FILE
        self._scans = folder / SCANS_FILE
        self._pieces: list[list[tuple[int, int, int]]] = []
        self._n_bytes = 0

    def write(self, frozen: FrozenRun) -> None:
        """Replace the last one.

        Raises
        ------
        InputError
            It cannot be written; the last one stays.
        """
        pieces = self._added(frozen.spools)
        state = b"" if frozen.state is None else zlib.compress(frozen.state, 1)
        header = {
            "fingerprint": dict(frozen.fingerprint),
            "notes": self.notes,
            "n_scans": frozen.n_scans,
            "digest": frozen.digest,
            "pieces": pieces,
            "n_bytes": None if frozen.state is None else len(frozen.state),
            "sha256": hashlib.sha256(state).hexdigest(),
        }
        with replacing(self._path) as temporary, temporary.open("wb") as file:
            file.write(MAGIC)
            file.write(json.dumps(header).encode() + b"\n")
            file.write(state)
            file.flush()
            os.fsync(file.fileno())
        self._pieces = pieces

    def exists(self) -> bool:
        """Tell whether there is one."""
        return self._path.exists()

    def remove(self) -> None:
        """Remove it: the run is over."""
        for path in (self._path, self._scans):
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def read(self) -> FrozenRun | None:
        """Read what was written last, and go on from there; None where there is none.

        Raises
        ------
        InputError
            It is damaged.
        """
        try:
            with self._path.open("rb") as file:
                known = _header(file)
                packed = file.read(_MOST_STATE_BYTES)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"{self._path}: cannot be read ({error.strerror or error})") from error
        except (ValueError, RecursionError):
            raise self._damaged("is damaged") from None
        if known is None:
            raise self._damaged("is no checkpoint of this version")
        try:
            if hashlib.sha256(packed).hexdigest() != known["sha256"]:
                raise self._damaged("is damaged")
            n_bytes, state = known["n_bytes"], None
            if n_bytes is not None:
                state = _unpacked(packed, int(n_bytes))
            self.notes = {str(key): str(text) for key, text in known["notes"].items()}
            self._pieces = [[(int(a), int(n), int(crc)) for a, n, crc in one] for one in known["pieces"]]
            frozen = FrozenRun(
                fingerprint={str(key): str(text) for key, text in known["fingerprint"].items()},
                n_scans=int(known["n_scans"]),
                digest=int(known["digest"]),
                state=state,
                spools=tuple(self._spool(pieces) for pieces in self._pieces),
            )
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, zlib.error):
            raise self._damaged("is damaged") from None
        self._n_bytes = max((place + n for one in self._pieces for place, n, _ in one), default=0)
        return frozen

    def _damaged(self, how: str) -> InputError:
        return InputError(f"{self._path}: {how}; run with --overwrite to begin anew")

    def _added(self, spools: tuple[Spool, ...]) -> list[list[tuple[int, int, int]]]:
        """Add what is new of each spool; gives the place, length and checksum of all pieces of each."""
        pieces = [list(one) for one in self._pieces] or [[] for _ in spools]
        if not spools:
            return pieces
        end = self._n_bytes
        with (
            write_errors(self._scans, "free some space or pass --checkpoint-every 0"),
            self._scans.open("r+b" if self._scans.exists() else "w+b") as file,
        ):
            file.truncate(end)
            file.seek(end)
            for spool, own in zip(spools, pieces, strict=True):
                start, n = end, 0
                crc = 0
                place = sum(n for _, n, _ in own)
                while data := spool.read_some(place + n, _PIECE_BYTES):
                    file.write(data)
                    crc = zlib.crc32(data, crc)
                    n += len(data)
                if n:
                    own.append((start, n, crc))
                end += n
            file.flush()
            os.fsync(file.fileno())
        self._n_bytes = end
        return pieces

    def _spool(self, pieces: list[tuple[int, int, int]]) -> Spool:
        spool = Spool(MOST_IN_MEMORY)
        try:
            with self._scans.open("rb") as file:
                for place, n, crc in pieces:
                    file.seek(place)
                    found, left = 0, n
                    while left > 0:
                        data = file.read(min(left, _PIECE_BYTES))
                        if not data:
                            raise self._damaged(f"{SCANS_FILE} beside it is too short, it is damaged")
                        found = zlib.crc32(data, found)
                        spool.add(data)
                        left -= len(data)
                    if found != crc:
                        raise self._damaged(f"{SCANS_FILE} beside it is damaged")
        except OSError as error:
            raise self._damaged(
                f"{SCANS_FILE} beside it cannot be read ({error.strerror or error})"
            ) from error
        return spool


def _header(file: IO[bytes]) -> Any:
    """What the two first lines of a checkpoint say; None of a file of another format.

    Raises
    ------
    ValueError, RecursionError
        The second line is not JSON.
    """
    if file.read(len(MAGIC)) != MAGIC:
        return None
    return json.loads(file.readline(_MOST_HEADER_BYTES))


def _unpacked(packed: bytes, n_bytes: int) -> bytes:
    if not 0 <= n_bytes <= _MOST_STATE_BYTES:
        raise ValueError("a state of no sensible size")
    unpacker = zlib.decompressobj()
    state = unpacker.decompress(packed, n_bytes + 1)
    if len(state) != n_bytes:
        raise ValueError("not the state that was written")
    return state


def notes_of(folder: Path) -> dict[str, Any]:
    """Give the notes of a folder's checkpoint; empty where there is none that can be read."""
    with (
        suppress(OSError, ValueError, KeyError, TypeError, RecursionError),
        (folder / CHECKPOINT_FILE).open("rb") as file,
    ):
        notes = (_header(file) or {"notes": None})["notes"]
        return notes if isinstance(notes, dict) else {}
    return {}
