"""First pass over the scans of a bag: their stamps and frames, and where each frame's laser sits."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from slammot_graph.core.errors import InputError
from slammot_graph.core.types import FloatArray
from slammot_graph.logs.bag_messages import Bag, frame_name, header_stamp
from slammot_graph.logs.bag_mounting import FoundMounting, find_mounting
from slammot_graph.logs.bag_topics import Topic

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
    """

    stamps: FloatArray
    bag_stamps: FloatArray
    frames: Mapping[str, int]


@dataclass(frozen=True, kw_only=True)
class LaserFrames:
    """Mounting of each frame whose scans are used, the first frame the main one, and warnings."""

    mountings: Mapping[str, FoundMounting]
    warnings: tuple[str, ...]

    @property
    def first(self) -> FoundMounting:
        """That of the main frame."""
        return next(iter(self.mountings.values()))


def read_scan_headers(bag: Bag, topic: Topic) -> ScanHeaders:
    """Read the headers of all scans.

    Raises
    ------
    InputError
        No message can be decoded.
    """
    stamps, bag_stamps = [], []
    frames: Counter[str] = Counter()
    for message in bag.messages([topic]):
        bag_stamps.append(message.bag_stamp)
        if message.content is None:
            stamps.append(np.nan)
            continue
        stamps.append(header_stamp(message.content))
        frames[frame_name(message.content.header.frame_id)] += 1
    if not frames:
        raise InputError(f"{bag.path}: the messages of {topic.name} cannot be decoded; record the bag again")
    return ScanHeaders(stamps=np.array(stamps), bag_stamps=np.array(bag_stamps), frames=frames)


def find_lasers(
    bag: Bag,
    topic: Topic,
    frames: Mapping[str, int],
    base_frames: Sequence[str],
    laser_pose: tuple[float, float, float] | None,
) -> LaserFrames:
    """Mount the laser of each frame; of several, those that tf does not know are left out.

    A given laser pose (x, y, theta) [m, m, rad] is that of the frame with the most scans: then no other is used.
    """
    found = {frame: find_mounting(bag, base_frames, frame, laser_pose) for frame in frames}
    if len(frames) == 1:
        (only,) = found.values()
        return LaserFrames(mountings=found, warnings=only.warnings)
    main = max(frames, key=frames.__getitem__)
    used = {frame: x for frame, x in found.items() if x.told_by == "tf"} or {main: found[main]}
    number = NUMBER_WORDS.get(len(frames), str(len(frames)))
    counts = ", ".join(f"{frame or '(unnamed)'} {n}" for frame, n in frames.items())
    if len(used) == len(frames):
        what = "each scan is used by its own frame's place on the robot"
    else:
        kept = ", ".join(frame or "(unnamed)" for frame in used)
        why = (
            "the laser pose is given for one"
            if laser_pose is not None
            else "tf does not tell where the others sit"
        )
        what = f"only scans of {kept} are used, as {why}"
    told = f"{number} frames (lasers) on one topic {topic.name} (scans: {counts}); {what}"
    return LaserFrames(mountings=used, warnings=(told, *(w for x in used.values() for w in x.warnings)))
