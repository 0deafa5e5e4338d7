"""Addresses of cells, the code's version, and files by their content."""

import ast
from pathlib import Path

import pytest

from slammot_graph.study import code_version
from slammot_graph.study.cells import run_task
from slammot_graph.study.code_version import version_of
from slammot_graph.study.data_files import MissingDataError, content_of, data_file, find, keep
from tests.study.work import cell


def test_an_address_is_of_all_that_the_scores_depend_on(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("a", encoding="utf-8")
    file = data_file(log)
    cells = [
        cell(x=1.0, folder="a"),
        cell(x=2.0, folder="a"),
        cell(x=1.0, folder="b"),
        cell(x=1.0, folder="a", code="2"),
        cell("die", x=1.0, folder="a"),
        cell(x=1.0, folder="a", files={"log": file}),
    ]
    assert len({one.digest for one in cells}) == len(cells)
    assert cell(folder="a", x=1.0).digest == cells[0].digest  # in whatever order


def test_an_address_does_not_depend_on_where_a_file_lies(tmp_path: Path) -> None:
    digests = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        path = tmp_path / name / "log"
        path.write_text("same", encoding="utf-8")
        digests.append(cell("content", files={"log": data_file(path)}).digest)
    path.write_text("other", encoding="utf-8")
    assert digests[0] == digests[1] != cell("content", files={"log": data_file(path)}).digest


def test_what_goes_wrong_does_not_touch_the_next_cell(tmp_path: Path) -> None:
    task = [cell(x=x, folder=str(tmp_path)) for x in (-1.0, 2.0)]
    bad, good = run_task(task, check_code=False)
    assert bad.scores is None
    assert bad.error.startswith("ValueError: -1 is negative (work.py, line ")
    assert good.scores is not None
    assert good.scores["double"] == 4.0


def test_a_worker_with_other_code_refuses(tmp_path: Path) -> None:
    (outcome,) = run_task([cell(x=1.0, folder=str(tmp_path))])
    assert "has other code than the study was planned with" in outcome.error
    mine = cell(x=1.0, folder=str(tmp_path), code=version_of("tests.study.work:double"))
    assert run_task([mine])[0].error == ""


def dump(text: str) -> str:
    return code_version._dump(ast.parse(text))


def test_comments_and_docstrings_are_no_code() -> None:
    assert dump('"""a"""\ndef f():\n    """b"""\n    return 1') == dump("def f():  # c\n    return 1")
    assert dump("def f():\n    return 1") != dump("def f():\n    return 2")


@pytest.mark.parametrize(
    ("old", "new", "changes"),
    [
        ("FACTOR = 2.0", "FACTOR = 3.0", True),
        ("times: int) ->", "times: float) ->", False),
        ("Write down that it was called", "Note that it was called", False),
        ("time.sleep(seconds)", "time.sleep(2 * seconds)", True),
    ],
)
def test_a_version_is_of_what_a_function_reaches(
    old: str, new: str, changes: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    source = (Path(__file__).parent / "work.py").read_text(encoding="utf-8")
    assert old in source
    versions = []
    for name, text in (("made_a", source), ("made_b", source.replace(old, new))):
        folder = tmp_path / name
        (folder / "made_project").mkdir(parents=True)
        (folder / "made_project" / "__init__.py").touch()
        (folder / "made_project" / "work.py").write_text(text, encoding="utf-8")
        monkeypatch.syspath_prepend(folder)
        for cached in (code_version._definitions, code_version._is_module, code_version._is_ours, version_of):
            cached.cache_clear()
        versions.append(version_of("made_project.work:double"))
        monkeypatch.delitem(__import__("sys").modules, "made_project", raising=False)
        __import__("sys").path.remove(str(folder))
    assert (versions[0] != versions[1]) == changes


def test_a_file_is_found_by_its_content(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLAMMOT_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("SLAMMOT_DATA", raising=False)
    log = tmp_path / "log"
    log.write_text("right", encoding="utf-8")
    file = data_file(log)
    assert find(file) == log
    content = content_of(log)
    log.write_text("wrong content", encoding="utf-8")
    with pytest.raises(MissingDataError, match="set SLAMMOT_DATA"):
        find(file)
    elsewhere = tmp_path / "data" / "deep" / "log"
    elsewhere.parent.mkdir(parents=True)
    elsewhere.write_text("right", encoding="utf-8")
    monkeypatch.setenv("SLAMMOT_DATA", str(tmp_path / "data"))
    assert find(file) == elsewhere
    elsewhere.unlink()
    keep(file, content)
    keep(file, content)
    assert find(file).read_text(encoding="utf-8") == "right"
    assert len(list((tmp_path / "cache").iterdir())) == 1


def test_a_folder_is_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLAMMOT_CACHE", str(tmp_path / "cache"))
    bag = tmp_path / "bag"
    (bag / "in").mkdir(parents=True)
    (bag / "metadata.yaml").write_text("a", encoding="utf-8")
    (bag / "in" / "0.db3").write_bytes(b"b")
    file, content = data_file(bag), content_of(bag)
    (bag / "in" / "0.db3").write_bytes(b"c")
    assert data_file(bag).digest != file.digest
    keep(file, content)
    assert (find(file) / "in" / "0.db3").read_bytes() == b"b"
