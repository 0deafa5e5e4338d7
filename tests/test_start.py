"""How the package starts: what an import brings in, and where machine code is kept."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import slammot_graph
from slammot_graph.core._numba import is_compiled
from slammot_graph.core.se2 import transform_points

PACKAGE = Path(slammot_graph.__file__).parent


def run(code: str, cwd: Path, **environment: str) -> str:
    kept = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=cwd,
        env={**kept, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_importing_the_package_brings_in_nothing_heavy(tmp_path: Path) -> None:
    heavy = ["numpy", "numba", "scipy", "gtsam", "matplotlib", "rerun", "kiss_icp", "rosbags"]
    code = f"import sys, slammot_graph; print([name for name in {heavy} if name in sys.modules])"
    assert run(code, tmp_path) == "[]"


def test_what_is_asked_for_is_imported() -> None:
    assert set(slammot_graph.__all__) <= set(dir(slammot_graph))
    for name in slammot_graph.__all__:
        assert getattr(slammot_graph, name) is not None
    with pytest.raises(AttributeError, match="nothing_of_the_kind"):
        _ = slammot_graph.nothing_of_the_kind


def test_the_public_names() -> None:
    assert sorted(slammot_graph.__all__) == [
        "ConfigError",
        "InputError",
        "LaserModel",
        "METHODS",
        "MapStart",
        "Pipeline",
        "PipelineConfig",
        "Run",
        "RunFolder",
        "RunResult",
        "SavedMap",
        "Scan",
        "SlammotError",
        "StepResult",
        "closures_between_runs",
        "edit_map",
        "get_method",
        "load_run",
        "merge_maps",
        "open_log",
    ]


def test_the_package_does_not_log_by_itself(tmp_path: Path) -> None:
    code = "import logging, slammot_graph; logging.getLogger('slammot_graph.run').error('lost')"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert (done.stdout, done.stderr) == ("", "")


USE_A_KERNEL = """
import numpy as np
from slammot_graph.core import se2
from slammot_graph.core._numba import is_compiled
moved = se2.transform(np.array([1.0, 2.0, 0.0]), np.ones((1, 2)))
print(se2.__file__, moved.tolist(), is_compiled(se2.transform_points))
"""


def copy_without_a_cache(folder: Path) -> Path:
    """Copy what the transforms need; a file where `__pycache__` should be keeps root from writing there too."""
    copy = folder / "slammot_graph"
    (copy / "core").mkdir(parents=True)
    for name in (
        "__init__.py",
        "core/__init__.py",
        "core/_numba.py",
        "core/errors.py",
        "core/se2.py",
        "core/types.py",
    ):
        shutil.copy(PACKAGE / name, copy / name)
    (copy / "core" / "__pycache__").write_text("", encoding="ascii")
    return copy


def test_a_read_only_install_keeps_its_machine_code_in_the_users_cache(tmp_path: Path) -> None:
    copy = copy_without_a_cache(tmp_path)
    cache = tmp_path / "cache"
    said = run(USE_A_KERNEL, tmp_path, HOME=str(tmp_path), XDG_CACHE_HOME=str(cache))
    assert said == f"{copy / 'core' / 'se2.py'} [[2.0, 3.0]] True"
    assert sorted(tmp_path.rglob("*transform_points*.nbi"))
    assert (copy / "core" / "__pycache__").is_file()


def test_machine_code_goes_where_numba_is_told(tmp_path: Path) -> None:
    copy_without_a_cache(tmp_path)
    said = run(USE_A_KERNEL, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "kept"))
    assert said.endswith("True")
    assert sorted((tmp_path / "kept").rglob("*transform_points*.nbi"))


def test_with_no_place_for_machine_code_at_all_kernels_still_work(tmp_path: Path) -> None:
    copy_without_a_cache(tmp_path)
    nowhere = tmp_path / "file"
    nowhere.write_text("", encoding="ascii")
    said = run(USE_A_KERNEL, tmp_path, HOME=str(nowhere), XDG_CACHE_HOME=str(nowhere))
    assert said.endswith("[[2.0, 3.0]] False")


def test_is_compiled_of_a_plain_function_is_false() -> None:
    assert not is_compiled(run)
    assert not is_compiled(transform_points.py_func)  # type: ignore[attr-defined]
