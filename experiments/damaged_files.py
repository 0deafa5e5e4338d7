"""Small sound files of every kind that is read, and how they are damaged: for `fuzzed_inputs` and ``tests/fuzz``."""

import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np

from slammot_graph.core.config import to_toml
from slammot_graph.logs import write_npz_log
from slammot_graph.methods import get_method
from slammot_graph.run import Run
from slammot_graph.run_folder.checkpoint import CHECKPOINT_FILE, SCANS_FILE, CheckpointFile
from slammot_graph.run_folder.writer import write_run_folder
from slammot_graph.simulation import simulate

WORDS = (
    b"nan",
    b"-inf",
    b"1e308",
    b"-1",
    b"0",
    b"9" * 400,
    b"\xff\xfe",
    b"\n\n\n",
    b"[" * 2000,
    b"",
    bytes(8),
)
CARMEN = b"\n".join(
    b"FLASER 5 1.0 2.0 3.0 2.5 1.5 %d.0 0.0 0.0 %d.0 0.0 0.0 %d.0 host %d.0" % (k, k, k, k) for k in range(3)
)
FILES = (
    "trajectory.tum",
    "summary.json",
    "tracks.csv",
    "covariances.npz",
    "points.npz",
    "map.pgm",
    "map.yaml",
)
CHANGES = ("flip", "cut", "double", "noise", "word")
MOST_WORD_BYTES = 400


def changed(data: bytes, change: str, place: float, value: int) -> bytes:
    """Overwrite a byte or eight, cut off what follows, double some bytes, or put an odd word in.

    Parameters
    ----------
    data : bytes
    change : one of `CHANGES`
    place : float
        Where, as a share of all.
    value : int
        Less than 256.
    """
    k = int(place * max(len(data) - 1, 0))
    if change == "flip":
        return data[:k] + bytes([value]) + data[k + 1 :]
    if change == "cut":
        return data[:k]
    if change == "double":
        return data[:k] + data[k : k + value] + data[k:]
    if change == "noise":
        noise = np.random.default_rng(value).integers(256, size=8, dtype=np.uint8)
        return data[:k] + noise.tobytes() + data[k + 8 :]
    end = next((j for j in range(k, min(k + MOST_WORD_BYTES, len(data))) if data[j : j + 1] in b" ,\n=]"), k)
    return data[:k] + WORDS[value % len(WORDS)] + data[end:]


@cache
def sound_files() -> Mapping[str, bytes]:
    """The sound files of all kinds, by reader and name."""
    from tests.logs import bag_files

    found = {"log .log": CARMEN, "settings": to_toml(get_method("graph").config).encode()}
    messages = [
        m
        for k in range(3)
        for m in (bag_files.scan(100.0 + k), bag_files.odometry(100.0 + k, (0.1 * k, 0.0, 0.0)))
    ]
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        found["log .bag"] = bag_files.write_bag(folder, messages, "bag").read_bytes()
        for kind, suffix in (("sqlite3", ".db3"), ("mcap", ".mcap")):
            (folder / kind).mkdir()
            bag_files.write_bag(folder / kind, messages, kind)
            found[f"log {suffix}"] = next((folder / kind).rglob(f"*{suffix}")).read_bytes()
        write_npz_log(
            folder / "log.npz",
            stamps=np.arange(3.0),
            ranges=np.full((3, 20), 2.0),
            angle_min=-1.0,
            angle_increment=0.1,
            range_min=0.1,
            range_max=9.0,
            odometry=np.zeros((3, 3)),
        )
        found["log .npz"] = (folder / "log.npz").read_bytes()
        run = Run(simulate("two-walkers", seed=0), max_scans=12)
        for number, _ in enumerate(run, start=1):
            if number == 8:
                CheckpointFile(folder).write(run.freeze())
        for name in (CHECKPOINT_FILE, SCANS_FILE):
            found[f"checkpoint {name}"] = (folder / name).read_bytes()
        write_run_folder(folder / "run", run.result())
        for name in FILES:
            found[f"folder {name}"] = (folder / "run" / name).read_bytes()
        found["map map.slam"] = (folder / "run" / "map.slam").read_bytes()
    return found
