"""States as bytes: what comes back, what stays outside, and what is refused."""

import os
import pickle
from array import array
from collections import Counter, deque
from typing import Any

import numpy as np
import pytest

from slammot_graph.core.errors import InputError
from slammot_graph.core.frozen_state import freeze, thaw
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.scan import LaserModel, Scan
from slammot_graph.core.spool import Spool

LASER = LaserModel(angle_min=0.0, angle_increment=0.1, n_beams=3, range_min=0.1, range_max=9.0)


def test_values_arrays_and_objects_come_back_and_refer_to_each_other_as_before() -> None:
    track = OdometryTrack(stamps=np.arange(3.0), T_odom_base=np.zeros((3, 3)))
    spool = Spool(10)
    scan = Scan(index=1, stamp=2.5, ranges=np.arange(3.0), laser=LASER, T_odom_base=None, odometry=track)
    fixed = np.arange(4.0)
    fixed.setflags(write=False)
    state = {
        "scan": scan,
        "laser": LASER,
        "spool": spool,
        "some": [
            array("d", [1.0]),
            deque([1, 2], maxlen=2),
            Counter("aab"),
            {3, 4},
            np.float64(0.1),
            (1, None),
        ],
        "fixed": fixed,
        "columns": np.asfortranarray(np.arange(6).reshape(2, 3)),
    }
    other = Spool(10)
    other_track = OdometryTrack(stamps=np.arange(3.0), T_odom_base=np.zeros((3, 3)))
    got = thaw(freeze(state, [spool], track), [other], other_track)
    assert got["spool"] is other
    assert got["scan"].odometry is other_track
    assert got["scan"].laser is got["laser"]
    assert got["laser"] == LASER
    np.testing.assert_array_equal(got["scan"].ranges, scan.ranges)
    assert got["some"] == state["some"]
    assert got["some"][1].maxlen == 2
    assert not got["fixed"].flags.writeable
    assert got["scan"].ranges.flags.writeable
    assert got["columns"].flags.f_contiguous


def test_another_track_than_the_logs_is_part_of_the_state() -> None:
    track = OdometryTrack(stamps=np.arange(2.0), T_odom_base=np.ones((2, 3)))
    got = thaw(freeze([track], [], None), [], None)[0]
    np.testing.assert_array_equal(got.T_odom_base, track.T_odom_base)


class Harmful:
    def __reduce__(self) -> tuple[Any, ...]:
        return os.system, ("exit 1",)


@pytest.mark.parametrize(
    "value",
    [
        Harmful(),
        os.getcwd,
        pickle.Unpickler,
        Ellipsis.__class__,
    ],
)
def test_anything_else_is_refused(value: object) -> None:
    with pytest.raises((InputError, TypeError)) as caught:
        thaw(pickle.dumps(value), [], None)
    assert isinstance(caught.value, InputError)
    assert "a state does not hold" in str(caught.value)


@pytest.mark.parametrize("name", ["slammot_graph.core.spool.tempfile", "slammot_graph.cli.console.stderr"])
def test_nor_what_a_module_of_the_package_has_imported(name: str) -> None:
    module, _, attribute = name.rpartition(".")
    data = b"\x80\x04" + b"c" + f"{module}\n{attribute}\n".encode() + b"."
    with pytest.raises(InputError, match="a state does not hold"):
        thaw(data, [], None)


@pytest.mark.parametrize("data", [b"", b"abc", freeze([1, 2, "three"], [], None)[:-3]])
def test_damaged_bytes_are_told(data: bytes) -> None:
    with pytest.raises(InputError, match="not the state of a run"):
        thaw(data, [], None)
