"""Tracks and truth in the MOTChallenge text format, for other evaluators (trackeval, py-motmetrics).

A line is ``frame, id, left, top, width, height, flag, x, y, z``: frames and identities from 1, the place as a square of
`BOX_M` around it and as x, y [m], z = 0. In the truth flag 0 marks an object that too few beams hit, which is not to
be judged. Identities of the truth are those of appearances. Squares of `BOX_M` overlap by a half or more (IoU 1/3) at
up to 0.5 m along an axis; evaluators that take distances should use x and y.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.evaluation.objects import EstimatedTracks, TrueObjects, true_places

BOX_M = 1.0
"""Side of the square around a place."""


def write_mot_challenge(folder: Path, truth: TrueObjects, estimate: EstimatedTracks) -> None:
    """Write ``gt.txt``, the truth in the map of the estimate, and ``tracks.txt`` into a folder, which is made.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    frames, appearances, places, is_seen = true_places(truth, estimate.T_map_base)
    known = appearances >= 0
    files = {
        "gt.txt": _lines(frames[known], appearances[known], places[known], is_seen[known].astype(np.int64)),
        "tracks.txt": _lines(
            estimate.frames, estimate.ids, estimate.positions, np.ones(len(estimate.frames), dtype=np.int64)
        ),
    }
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, lines in files.items():
            (folder / name).write_text("".join(lines), encoding="ascii")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror or error})") from None


def _lines(frames: IntArray, ids: IntArray, places: FloatArray, flags: IntArray) -> Iterator[str]:
    order = np.lexsort((ids, frames))
    columns = (frames[order].tolist(), ids[order].tolist(), places[order].tolist(), flags[order].tolist())
    for frame, number, (x, y), flag in zip(*columns, strict=True):
        left, top = x - 0.5 * BOX_M, y - 0.5 * BOX_M
        yield (
            f"{frame + 1},{number + 1},{left:.4f},{top:.4f},{BOX_M:g},{BOX_M:g},{flag},{x:.4f},{y:.4f},0\n"
        )
