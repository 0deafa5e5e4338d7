"""Checkpoints as files: what is written is read, and what is damaged is told."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.core.frozen_state import FrozenRun
from slammot_graph.core.spool import Spool
from slammot_graph.run_folder.checkpoint import CHECKPOINT_FILE, MAGIC, SCANS_FILE, CheckpointFile, notes_of


def frozen(n: int, *spools: Spool, state: bytes | None = b"state" * 1000) -> FrozenRun:
    return FrozenRun(fingerprint={"method": "graph"}, n_scans=n, digest=7 * n, state=state, spools=spools)


def test_what_was_written_last_is_read_and_goes_on(tmp_path: Path, rng: np.random.Generator) -> None:
    spools = Spool(1000), Spool(1000)
    file = CheckpointFile(tmp_path, {"recording": "abc"})
    for n in range(1, 6):
        for spool in spools:
            spool.add(rng.bytes(int(rng.integers(3000))))
        file.write(frozen(n, *spools))
        if n == 3:  # the process ends, another one goes on
            with (tmp_path / SCANS_FILE).open("ab") as scans:
                scans.write(b"what belongs to no checkpoint")
            file = CheckpointFile(tmp_path)
            got = file.read()
            assert got is not None
            spools = got.spools  # type: ignore[assignment]
    again = CheckpointFile(tmp_path)
    read = again.read()
    assert read is not None
    assert (read.n_scans, read.digest, read.state) == (5, 35, b"state" * 1000)
    assert read.fingerprint == {"method": "graph"}
    assert again.notes == notes_of(tmp_path) == {"recording": "abc"}
    assert [spool.since(0) for spool in read.spools] == [spool.since(0) for spool in spools]
    assert (tmp_path / SCANS_FILE).stat().st_size == sum(spool.n_bytes for spool in spools)
    again.remove()
    assert not list(tmp_path.iterdir())
    assert CheckpointFile(tmp_path).read() is None
    assert notes_of(tmp_path) == {}


def test_a_method_without_a_state(tmp_path: Path) -> None:
    CheckpointFile(tmp_path).write(frozen(4, state=None))
    read = CheckpointFile(tmp_path).read()
    assert read is not None
    assert (read.state, read.spools, read.n_scans) == (None, (), 4)
    assert not (tmp_path / SCANS_FILE).exists()


@pytest.mark.parametrize(
    ("name", "damage", "text"),
    [
        (CHECKPOINT_FILE, lambda data: b"x" + data[1:], "is no checkpoint of this version"),
        (
            CHECKPOINT_FILE,
            lambda data: data.replace(b"checkpoint 1", b"checkpoint 9"),
            "no checkpoint of this",
        ),
        (CHECKPOINT_FILE, lambda data: data[:-1], "is damaged"),
        (CHECKPOINT_FILE, lambda data: data[:-9] + b"\0" + data[-8:], "is damaged"),
        (CHECKPOINT_FILE, lambda data: data.replace(b'"n_bytes": 5000', b'"n_bytes": 4000'), "is damaged"),
        (CHECKPOINT_FILE, lambda data: data.replace(b'"n_bytes": 5000', b'"n_bytes": 1e99'), "is damaged"),
        (CHECKPOINT_FILE, lambda _: MAGIC + b"[" * 100_000, "is damaged"),
        (CHECKPOINT_FILE, lambda _: MAGIC + b"{}\n", "is damaged"),
        (CHECKPOINT_FILE, lambda _: b"", "no checkpoint of this version"),
        (SCANS_FILE, lambda data: data[:-1], "too short"),
        (SCANS_FILE, lambda data: data[:-1] + b"\xff", f"{SCANS_FILE} beside it is damaged"),
    ],
)
def test_damage_is_told_in_one_line(
    tmp_path: Path, name: str, damage: Callable[[bytes], bytes], text: str
) -> None:
    spool = Spool(1000)
    spool.add(bytes(range(200)))
    CheckpointFile(tmp_path).write(frozen(2, spool))
    path = tmp_path / name
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(InputError, match=text) as caught:
        CheckpointFile(tmp_path).read()
    assert "--overwrite to begin anew" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_scans_that_are_gone_are_told(tmp_path: Path) -> None:
    spool = Spool(1000)
    spool.add(b"abc")
    CheckpointFile(tmp_path).write(frozen(2, spool))
    (tmp_path / SCANS_FILE).unlink()
    with pytest.raises(InputError, match="cannot be read"):
        CheckpointFile(tmp_path).read()


def test_a_full_disk_leaves_the_last_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, spool = CheckpointFile(tmp_path), Spool(1000)
    spool.add(b"abc")
    file.write(frozen(1, spool))
    spool.add(b"def")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(InputError, match="No space left on device"):
        file.write(frozen(2, spool))
    read = CheckpointFile(tmp_path).read()
    assert read is not None
    assert read.n_scans == 1
    assert read.spools[0].since(0) == b"abc"
