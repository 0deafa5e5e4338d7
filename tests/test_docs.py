"""What the documentation names is there; ``make docs`` builds it."""

import re
import runpy
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
INDEX = (DOCS / "index.md").read_text(encoding="utf-8")


def test_the_figure_names_files_that_exist() -> None:
    figure = runpy.run_path(str(DOCS / "how_it_works.py"))
    files = [file for _, _, files in figure["STAGES"] for file in files]
    files += [file for _, file in figure["KEPT"]]
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
