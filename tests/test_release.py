"""What a user gets: wheel and source distribution, installed into an empty environment, without the dev extras."""

import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from slammot_graph import __version__

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[1]
STUDY = 'methods = ["odometry", "icp"]\nseeds = 2\n[[scenario]]\nname = "one-walker"\nrate_hz = 5.0\n'


def run(*words: object, cwd: Path, code: int = 0) -> str:
    done = subprocess.run(
        [*map(str, words)], cwd=cwd, env=clean(), capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def clean() -> dict[str, str]:
    """The environment without what would let the checkout in."""
    import os

    return {
        key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "COV", "SLAMMOT"))
    }


@pytest.fixture(scope="module")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the source distribution, and the wheel from it, of what is committed or would be."""
    folder = tmp_path_factory.mktemp("release")
    source = folder / "source"
    left_out = shutil.ignore_patterns(
        ".*", "build", "dist", "runs", "*.egg-info", "__pycache__", "experiments"
    )
    shutil.copytree(ROOT, source, ignore=left_out)
    run(sys.executable, "-m", "build", "--outdir", folder / "dist", source, cwd=folder)
    return folder / "dist"


@pytest.fixture(scope="module")
def programs(distributions: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Install the wheel and what it needs, and nothing else."""
    environment = tmp_path_factory.mktemp("empty") / "environment"
    venv.create(environment, with_pip=True)
    (wheel,) = distributions.glob("*.whl")
    run(environment / "bin/python", "-m", "pip", "install", "--quiet", wheel, cwd=distributions)
    yield environment / "bin"
    shutil.rmtree(environment)  # a gigabyte


def test_both_hold_the_package_and_nothing_else(distributions: Path) -> None:
    (wheel,), (source,) = distributions.glob("*.whl"), distributions.glob("*.tar.gz")
    assert f"-{__version__}-py3-none-any" in wheel.name
    sources = {path.relative_to(ROOT).as_posix() for path in (ROOT / "slammot_graph").rglob("*.py")}
    sources |= {path.relative_to(ROOT).as_posix() for path in (ROOT / "slammot_graph").rglob("*.toml")}
    sources |= {"slammot_graph/py.typed"}
    in_wheel = set(zipfile.ZipFile(wheel).namelist())
    assert {name for name in in_wheel if ".dist-info/" not in name} == sources
    with tarfile.open(source) as archive:
        in_source = {name.partition("/")[2] for name in archive.getnames()}
    assert sources | {"README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "pyproject.toml"} <= in_source
    assert not [name for name in in_source if name.startswith(("tests", "experiments"))]


def test_a_user_without_the_dev_extras_can_run_everything(programs: Path, tmp_path: Path) -> None:
    program = programs / "slammot-graph"
    assert run(program, "--version", cwd=tmp_path).split() == ["slammot-graph", __version__]
    for package in ("hypothesis", "distributed", "evo", "sphinx"):
        run(programs / "python", "-c", f"import {package}", cwd=tmp_path, code=1)
    run(program, "simulate", "one-walker", "--seed", "0", "--output", "log.npz", cwd=tmp_path)
    run(program, "run", "log.npz", "--output", "run", "--max-scans", "60", cwd=tmp_path)
    assert (tmp_path / "run" / "run.rrd").is_file()
    run(program, "evaluate", "run", "--truth", "log.npz", cwd=tmp_path)
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    run(program, "study", "study.toml", "--output", "study", "--jobs", "2", cwd=tmp_path)
    assert (tmp_path / "study" / "report" / "index.html").is_file()
    origin = (tmp_path / "study" / "origin.json").read_text(encoding="utf-8")
    assert '"revision": "unknown"' in origin  # no checkout; the version tells
    assert f'"version": "{__version__}"' in origin
    words = ("study", "study.toml", "--output", "other", "--scheduler", "tcp://127.0.0.1:1")
    told = run(program, *words, cwd=tmp_path, code=2)
    assert "pip install 'slammot-graph[dask]'" in told


def test_what_is_installed_fits_together(programs: Path, tmp_path: Path) -> None:
    assert "No broken requirements" in run(programs / "python", "-m", "pip", "check", cwd=tmp_path)
