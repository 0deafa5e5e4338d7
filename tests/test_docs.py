"""What the documentation names is there; ``make docs`` builds it."""

import re
import runpy
from pathlib import Path
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
