"""`open_log`: the format of a log by its first bytes."""

from collections.abc import Sequence
from pathlib import Path

from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.core.files import check_regular
from slammot_graph.logs.arrays import ArrayLog
from slammot_graph.logs.bag_clouds import CloudSlice
from slammot_graph.logs.bag_odometry import FrameNames
from slammot_graph.logs.base import damage_told
from slammot_graph.logs.carmen import CarmenLog
from slammot_graph.logs.mounting import given_poses
from slammot_graph.logs.remounted import RemountedLog, upside_down
from slammot_graph.logs.rosbag import BagChoices, RosbagLog
from slammot_graph.logs.source import LaserLog
from slammot_graph.logs.text_lines import read_start

KNOWN_FORMATS = "CARMEN (.log .clf, also .gz .bz2), ROS 1 .bag, ROS 2 bag folder, .db3 or .mcap, or .npz"

BAG_MAGIC = {b"#ROSBAG": ".bag", b"\x89MCAP0": ".mcap", b"SQLite format 3\x00": ".db3"}
"""First bytes of a bag file and the name's ending that belongs to them."""

OLD_BAG_MAGIC = (b"#ROSRECORD V", b"#ROSLOG V", b"#ROSBAG V1")

NPZ_MAGIC = b"PK\x03\x04"


def open_log(  # noqa: PLR0913  # what may be chosen of a log, each with a default
    path: str | Path,
    *,
    scan_topic: str | Sequence[str] | None = None,
    odom_topic: str | None = None,
    imu_topic: str | None = None,
    odom_frame: str | None = None,
    base_frame: str | None = None,
    laser_pose: Sequence[float | str] | None = None,
    odometry: bool = True,
    cloud_topic: str | None = None,
    heights: tuple[float, float] | None = None,
) -> LaserLog:
    """Open a log of any known format, told by its first bytes.

    Parameters
    ----------
    path : str or Path
        CARMEN (``.log .clf``, also ``.gz .bz2``), ROS 1 ``.bag``, a ROS 2 bag folder, ``.db3`` or ``.mcap``,
        or ``.npz``.
    scan_topic, odom_topic, imu_topic : str, optional
        Which topics of a bag to use where several would do; `scan_topic` may name several, of one robot's lasers.
    odom_frame, base_frame : str, optional
        Frames of a bag's tf between which to look for odometry; the laser's mounting is looked for on the base frame.
    laser_pose : (x, y, theta), optional
        The laser in the robot's base [m, m, rad], counter-clockwise, in place of what the log says. The word "flip"
        after them: it is upside down. Of a bag with several lasers, the name of the frame comes before each pose:
        ``("front", 0.2, 0.0, 0.0, "rear", -0.2, 0.0, 3.14, "flip")``.
    odometry : bool
        False: leave the log's odometry aside, as if it had none.
    cloud_topic : str, optional
        Clouds (PointCloud2) of a bag of which scans are made ...
    heights : (z_min, z_max), optional
        ... from the points between these heights above the base [m].

    Returns
    -------
    LaserLog

    Raises
    ------
    InputError
        No such file, an unknown or a damaged one, one without laser, a topic that is not there.
    ConfigError
        The laser pose is not such numbers and words.
    """
    path = Path(path)
    given = given_poses(laser_pose)
    topics = (scan_topic,) if isinstance(scan_topic, str) else tuple(scan_topic or ())
    if (cloud_topic is None) != (heights is None):
        raise ConfigError("scans are made of clouds with both --cloud-topic T and --slice Z_MIN Z_MAX")
    if heights is not None and not heights[0] < heights[1]:
        raise ConfigError(f"--slice needs Z_MIN < Z_MAX, not {heights[0]:g} {heights[1]:g}")
    if cloud_topic is not None and topics:
        raise ConfigError("give either --scan-topic or --cloud-topic")
    choices = BagChoices(
        scan_topics=topics,
        odom_topic=odom_topic,
        imu_topic=imu_topic,
        frames=FrameNames(odom=odom_frame, base=base_frame),
        laser_poses=given,
        odometry=odometry,
        cloud_topic=cloud_topic,
        heights=None if heights is None else CloudSlice(z_min_m=heights[0], z_max_m=heights[1]),
    )
    with damage_told(path):
        log = _open(path, choices)
    if laser_pose is None:
        return log
    words = [str(x) for x in laser_pose]
    if isinstance(log, RosbagLog):
        if list(given) != [""] or given[""].is_upside_down:
            log.source["given_laser_pose"] = words
    elif given[""].is_upside_down:
        return RemountedLog(log, upside_down, source={"given_laser_pose": words})
    return log


def _open(path: Path, choices: BagChoices) -> LaserLog:
    if _holds_a_bag(path):
        bag_path = _bag_in_folder(path) if path.is_dir() else path
        return RosbagLog(bag_path, choices)
    named = (choices.cloud_topic, choices.odom_topic, choices.imu_topic)
    if choices.scan_topics or any(name is not None for name in named):
        raise InputError(
            f"{path}: not a bag, so it has no topics; leave out --scan-topic, --odom-topic and --imu-topic"
        )
    if choices.frames.odom is not None or choices.frames.base is not None:
        raise InputError(f"{path}: not a bag, so it has no frames; leave out --odom-frame and --base-frame")
    if set(choices.laser_poses) - {""}:
        raise InputError(
            f"{path}: not a bag, so its laser has no frame; give --laser-pose X Y YAW without a name"
        )
    given = choices.laser_poses.get("")
    laser_pose = None if given is None else given.T_base_laser
    start = read_start(path)
    if start.startswith(NPZ_MAGIC):
        return ArrayLog(path, laser_pose=laser_pose, odometry=choices.odometry)
    if path.suffix in (".npz", *BAG_MAGIC.values()) or b"\x00" in start:
        what = f"not a {path.suffix} file, whatever its name says" if path.suffix else "of no known format"
        raise InputError(f"{path}: {what}; known are {KNOWN_FORMATS}")
    return CarmenLog(path, laser_pose=laser_pose, odometry=choices.odometry)


def _holds_a_bag(path: Path) -> bool:
    """Whether a path is a folder, or a file that starts as bags do and is named so."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; check the path")
    if path.is_dir():
        return True
    check_regular(path)
    start = read_start(path)
    if not start:
        raise InputError(f"{path}: the file is empty; copy or record it again")
    if start.startswith(OLD_BAG_MAGIC):
        version = start.split(b"\n")[0].rpartition(b"V")[2].decode("ascii", "replace")
        raise InputError(
            f"{path}: a bag of version {version}, which is not read; convert it with `rosbag fix`"
        )
    for magic, suffix in BAG_MAGIC.items():
        if start.startswith(magic):
            if path.suffix != suffix:
                raise InputError(f"{path}: a {suffix} bag by its content; give its name the ending {suffix}")
            return True
    return False


def _bag_in_folder(path: Path) -> Path:
    """What to open of a ROS 2 bag folder: the folder, or its only bag file where metadata.yaml is missing."""
    if (path / "metadata.yaml").exists():
        return path
    files = sorted(x for x in path.iterdir() if x.suffix in (".db3", ".mcap"))
    if len(files) == 1:
        return files[0]
    if files:
        raise InputError(
            f"{path}: a bag of {len(files)} files without metadata.yaml; repair it with `ros2 bag reindex`"
        )
    raise InputError(
        f"{path}: a folder but no ROS 2 bag (metadata.yaml, .db3 or .mcap); give a log: {KNOWN_FORMATS}"
    )
