"""What the documentation names is there; ``make docs`` builds it."""

import re
import runpy
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
INDEX = (DOCS / "index.md").read_text(encoding="utf-8")


def test_the_figure_names_each_file_once_and_all_exist() -> None:
    figure = runpy.run_path(str(DOCS / "how_it_works.py"))
    files = [file for _, _, files in figure["STAGES"] for file in files]
    assert len(files) == len(set(files))
    assert [file for file in files if not (ROOT / "slammot_graph" / file).is_file()] == []


def test_the_figure_is_an_svg() -> None:
    root = ElementTree.parse(DOCS / "how_it_works.svg").getroot()
    assert root.tag == "{http://www.w3.org/2000/svg}svg"


def test_the_landing_page_links_every_notebook() -> None:
    linked = {Path(target).name for target in re.findall(r"<\.\./notebooks/([^>]+)>", INDEX)}
    assert linked == {path.name for path in (ROOT / "notebooks").glob("*.py")}


def test_the_landing_page_names_files_of_the_package() -> None:
    named = re.findall(r"`(\w+/\w+\.py)`", INDEX)
    assert named
    assert all((ROOT / "slammot_graph" / name).is_file() for name in named)


def test_the_landing_page_finds_its_part_of_the_readme() -> None:
    start, end = re.findall(r':(?:start-after|end-before): "([^"]+)"', INDEX)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert 200 < len(readme.split(start, 1)[1].split(end, 1)[0]) < 3000


EXTEND = (DOCS / "extend.md").read_text(encoding="utf-8")
BLOCKS = dict(re.findall(r"^## (.+?)\n.*?^```python\n(.*?)^```", EXTEND, re.MULTILINE | re.DOTALL))


def test_the_page_on_extending_shows_each_kind_of_part() -> None:
    assert list(BLOCKS) == ["A log format", "A matcher", "A detector", "A tracker", "An observer"]


@pytest.mark.parametrize("title", BLOCKS)
def test_what_the_page_on_extending_shows_runs(
    title: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "block.py").write_text(BLOCKS[title], encoding="utf-8")
    runpy.run_path("block.py")


PAPER = (DOCS / "paper.md").read_text(encoding="utf-8")
PARAMETERS = re.findall(
    r"^\| .+? \| `([\w.]+)` \| (\S+) \| .*? \| \w+ \| `([\w/.]+)` \|$", PAPER, re.MULTILINE
)


@pytest.mark.parametrize(("key", "default", "file"), PARAMETERS, ids=[row[0] for row in PARAMETERS])
def test_the_papers_parameters_are_those_of_the_registry(key: str, default: str, file: str) -> None:
    from slammot_graph.core.config import to_plain
    from slammot_graph.methods import METHODS

    value: Any = to_plain(METHODS["docpfo"].config)
    for word in key.split("."):
        value = value[word]
    assert value == (default == "true" if isinstance(value, bool) else float(default))
    assert key.rpartition(".")[2] in (ROOT / "slammot_graph" / file).read_text(encoding="utf-8")


def test_the_papers_page_names_what_there_is() -> None:
    assert len(PARAMETERS) > 20
    for file, names in re.findall(r"`(\w+/\w+\.py)`(?:: (`[^|]*`))?", PAPER):
        source = (ROOT / "slammot_graph" / file).read_text(encoding="utf-8")
        for name in re.findall(r"`(?:\w+\.)?(\w+)`", names):
            assert f"def {name}(" in source, f"{file}: {name}"


STUDIES = (DOCS / "studies.md").read_text(encoding="utf-8")


def test_the_study_that_the_page_shows_can_be_planned(tmp_path: Path) -> None:
    from slammot_graph.study.plan import plan
    from slammot_graph.study.study_file import read_study

    (text,) = re.findall(r"^```toml\n(.*?)^```", STUDIES, re.MULTILINE | re.DOTALL)
    (tmp_path / "runs" / "intel").mkdir(parents=True)
    for name in ("intel.clf.bz2", "intel.relations", "runs/intel/trajectory.tum"):
        (tmp_path / name).touch()
    text = text.replace('methods = ["graph", ', 'methods = ["graph", "graph-near", ', 1)
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    rows = plan(read_study(tmp_path / "study.toml"), tmp_path)
    worlds = {row.world: sum(other.world == row.world for other in rows) for row in rows}
    assert worlds == {"office": 20 * 5, "intel.clf.bz2": 5, "Intel with six people": 20 * 5}
