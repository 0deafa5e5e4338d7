"""Recordings of killed runs, cut to what a reader can read."""

import struct
from pathlib import Path

import pytest

from slammot_graph.run_folder.directory import keep_recording
from slammot_graph.run_folder.recording import cut_to_whole_messages

HEADER = b"RRF2" + bytes(8)
MESSAGES = [struct.pack("<QQ", kind, n) + bytes(range(n)) for kind, n in ((1, 10), (2, 30), (1, 0), (2, 7))]
END = struct.pack("<QQ", 0, 5) + bytes(5)


def test_cut_anywhere_it_ends_with_a_whole_message(tmp_path: Path) -> None:
    whole = HEADER + b"".join(MESSAGES)
    ends = [len(HEADER + b"".join(MESSAGES[:k])) for k in range(len(MESSAGES) + 1)]
    path = tmp_path / "run.rrd"
    for n in range(len(whole) + 1):
        path.write_bytes(whole[:n])
        cut_to_whole_messages(path)
        if n < ends[2]:  # nothing but what names the recording
            assert not path.exists()
        else:
            assert path.read_bytes() == whole[: max(end for end in ends if end <= n)]


def test_what_was_ended_and_what_is_no_recording_stay(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    for data in (HEADER + b"".join(MESSAGES) + END + b"footer", b"something else that is long"):
        path.write_bytes(data)
        cut_to_whole_messages(path)
        assert path.read_bytes() == data


@pytest.mark.filterwarnings("ignore")
def test_what_the_next_run_finds_can_be_read(tmp_path: Path) -> None:
    rr = pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    recording = rr.RecordingStream("cut")
    recording.save(tmp_path / "run.rrd")
    for k in range(20):
        recording.set_time("scan", sequence=k)
        recording.log("a", rr.Scalars(k))
        recording.flush()
    recording.disconnect()
    data = (tmp_path / "run.rrd").read_bytes()
    for n in (len(data) // 2, 3 * len(data) // 4):
        (tmp_path / "run.rrd").write_bytes(data[:n])
        keep_recording(tmp_path)
    for k in (1, 2):
        assert sum(chunk.num_rows for chunk in RrdReader(tmp_path / f"run.{k}.rrd").stream()) > 0
