"""Messages of a ROS 1 or ROS 2 bag, with every failure of the reader raised as an `InputError`."""

import math
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader as Reader1
from rosbags.typesys import Stores, get_typestore

from slammot_graph.core.errors import InputError
from slammot_graph.logs.bag_index import read_long_indices
from slammot_graph.logs.bag_runs import BagRun, runs_of
from slammot_graph.logs.bag_topics import Topic
from slammot_graph.logs.base import one_line


class BagMessage(NamedTuple):
    """One message of a bag.

    Attributes
    ----------
    number : int
        Which message of the ones asked for, from 1.
    bag_stamp : float
        When it was recorded [s].
    content : object or None
        The message as rosbags decodes it; None where it cannot be decoded.
    topic : str
    """

    number: int
    bag_stamp: float
    content: Any
    topic: str = ""


class Bag:
    """An open bag, from `open_bag`.

    Attributes
    ----------
    path : Path
    topics : list of Topic
    """

    def __init__(self, path: Path, reader: AnyReader) -> None:
        self.path = path
        self._reader = reader
        counts: dict[tuple[str, str], int] = {}
        for connection in reader.connections:
            key = (connection.topic, connection.msgtype)
            counts[key] = counts.get(key, 0) + connection.msgcount
        self._runs = [
            (part, run) for part in reader.readers if isinstance(part, Reader1) for run in runs_of(part)
        ]
        self.topics = [Topic(name=name, msgtype=kind, n_messages=n) for (name, kind), n in counts.items()]

    def messages(
        self, topics: Sequence[Topic], *, first_seconds: float | None = None
    ) -> Generator[BagMessage, None, None]:
        """Messages of some topics in the order of recording, all or those of the bag's first seconds.

        Where recording times begin again, those of the later runs are moved behind the earlier ones'.

        Raises
        ------
        InputError
            The bag is damaged here.
        """
        names = {(x.name, x.msgtype) for x in topics}
        connections = [x for x in self._reader.connections if (x.topic, x.msgtype) in names]
        if not connections:
            return  # rosbags would take an empty choice for all topics
        number = 0
        runs: list[tuple[Reader1 | None, BagRun | None]] = [*self._runs] or [(None, None)]
        for part, run in runs if first_seconds is None else runs[:1]:
            if part is not None and run is not None:
                part.indexes = run.indexes  # read when the first message is asked for
            stop = self._stop(first_seconds, run)
            with closing(self._reader.messages(connections, stop=stop)) as stream:
                while (record := self._next(stream)) is not None:
                    connection, time_ns, raw = record
                    number += 1
                    bag_stamp = float(time_ns) * 1e-9 + (0.0 if run is None else run.shift_s)
                    yield BagMessage(
                        number, bag_stamp, self._decode(raw, connection.msgtype), connection.topic
                    )

    def _next(self, stream: Iterator[tuple[Any, int, bytes]]) -> tuple[Any, int, bytes] | None:
        try:
            return next(stream, None)
        except Exception as err:  # the decoders of a damaged file may raise anything
            raise _unreadable(self.path, err) from None

    def _stop(self, first_seconds: float | None, run: BagRun | None) -> int | None:
        """Where the bag's first seconds end [ns]; None for all of it."""
        if first_seconds is None:
            return None
        try:
            start_ns = self._reader.start_time if run is None else run.start_ns
            return int(start_ns + int(first_seconds * 1e9))
        except Exception as err:  # as above, of damaged metadata
            raise _unreadable(self.path, err) from None

    def _decode(self, raw: bytes, msgtype: str) -> Any:
        try:
            return self._reader.deserialize(raw, msgtype)
        except Exception:  # as above; the caller leaves this message out and says so
            return None


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a ``.bag``, a ROS 2 bag folder, a ``.db3`` or a ``.mcap`` file and close it again.

    Raises
    ------
    InputError
        It is not a bag, truncated, or not indexed.
    """
    try:
        reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        for part in reader.readers:
            if isinstance(part, Reader1):
                read_long_indices(part)
        reader.open()
    except Exception as err:  # the decoders of a damaged file may raise anything
        raise _unreadable(path, err) from None
    try:
        try:
            bag = Bag(path, reader)
        except Exception as err:  # as above, of damaged metadata
            raise _unreadable(path, err) from None
        yield bag
    finally:
        reader.close()


def _unreadable(path: Path, err: Exception) -> InputError:
    tool = {".bag": "rosbag reindex", ".mcap": "mcap recover", ".db3": "sqlite3 .recover"}
    remedy = tool.get(path.suffix, "ros2 bag reindex")
    return InputError(
        f"{path}: the bag is damaged or truncated ({one_line(err)}); copy it again, or repair it with `{remedy}`"
    )


def transforms(message: BagMessage) -> Sequence[Any]:
    """Transforms of a tf message; none where it could not be decoded."""
    return () if message.content is None else message.content.transforms


def header_stamp(content: Any) -> float:
    """Time in a message's header [s]."""
    return float(content.header.stamp.sec + content.header.stamp.nanosec * 1e-9)


def frame_name(name: str) -> str:
    """A frame's name without the leading slash of older ROS."""
    return name.lstrip("/")


def planar_pose(position: Any, orientation: Any) -> tuple[float, float, float]:
    """x, y [m] and the heading [rad] of a pose in space; the heading of a zero quaternion is not a number."""
    qx, qy, qz, qw = orientation.x, orientation.y, orientation.z, orientation.w
    if qx == qy == qz == qw == 0.0:
        return position.x, position.y, math.nan
    theta = math.atan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
    return position.x, position.y, theta
