"""What a study's file may say, and which cells come of it."""

import time
from pathlib import Path

import pytest

from slammot_graph.core.errors import ConfigError, InputError
from slammot_graph.methods import METHODS
from slammot_graph.study.plan import part_of, plan
from slammot_graph.study.study_file import BUILT_IN, Study, quick, read_study

SCENARIO = '[[scenario]]\nname = "one-walker"\n'


def read(tmp_path: Path, text: str) -> Study:
    path = tmp_path / "study.toml"
    path.write_text(text, encoding="utf-8")
    return read_study(path)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("methods = [", "not valid TOML"),
        ('methods = ["graph"]', "no [[scenario]] and no [[log]]"),
        ("methods = []\n" + SCENARIO, "methods is empty"),
        ('method = ["graph"]\n' + SCENARIO, "method: expected tables [[method]]"),
        ("seed = 3\n" + SCENARIO, "unknown key 'seed'; the nearest known key is 'seeds'"),
        ("seeds = 0\n" + SCENARIO, "seeds must be a number from 1 on"),
        ("seeds = []\n" + SCENARIO, "seeds must be a number from 1 on"),
        ("seeds = [1, 1]\n" + SCENARIO, "seeds: one is there twice"),
        (SCENARIO + "seeds = [-1]\n", "seeds must be a number from 1 on"),
        (SCENARIO + "noise_scale = -1.0\n", "scenario.0.noise_scale must not be negative"),
        (SCENARIO + SCENARIO, "the world 'one-walker' is there twice; give each a label"),
        ('methods = ["icp", "icp"]\n' + SCENARIO, "the method 'icp' is there twice"),
        ('reference = "icp"\n' + SCENARIO, "'icp' is not among the methods of the study"),
        (SCENARIO + '[[override]]\nname = "a"\nmethods = ["icp"]\n', "'icp' is not among the methods"),
        (SCENARIO + '[quick]\nworlds = ["lab"]\n', "no scenario or log 'lab'"),
        ('[[log]]\npath = "a.log"\npeople = 3\n', "log.0.trajectory must be given where people are put in"),
    ],
)
def test_a_mistake_is_one_line(text: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        read(tmp_path, text)
    assert told in str(error.value)
    assert str(error.value).startswith(f"{tmp_path / 'study.toml'}: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('methods = ["grap"]\n' + SCENARIO, 'no method "grap"'),
        ('[[scenario]]\nname = "one-talker"\n', 'no scenario "one-talker"'),
        (SCENARIO + 'laser = "lms"\n', "lms"),
        (SCENARIO + "rate_hz = 1.0\n", "rate_hz must lie between"),
        (
            'methods = ["kiss-icp"]\n'
            + SCENARIO
            + '[[override]]\nname = "fine"\nconfig.detector.retest = 1\n',
            "override fine of kiss-icp: unknown key 'detector'",
        ),
        (
            'methods = ["mine"]\n' + SCENARIO + '[[method]]\nname = "mine"\nconfig.max_range = 3\n',
            "'max_range_m'",
        ),
        ('[[log]]\npath = "nowhere.log"\n', "no such file; paths of a study are relative to its own file"),
    ],
)
def test_a_mistake_in_the_plan_is_one_line(text: str, told: str, tmp_path: Path) -> None:
    with pytest.raises((ConfigError, InputError)) as error:
        plan(read(tmp_path, text), tmp_path, source="study.toml")
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_a_word_that_is_no_file_is_a_study_of_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("paper").mkdir()  # a folder of that name is no study
    paper = read_study(Path("paper"))
    assert {"icp", "docpfo", "graph"} <= set(paper.methods)
    with pytest.raises(
        ConfigError, match=r"pap: neither a file nor a study that comes with the package \(ablation, paper"
    ):
        read_study(Path("pap"))


@pytest.mark.parametrize("path", sorted(BUILT_IN.glob("*.toml")), ids=lambda path: path.stem)
def test_studies_of_the_package_can_be_planned(path: Path) -> None:
    study = read_study(path)
    rows = plan(study, path.parent)
    few = plan(quick(study), path.parent)
    assert 0 < len(few) < len(rows)
    assert {row.cell.digest for row in few} < {row.cell.digest for row in rows}
    assert len({row.cell.key for row in rows}) == len(rows)


def test_the_ablation_has_every_method_on_every_scenario_20_times() -> None:
    study = read_study(Path("ablation"))
    assert set(study.methods) == set(METHODS)
    rows = plan(study, Path())
    assert len({row.cell.digest for row in rows}) == len(rows) == 20 * 8 * len(METHODS)


def test_the_product_of_all(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("", encoding="utf-8")
    study = read(
        tmp_path,
        'methods = ["graph", "icp", "mine"]\nseeds = [3, 5]\n'
        + SCENARIO
        + '[[log]]\npath = "a.log"\n[[method]]\nname = "mine"\nconfig.max_range_m = 20.0\n'
        '[[override]]\nname = "near"\nconfig.max_range_m = 10.0\nmethods = ["graph", "mine"]\n',
    )
    rows = plan(study, tmp_path)
    labels = {(row.world, row.method, row.override, row.seed) for row in rows}
    variants = [("graph", ""), ("graph", "near"), ("icp", ""), ("mine", ""), ("mine", "near")]
    assert labels == {
        *(("one-walker", *variant, seed) for seed in (3, 5) for variant in variants),
        *(("a.log", *variant, None) for variant in variants),
    }
    by_label = {(row.world, row.method, row.override, row.seed): row.cell for row in rows}
    assert by_label["one-walker", "mine", "near", 3].arguments["config"].count('"max_range_m": 10.0') == 1
    assert by_label["one-walker", "mine", "", 3].arguments["config"].count('"max_range_m": 20.0') == 1
    # the same settings by another name are the same cell
    assert (
        by_label["one-walker", "graph", "near", 3].digest == by_label["one-walker", "mine", "near", 3].digest
    )


def test_a_changed_method_changes_its_own_cells_only(tmp_path: Path) -> None:
    text = (
        'methods = ["icp", "mine"]\nseeds = 2\n'
        + SCENARIO
        + '[[method]]\nname = "mine"\nconfig.max_range_m = {}\n'
    )
    old, new = (plan(read(tmp_path, text.format(range_m)), tmp_path) for range_m in ("20.0", "21.0"))
    changed = {a.method for a, b in zip(old, new, strict=True) if a.cell.digest != b.cell.digest}
    assert changed == {"mine"}


def test_parts_share_all_cells_and_keep_those_of_a_log_together(tmp_path: Path) -> None:
    rows = plan(read(tmp_path, 'methods = ["icp", "graph"]\nseeds = 7\n' + SCENARIO), tmp_path)
    parts = [part_of(rows, k, 3) for k in (1, 2, 3)]
    assert sorted(row.cell.key for part in parts for row in part) == sorted(row.cell.key for row in rows)
    groups = [{row.cell.group for row in part} for part in parts]
    assert not groups[0] & groups[1]
    assert [len(group) for group in groups] == [3, 2, 2]


def test_many_cells_are_planned_fast(tmp_path: Path) -> None:
    names = ", ".join(f'"{name}"' for name in METHODS)
    study = read(tmp_path, f"methods = [{names}]\nseeds = 400\n" + SCENARIO)
    start = time.process_time()
    rows = plan(study, tmp_path)
    seconds = time.process_time() - start
    assert len(rows) == 400 * len(METHODS)
    assert seconds / len(rows) * 1e5 < 60.0  # a hundred thousand in a minute
