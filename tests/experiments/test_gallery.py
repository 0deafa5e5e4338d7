"""Committed tables: whether they are of a recent release, and whether the texts say what they say."""

import importlib
import re
import subprocess
from pathlib import Path

import pytest

from experiments import gallery
from experiments.text_figures import TEXTS, is_rounding, strangers
from slammot_graph import __version__

ROOT = Path(__file__).parents[2]
TABLES = sorted(gallery.TABLES.glob("*.md"))
WITHOUT_TABLE = {"tracking"}
"""Experiments whose figures the texts give, and whose tables are not committed yet."""


def git(*words: str) -> str | None:
    done = subprocess.run(["git", "-C", str(ROOT), *words], capture_output=True, text=True, check=False)
    return done.stdout if done.returncode == 0 else None


def releases() -> list[str]:
    """Versions of the changelog, the newest first, and the one of this code."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    named = re.findall(r"^## \[(\d+\.\d+\.\d+)\]", text, re.MULTILINE)
    return named if __version__ in named else [__version__, *named]


def version_of_table(table: Path) -> str | None:
    """Version of the code that made a table: as it says, else that of its revision; None where git cannot tell."""
    text = table.read_text(encoding="utf-8")
    told = re.search(r"^- Code: \w+ of version (\S+)$", text, re.MULTILINE)
    if told:
        return told[1]
    (revision,) = re.findall(r"^- Revision: (\w+)", text, re.MULTILINE)
    source = git("show", f"{revision}:slammot_graph/__init__.py")
    if source is None:
        return None
    version: str = re.findall(r'__version__ = "([^"]+)"', source)[0]
    return version


@pytest.mark.parametrize("table", TABLES, ids=lambda path: path.stem)
def test_a_table_is_at_most_a_release_old(table: Path) -> None:
    version = version_of_table(table)
    if version is None:
        assert git("rev-parse", "HEAD") is None or git("rev-parse", "--is-shallow-repository") == "true\n", (
            f"{table.name}: its revision is not in this repository"
        )
        pytest.skip("no history here")
    known = releases()
    assert version in known
    assert known.index(version) - known.index(__version__) <= 1, f"make tables: {table.stem} is of {version}"


def test_a_table_two_releases_old_would_be_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    table = tmp_path / "made.md"
    table.write_text("- Code: abc of version 0.0.1\n", encoding="utf-8")
    monkeypatch.setattr(f"{__name__}.releases", lambda: [__version__, "0.0.2", "0.0.1"])
    with pytest.raises(AssertionError, match=r"make tables: made is of 0\.0\.1"):
        test_a_table_is_at_most_a_release_old(table)


@pytest.mark.parametrize("name", TEXTS)
def test_the_texts_say_what_the_tables_say(name: str) -> None:
    found = [one for one in strangers(ROOT / name, gallery.TABLES) if one.tables]
    assert [str(one) for one in found] == []


def test_every_experiment_that_the_texts_name_has_a_table() -> None:
    named = {
        experiment
        for name in TEXTS
        for experiment in re.findall(r"experiments\.([a-z_]+)", (ROOT / name).read_text(encoding="utf-8"))
    }
    assert named - {table.stem for table in TABLES} - {"same_results", "gallery"} <= WITHOUT_TABLE


def test_a_wrong_figure_is_told(tmp_path: Path) -> None:
    (tmp_path / "made.md").write_text(
        "## A\n| method | ATE |\n| :-- | --: |\n| graph | 0.0372 [0.03, 0.04] |\n| icp | 0.5 |\n",
        encoding="utf-8",
    )
    text = tmp_path / "text.md"
    text.write_text(
        "**Made** (`python -m experiments.made`):\n\n| | a |\n|---|---|\n| `graph` | 0.037 |\n| `icp` | 0.037 |\n"
        "| `graph` | 0.038 |\n\n**No experiment**\n\n| 7.7 |\n",
        encoding="utf-8",
    )
    assert [(one.line, one.figure) for one in strangers(text, tmp_path)] == [(6, "0.037"), (7, "0.038")]


@pytest.mark.parametrize(
    ("figure", "of", "is_one"),
    [
        ("0.037", "0.0372", True),
        ("0.037", "0.0375", True),
        ("0.037", "0.0376", False),
        ("2.1e-5", "2.1e-05", True),
        ("2.2e-05", "2.1e-05", False),
        ("0.50", "0.5", True),
        ("5.6", "5.60", True),
        ("-0.4", "-0.41", True),
        ("0.4", "-0.41", False),
    ],
)
def test_roundings(figure: str, of: str, is_one: bool) -> None:
    assert is_rounding(figure, of) == is_one


def test_the_gallery_has_every_table_and_every_experiment() -> None:
    names = [entry.name for entry in gallery.ENTRIES]
    assert len(names) == len(set(names))
    assert {table.stem for table in TABLES} <= set(names)
    with_function = {
        path.stem
        for path in (ROOT / "experiments").glob("*.py")
        if 'if __name__ == "__main__"' in path.read_text(encoding="utf-8")
    }
    assert with_function - set(names) == {"fault_table", "gallery", "same_results", "text_figures"}
    for entry in gallery.ENTRIES:
        assert callable(importlib.import_module(f"experiments.{entry.name}").experiment), entry.name
        if entry.figure is not None:
            assert (ROOT / "experiments" / "figures" / f"{entry.figure}.png").is_file()


def test_tables_of_todays_code_are_left_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(gallery, "TABLES", tmp_path)
    entry = gallery.ENTRIES[0]
    entry.table.write_text(f"- Code: {gallery.code_of(entry)} of version 1\n", encoding="utf-8")
    gallery.ENTRIES[1].table.write_text("- Code: 0123 of version 1\n", encoding="utf-8")
    assert gallery.main(["--list", entry.name, gallery.ENTRIES[1].name]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("python")[0].strip() for line in lines] == ["current", "to do"]
    assert gallery.main([entry.name]) == 0  # nothing to do, nothing done
    assert gallery.main(["nothing"]) == 2
    assert "no experiment nothing" in capsys.readouterr().err


def test_tables_are_remade_in_turn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ran: list[list[str]] = []

    def run(command: list[str], **_: object) -> "subprocess.CompletedProcess[str]":
        ran.append(command[2:])
        return subprocess.CompletedProcess(command, 130 if "sweep" in command[2] and len(ran) > 1 else 0)

    monkeypatch.setattr(gallery, "TABLES", tmp_path)
    monkeypatch.setattr(subprocess, "run", run)
    assert gallery.main(["reliability", "sweep", "speed", "--", "--quick"]) == 130  # Ctrl-C in the second one
    assert ran == [["experiments.reliability", "--seeds", "4", "--quick"], ["experiments.sweep", "--quick"]]
