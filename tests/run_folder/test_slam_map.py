"""A write of ``map.slam`` that is killed leaves the map before, or the new one, whole."""

import subprocess
import sys
from pathlib import Path

import pytest

from slammot_graph import Run, SavedMap
from tests.localization.saved_maps import ring_map
from tests.loop_closure.ring import ring_log

N_KILLS = 100

SCRIPT = """
import os, random, signal, sys, time
from pathlib import Path
from types import SimpleNamespace
from slammot_graph.core.saved_map import SavedMap
from slammot_graph.run_folder.slam_map import write_slam_map

folder, n = Path(sys.argv[1]), int(sys.argv[2])
small, large = (SavedMap.load(folder / name) for name in ("small.slam", "large.slam"))
nobody = SimpleNamespace(log=SimpleNamespace(path=None))
path, random_s = folder / "map.slam", random.Random(0)
data = {len(saved.nodes): saved.to_bytes() for saved in (small, large)}
SavedMap.to_bytes = lambda saved: data[len(saved.nodes)]  # so that the time goes into writing
write_slam_map(path, small, nobody)
seen, within = set(), 0
for _ in range(n):
    child = os.fork()
    if child == 0:
        while True:
            write_slam_map(path, small, nobody)
            write_slam_map(path, large, nobody)
    time.sleep(random_s.uniform(0.005, 0.03))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    within += path.with_name(".map.slam.tmp").exists()
    seen.add(len(SavedMap.load(path).nodes))
print(sorted(seen) == sorted({len(small.nodes), len(large.nodes)}), within)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no fork there")
def test_killed_writes_damage_no_map(tmp_path: Path) -> None:
    large = ring_map()
    (tmp_path / "large.slam").write_bytes(large.to_bytes())
    small = Run(ring_log(1), max_scans=30).complete().saved_map
    assert small is not None
    (tmp_path / "small.slam").write_bytes(small.to_bytes())
    words = [sys.executable, "-c", SCRIPT, str(tmp_path), str(N_KILLS)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    both_seen, n_within = done.stdout.split()
    assert both_seen == "True"
    assert int(n_within) > 0  # some were killed in the midst of a write
    SavedMap.load(tmp_path)
