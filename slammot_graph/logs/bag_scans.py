"""First pass over the scans of a bag: their stamps and frames, and where each frame's laser sits."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray, IntArray
from slammot_graph.logs.bag_messages import Bag, frame_name, header_stamp
from slammot_graph.logs.bag_mounting import FoundMounting, find_mounting
from slammot_graph.logs.bag_topics import Topic
from slammot_graph.logs.mounting import GivenPoses

NUMBER_WORDS = {2: "two", 3: "three", 4: "four"}


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanHeaders:
    """What the headers of n scan messages say.

    Attributes
    ----------
    stamps, bag_stamps : (n,) arrays
        By the header, NaN where the message cannot be decoded, and by the recorder [s].
    frames : mapping of str to int
        Frames of the lasers, each with its number of scans, in the order of the file.
    laser : (n,) int array
        Which laser took each scan; -1 where the message cannot be decoded.
    numbers : mapping of (topic, frame) to int
        The lasers.
    """

    stamps: FloatArray
    bag_stamps: FloatArray
    frames: Mapping[str, int]
    laser: IntArray
    numbers: Mapping[tuple[str, str], int]


@dataclass(frozen=True, kw_only=True)
class LaserFrames:
    """Mounting of each frame whose scans are used, the first frame the main one, and warnings."""

    mountings: Mapping[str, FoundMounting]
    warnings: tuple[str, ...]

    @property
    def first(self) -> FoundMounting:
        """That of the main frame."""
        return next(iter(self.mountings.values()))


def read_scan_headers(bag: Bag, topics: Sequence[Topic]) -> ScanHeaders:
    """Read the headers of all scans.

    Raises
    ------
    InputError
        No message can be decoded.
    """
    stamps, bag_stamps = [], []
    frames: Counter[str] = Counter()
    lasers: list[int] = []
    numbers: dict[tuple[str, str], int] = {}
    for message in bag.messages(topics):
        bag_stamps.append(message.bag_stamp)
        if message.content is None:
            stamps.append(np.nan)
            lasers.append(-1)
            continue
        stamps.append(header_stamp(message.content))
        frame = frame_name(message.content.header.frame_id)
        frames[frame] += 1
        lasers.append(numbers.setdefault((message.topic, frame), len(numbers)))
    names = topic_names(topics)
    if not frames:
        raise InputError(f"{bag.path}: the messages of {names} cannot be decoded; record the bag again")
    return ScanHeaders(
        stamps=np.array(stamps),
        bag_stamps=np.array(bag_stamps),
        frames=frames,
        laser=np.array(lasers, dtype=np.int64),
        numbers=numbers,
    )


def topic_names(topics: Sequence[Topic]) -> str:
    """The names of topics, for a person."""
    return ", ".join(topic.name for topic in topics)


MAX_SHIFT = 200
"""Scans of several lasers are brought into the order of their stamps as long as none moves by more places."""


def order_of_scans(stamps: FloatArray, laser: IntArray) -> IntArray:
    """(n,) numbers of the scan records in the order of their stamps (n,); the scans of each laser stay in theirs.

    Of one laser, or where the clocks of the lasers are too far apart, it is the order of the file.
    """
    in_file = np.arange(len(stamps), dtype=np.int64)
    if len(set(laser[laser >= 0].tolist())) < 2:
        return in_file
    rising = np.where(np.isfinite(stamps), stamps, -np.inf)
    for number in set(laser.tolist()) - {-1}:
        rising[laser == number] = np.maximum.accumulate(rising[laser == number])
    unknown = ~np.isfinite(rising)
    rising[unknown] = np.maximum.accumulate(rising)[unknown]
    order = np.argsort(rising, kind="stable").astype(np.int64)
    return order if np.abs(order - in_file).max(initial=0) <= MAX_SHIFT else in_file


def lags_differ(headers: ScanHeaders, most_s: float) -> bool:
    """Whether the headers of one laser lag recording by more than `most_s` more than those of another."""
    lags = headers.bag_stamps - headers.stamps
    medians = [float(np.median(lags[headers.laser == k])) for k in headers.numbers.values()]
    return max(medians) - min(medians) > most_s


def find_lasers(
    bag: Bag,
    topics: Sequence[Topic],
    frames: Mapping[str, int],
    base_frames: Sequence[str],
    given: GivenPoses,
) -> LaserFrames:
    """Mount the laser of each frame; of several, those that neither tf nor the user knows are left out.

    A pose given without a frame is that of the frame with the most scans: then no other is used, unless given too.

    Raises
    ------
    InputError
        A pose is given for a frame that has no scans.
    """
    unknown = [frame for frame in given if frame and frame not in frames]
    if unknown:
        known = ", ".join(frame or "(unnamed)" for frame in frames)
        raise InputError(
            f"{bag.path}: --laser-pose names the frame {unknown[0]}, but the frames of the scans are {known}"
        )
    any_frame = given.get("")
    found = {frame: find_mounting(bag, base_frames, frame, given.get(frame, any_frame)) for frame in frames}
    if len(frames) == 1:
        (only,) = found.values()
        return LaserFrames(mountings=found, warnings=only.warnings)
    main = max(frames, key=frames.__getitem__)
    named = {frame: x for frame, x in found.items() if frame in given or x.told_by == "tf"}
    used = named or {main: found[main]}
    number = NUMBER_WORDS.get(len(frames), str(len(frames)))
    counts = ", ".join(f"{frame or '(unnamed)'} {n}" for frame, n in frames.items())
    if len(used) == len(frames):
        what = "each scan is used by its own frame's place on the robot"
    else:
        kept = ", ".join(frame or "(unnamed)" for frame in used)
        why = (
            "the laser pose is given for one"
            if any_frame is not None
            else "tf does not tell where the others sit"
        )
        what = f"only scans of {kept} are used, as {why}"
    where = f"one topic {topics[0].name}" if len(topics) == 1 else topic_names(topics)
    told = f"{number} frames (lasers) on {where} (scans: {counts}); {what}"
    return LaserFrames(mountings=used, warnings=(told, *(w for x in used.values() for w in x.warnings)))
