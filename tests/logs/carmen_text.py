"""Lines of CARMEN logs for the tests."""

import bz2
import gzip
from collections.abc import Sequence
from pathlib import Path

END = "host 0.5"


def flaser(
    ranges: Sequence[object],
    stamp: object,
    odometry: Sequence[object] = (0.0, 0.0, 0.0),
    laser: Sequence[object] | None = None,
    kind: str = "FLASER",
) -> str:
    tokens = [kind, len(ranges), *ranges, *(odometry if laser is None else laser), *odometry, stamp, END]
    return " ".join(map(str, tokens))


def robotlaser(
    ranges: Sequence[object],
    stamp: object,
    start: object = -1.570796,
    robot: Sequence[object] = (0.0, 0.0, 0.0),
    laser: Sequence[object] | None = None,
    remissions: Sequence[object] = (),
) -> str:
    geometry = [0, start, 3.141593, 0.017453, 81.9, 0.01, 0]
    poses = [*(robot if laser is None else laser), *robot]
    tokens = ["ROBOTLASER1", *geometry, len(ranges), *ranges, len(remissions), *remissions, *poses]
    return " ".join(map(str, [*tokens, 0, 0, 0, 0, 0, stamp, END]))


def write_log(path: Path, lines: Sequence[str]) -> Path:
    data = "".join(line + "\n" for line in lines).encode()
    if path.suffix == ".gz":
        data = gzip.compress(data)
    elif path.suffix == ".bz2":
        data = bz2.compress(data)
    path.write_bytes(data)
    return path
