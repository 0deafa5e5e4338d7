"""``map.pgm`` and ``map.yaml``: a map of three states in the format of ROS map_server."""

import math
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from slammot_graph.core.errors import InputError
from slammot_graph.core.files import MOST_SETTINGS_BYTES, check_regular
from slammot_graph.core.number_rows import MOST_SENSIBLE
from slammot_graph.core.results import FREE_BELOW, OCCUPIED_ABOVE, GridMap
from slammot_graph.run_folder.atomic import replacing, write_text

FREE, OCCUPIED, UNKNOWN = 254, 0, 205
"""Grey values of ``map.pgm``, as map_server's own saver writes them."""
FREE_THRESH = 0.196
"""Of ``map.yaml``: map_server reads grey 205 as 50 / 255 = 0.19608, so with 0.2 unknown cells became free."""
DEFAULT_FREE_THRESH, DEFAULT_OCCUPIED_THRESH = 0.196, 0.65
"""What map_server takes where a ``map.yaml`` has no thresholds."""
MOST_CELLS = 100_000_000
"""Of a picture that is read."""
EMPTY_RESOLUTION_M = 0.05
"""Cell size of the map of a folder that has none."""


def write_map(image: Path, description: Path, grid: GridMap) -> None:
    """Write the three states of a map's cells, and the file with the picture's origin and scale.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    with replacing(image) as path:
        path.write_bytes(_pgm(grid))
    write_text(description, _description(image.name, grid))


def read_map(path: Path) -> GridMap:
    """Read a map by its ``map.yaml``; where that is missing, give a map without cells.

    Raises
    ------
    InputError
        It is not a map of map_server, its picture cannot be read, or it is rotated.
    """
    if not path.exists():
        return GridMap(p_occupied=np.zeros((0, 0)), resolution_m=EMPTY_RESOLUTION_M, origin=np.zeros(2))
    check_regular(path, MOST_SETTINGS_BYTES)
    try:
        keys = dict(_yaml_lines(path.read_text(encoding="utf-8").splitlines()))
        resolution_m = float(keys["resolution"])
        x, y, yaw = (float(word) for word in keys["origin"].strip("[]").split(","))
        negate = int(keys.get("negate", "0"))
        free_below = float(keys.get("free_thresh", DEFAULT_FREE_THRESH))
        occupied_above = float(keys.get("occupied_thresh", DEFAULT_OCCUPIED_THRESH))
        image = path.parent / keys["image"]
    except (OSError, ValueError, KeyError, OverflowError):
        raise InputError(f"{path}: not a map of ROS map_server (image, resolution, origin)") from None
    if yaw != 0.0 or not 0.0 < resolution_m < math.inf:
        raise InputError(f"{path}: a map that is turned or has no size cannot be shown; remove it")
    if not (abs(x) < MOST_SENSIBLE and abs(y) < MOST_SENSIBLE and math.isfinite(free_below + occupied_above)):
        raise InputError(f"{path}: its origin or its thresholds are no sensible numbers; run it again")
    grey = np.flipud(_read_image(image)).astype(np.float64)  # row 0 of the image is the top
    shade = (grey if negate else 255.0 - grey) / 255.0
    p_occupied = np.where(shade > occupied_above, 1.0, np.where(shade < free_below, 0.0, np.nan))
    return GridMap(p_occupied=p_occupied, resolution_m=resolution_m, origin=np.array([x, y]))


def _pgm(grid: GridMap) -> bytes:
    """Three states of the cells as a binary PGM; its row 0 is the top, that of a `GridMap` the lowest y."""
    with np.errstate(invalid="ignore"):
        is_free, is_occupied = grid.p_occupied < FREE_BELOW, grid.p_occupied > OCCUPIED_ABOVE
    grey = np.full(grid.p_occupied.shape, UNKNOWN, dtype=np.uint8)
    grey[is_free], grey[is_occupied] = FREE, OCCUPIED
    n_rows, n_cols = grid.p_occupied.shape
    return f"P5\n{n_cols} {n_rows}\n255\n".encode("ascii") + np.flipud(grey).tobytes()


def _description(image: str, grid: GridMap) -> list[str]:
    x, y = grid.origin.tolist()
    return [
        f"image: {image}",
        "mode: trinary",
        f"resolution: {float(grid.resolution_m)!r}",
        f"origin: [{x:.9f}, {y:.9f}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_ABOVE}",
        f"free_thresh: {FREE_THRESH}",
    ]


def _yaml_lines(lines: Iterable[str]) -> Iterator[tuple[str, str]]:
    for line in lines:
        key, separator, value = line.partition(":")
        if separator and not line.lstrip().startswith("#"):
            yield key.strip(), value.split(" #", 1)[0].strip().strip("\"'")


def _read_image(path: Path) -> npt.NDArray[np.uint8]:
    from PIL import Image

    check_regular(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path) as image:
                n_cols, n_rows = image.size
                if n_cols * n_rows > MOST_CELLS:
                    raise InputError(
                        f"{path}: a picture of {n_cols} x {n_rows} cells, more than the {MOST_CELLS // 10**6} million"
                        " that a map may have; cut it, or make it coarser"
                    )
                return np.asarray(image.convert("L"))
    except Image.DecompressionBombError:
        raise InputError(
            f"{path}: a picture of more cells than the {MOST_CELLS // 10**6} million that a map may have; cut it, or"
            " make it coarser"
        ) from None
    except (OSError, ValueError, SyntaxError, MemoryError, OverflowError, TypeError):
        raise InputError(f"{path}: not a picture that can be read; run it again") from None
