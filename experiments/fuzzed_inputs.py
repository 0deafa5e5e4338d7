"""Damaged files of every kind, counted: ``python -m experiments.fuzzed_inputs``.

Sound small files are damaged at random (bytes overwritten, cut off, doubled; numbers in the place of others; odd words)
and read. Told for each reader: how many were read, how many were told in a line (`SlammotError`), how many exceptions
were neither, the longest time and the memory. ``tests/fuzz`` does the same with hypothesis, which makes failures small.
"""

import resource
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from experiments.common import Options, Scores, main, run_cells
from experiments.damaged_files import CHANGES, FILES, changed, sound_files
from experiments.tables import Table, write_tables
from slammot_graph.core.config import load_config
from slammot_graph.core.errors import SlammotError
from slammot_graph.core.frozen_state import thaw
from slammot_graph.core.saved_map import SavedMap
from slammot_graph.logs import open_log
from slammot_graph.methods import get_method
from slammot_graph.run_folder.checkpoint import CHECKPOINT_FILE, SCANS_FILE, CheckpointFile
from slammot_graph.run_folder.reader import read_run_folder

N_OF_CELL = 5_000
N_CELLS = {
    **dict.fromkeys(("log .npz", "log .log"), 20),
    **dict.fromkeys(("log .bag", "log .db3", "log .mcap"), 4),
    **dict.fromkeys((f"folder {name}" for name in FILES), 16),
    "map map.slam": 16,
    f"checkpoint {CHECKPOINT_FILE}": 10,
    f"checkpoint {SCANS_FILE}": 4,
    "settings": 20,
}


def experiment(options: Options) -> None:
    """Damage and read."""
    n = 200 if options.quick else N_OF_CELL
    cells = {
        f"{kind} {seed} {n}": {"kind": kind, "seed": seed, "n": n}
        for kind, n_cells in N_CELLS.items()
        for seed in range(1 if options.quick else n_cells)
    }
    scores = run_cells("fuzzed_inputs", fuzz, cells, options)
    rows, total = [], np.zeros(4, dtype=np.int64)
    for kind in N_CELLS:
        of_kind = [one for key, one in scores.items() if key.startswith(f"{kind} ")]
        counts = np.array([[one[x] for x in ("n", "n_read", "n_told", "n_uncaught")] for one in of_kind]).sum(
            axis=0
        )
        total += counts
        longest_s = max(float(one["longest_s"]) for one in of_kind)
        peak_mb = max(float(one["peak_mb"]) for one in of_kind)
        kinds = sorted({name for one in of_kind for name in one["uncaught"]})
        rows.append([kind, *map(str, counts), f"{longest_s:.2f}", f"{peak_mb:.0f}", ", ".join(kinds) or "-"])
    rows.append(["all", *map(str, total), "", "", ""])
    table = Table(
        heading="Damaged files",
        columns=(
            "reader",
            "inputs",
            "read",
            "told in a line",
            "uncaught",
            "longest [s]",
            "peak memory [MB]",
            "what",
        ),
        rows=rows,
    )
    notes = ["Peak memory: of the process that read them, which also makes the sound files by a short run."]
    write_tables("fuzzed_inputs", "Damaged files", notes, [table], options)


def fuzz(kind: str, seed: int, n: int) -> Scores:
    """Read n damaged files of a kind."""
    warnings.simplefilter("ignore")
    what, _, name = kind.partition(" ")
    sound = sound_files()
    rng = np.random.default_rng([seed, *kind.encode()])
    uncaught: dict[str, str] = {}
    n_read = n_told = n_uncaught = 0
    longest_s = 0.0
    with tempfile.TemporaryDirectory() as place:
        read, path = _reader(what, name, Path(place), sound)
        for _ in range(n):
            path.write_bytes(damaged(sound[f"{what} {name}".strip()], rng))
            start_s = time.perf_counter()
            try:
                read()
                n_read += 1
            except SlammotError:
                n_told += 1
            except Exception as error:  # what is looked for
                n_uncaught += 1
                uncaught[type(error).__name__] = repr(error)[:200]
            longest_s = max(longest_s, time.perf_counter() - start_s)
    return {
        "n": n,
        "n_read": n_read,
        "n_told": n_told,
        "n_uncaught": n_uncaught,
        "uncaught": uncaught,
        "longest_s": longest_s,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Change some bytes, one to four times; one in sixteen changes cuts off what follows."""
    for _ in range(int(rng.integers(1, 5))):
        change = rng.choice(CHANGES, p=[0.235, 0.06, 0.235, 0.235, 0.235])
        data = changed(data, change, float(rng.random()), int(rng.integers(256)))
    return data


def _reader(
    what: str, name: str, folder: Path, sound: Mapping[str, bytes]
) -> tuple[Callable[[], object], Path]:
    """What reads the damaged file, and where that is; the sound ones beside it are there."""
    beside = {
        "trajectory.tum",
        name,
        "map.yaml" if name == "map.pgm" else "",
        "map.pgm" if name == "map.yaml" else "",
    }
    for key, data in sound.items():
        of, _, file = key.partition(" ")
        if of == what and (what == "checkpoint" or (what == "folder" and file in beside)):
            (folder / file).write_bytes(data)
    if what == "log":
        path = folder / f"damaged{name}"
        return lambda: [scan.stamp for scan in open_log(path)], path
    if what == "folder":
        return lambda: read_run_folder(folder), folder / name
    if what == "map":
        return lambda: SavedMap.load(folder), folder / name
    if what == "checkpoint":
        return lambda: _thawed(folder), folder / name
    path = folder / "settings.toml"
    return lambda: load_config(path, get_method("graph").config), path


def _thawed(folder: Path) -> object:
    frozen = CheckpointFile(folder).read()
    if frozen is None or frozen.state is None:
        return None
    return thaw(frozen.state, frozen.spools, None)


if __name__ == "__main__":
    sys.exit(main(experiment))
