"""The architecture, as far as the syntax tree shows it: who may import what, sizes, and what is declared."""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "slammot_graph"

LAYERS = (
    ("core",),
    ("logs", "mapping", "odometry"),
    ("registration", "simulation", "evaluation"),
    ("graph",),
    ("tracking",),
    ("detection",),
    ("loop_closure",),
    ("localization",),
    ("saved_maps",),
    ("baselines",),
    ("pipeline_config",),
    ("old_keys",),
    ("pipeline",),
    ("methods",),
    ("observer", "diagnosis", "conclusion", "kept_scans"),
    ("session",),
    ("run",),
    ("run_folder", "viz"),
    ("viz/rerun",),
    ("saving", "checkpoints", "study"),
    ("cli",),
    ("__main__", "__init__"),
)
"""Packages and modules, lowest first: each imports from the lines above its own, never from its own line.

`simulation` writes logs and takes its free space from maps; `evaluation` judges arrays, and reads the true poses
of logs. `detection` lies above `tracking`, since its backward pass follows tracks. `baselines` has the interface
of `pipeline`, in the terms of `localization`. `viz/rerun` shares the colors of `viz`.
"""

UPWARD = {
    ("core/results.py", "saving"): "`RunResult.save` calls `saving.save_run`, imported when it is called",
    (
        "pipeline_config.py",
        "old_keys",
    ): "keys of release 0.1 are accepted for one release; imported where there are any",
}
"""Imports against the order, each with its reason."""

OWNERS = {
    "gtsam": "graph",
    "rerun": "viz/rerun",
    "kiss_icp": "baselines",
    "distributed": "study",
    "loky": "study",
}
"""Heavy packages, each behind the one part that may import it."""

CLI_MAY_IMPORT = {
    "core": "errors, configuration from and to TOML, results",
    "logs": "checks that a log can be opened before the run folder is made",
    "odometry": "`calibrate` estimates the noise of the odometry",
    "simulation": "`simulate`, `inject` and `demo`",
    "evaluation": "`evaluate` and `compare`",
    "pipeline_config": "`calibrate` takes the noise out of a method's configuration",
    "methods": "the names of the methods",
    "observer": "what a run tells, as a progress bar",
    "diagnosis": "`check`, and what the first scans show before a run",
    "run": "`run` and `demo`",
    "run_folder": "`compare`, `evaluate`, `animate`, `view`",
    "viz": "`animate`",
    "viz/rerun": "`view`, and the recording of `run`",
    "saving": "`run` and `demo`",
    "saved_maps": "`merge` and `edit`",
    "mapping": "the picture of a merged or edited map",
    "checkpoints": "`run`",
    "study": "`study` and `report`",
    "__init__": "`__version__`",
}
"""What the command line may import, and for what; the parts of a method are not among it."""

MAX_LINES = 400
MAX_ATTRIBUTES = 12


def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def files_of(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def name_of(path: Path) -> str:
    """A file of the package as other tests name it: "core/se2.py"."""
    return path.relative_to(PACKAGE).as_posix()


def unit_of(parts: tuple[str, ...]) -> str:
    """The unit of `LAYERS` that a dotted name or a path within the package belongs to."""
    if parts[:2] == ("viz", "rerun"):
        return "viz/rerun"
    return parts[0].removesuffix(".py") if parts else "__init__"


def imported_names(tree: ast.AST) -> Iterator[str]:
    """Dotted names of everything a file imports: within functions too, and for type checkers, which are as much
    of a dependency of the reader; and modules that `import_module` gets by a literal."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            yield from (str(x.value) for x in node.args if isinstance(x, ast.Constant))


@cache
def own_imports() -> dict[str, set[str]]:
    """Units of the package that each of its files imports, without its own."""
    imports: dict[str, set[str]] = {}
    for path in files_of("slammot_graph"):
        own = unit_of(Path(name_of(path)).parts)
        found = imports.setdefault(name_of(path), set())
        for name in imported_names(tree_of(path)):
            package, *parts = name.split(".")
            if package == "slammot_graph" and name != "slammot_graph.__version__":
                found.add(unit_of(tuple(parts)))
            elif package == "slammot_graph":
                found.add("__init__")
        found.discard(own)
    return imports


@cache
def foreign_imports(*folders: str) -> dict[str, set[str]]:
    """Top-level names outside the standard library and this project that the files of some folders import."""
    ours = {"slammot_graph", "tests", "experiments"}
    return {
        path.relative_to(ROOT).as_posix(): {
            top
            for top in (name.split(".")[0] for name in imported_names(tree_of(path)))
            if top not in sys.stdlib_module_names and top not in ours
        }
        for path in files_of(*folders)
    }


def test_every_part_has_its_layer() -> None:
    units = {unit_of(Path(name).parts) for name in own_imports()}
    placed = [unit for layer in LAYERS for unit in layer]
    assert len(placed) == len(set(placed))
    assert units <= set(placed)


def test_imports_run_one_way() -> None:
    height = {unit: k for k, layer in enumerate(LAYERS) for unit in layer}
    height["__init__"] = -1  # as `from slammot_graph import __version__`, which anybody may
    against = {
        (name, target)
        for name, targets in own_imports().items()
        for target in targets
        if height[target] >= height[unit_of(Path(name).parts)] and name != "__init__.py"
    }
    assert against == set(UPWARD)


def test_only_the_version_is_imported_from_the_top() -> None:
    lazy = ast.literal_eval(
        ast.unparse(
            next(
                node.value
                for node in tree_of(PACKAGE / "__init__.py").body
                if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
            )
        )
    )
    taken = {
        f"{name_of(path)}: {name}"
        for path in files_of("slammot_graph")
        for name in imported_names(tree_of(path))
        if name.removeprefix("slammot_graph.") in lazy
    }
    assert not taken


@pytest.mark.parametrize("package", OWNERS)
def test_heavy_packages_have_one_importer(package: str) -> None:
    importers = {
        name.removeprefix("slammot_graph/")
        for name, found in foreign_imports("slammot_graph").items()
        if package in found
    }
    assert importers
    assert {unit_of(Path(name).parts) for name in importers} == {OWNERS[package]}


def test_the_local_map_imports_its_own_kernels_only() -> None:
    names = set(imported_names(tree_of(PACKAGE / "mapping" / "local_map.py")))
    of_package = {name for name in names if name.startswith("slammot_graph.")}
    others = {name for name in of_package if not name.startswith("slammot_graph.core")}
    assert others == {"slammot_graph.mapping._local_map_kernels"}


def test_formats_and_pictures_do_not_know_each_other() -> None:
    for name, targets in own_imports().items():
        unit = unit_of(Path(name).parts)
        if unit == "run_folder":
            assert not targets & {"viz", "viz/rerun"}, name
        if unit in ("viz", "viz/rerun"):
            assert "run_folder" not in targets, name


def test_the_command_line_reaches_nothing_below_the_run() -> None:
    reached = {
        f"{name}: {target}"
        for name, targets in own_imports().items()
        for target in targets
        if name.startswith("cli/") and target not in CLI_MAY_IMPORT
    }
    assert not reached


def test_kernels_import_kernels_only() -> None:
    """The machine code of a kernel on disk does not see changes of what it calls: so that is little."""
    for path in files_of("slammot_graph"):
        if path.name.endswith("_kernels.py"):
            foreign = foreign_imports("slammot_graph")[path.relative_to(ROOT).as_posix()]
            assert foreign <= {"numpy", "numba"}, name_of(path)
            assert own_imports()[name_of(path)] <= {"core"}, name_of(path)


def test_no_file_is_long_without_a_reason() -> None:
    long = [
        path.relative_to(ROOT).as_posix()
        for path in files_of("slammot_graph", "tests", "experiments", "notebooks", "docs")
        if len(path.read_text(encoding="utf-8").splitlines()) > MAX_LINES
        and "Over 400 lines because " not in " ".join((ast.get_docstring(tree_of(path)) or "").split())
    ]
    assert not long


def attributes_of(node: ast.ClassDef) -> set[str]:
    """Instance attributes of a class: what its methods assign to `self`, and the fields of a mutable dataclass.

    Fields of a frozen one are not counted: configurations, results and records are values, not state.
    """
    stored = {
        inner.attr
        for inner in ast.walk(node)
        if isinstance(inner, ast.Attribute)
        and isinstance(inner.ctx, ast.Store)
        and ast.unparse(inner.value) == "self"
    }
    decorators = " ".join(ast.unparse(decorator) for decorator in node.decorator_list)
    if "dataclass" in decorators and "frozen=True" not in decorators:
        stored |= {ast.unparse(line.target) for line in node.body if isinstance(line, ast.AnnAssign)}
    return stored


def test_no_class_holds_much_without_a_reason() -> None:
    large = {
        f"{path.relative_to(ROOT).as_posix()}: {node.name}": len(attributes_of(node))
        for path in files_of("slammot_graph", "experiments", "tests")
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.ClassDef)
        and len(attributes_of(node)) > MAX_ATTRIBUTES
        and "Over 12 attributes because " not in " ".join((ast.get_docstring(node) or "").split())
    }
    assert not large


def test_each_package_says_what_belongs_there_and_what_it_imports() -> None:
    wrong = []
    for path in files_of("slammot_graph"):
        if path.name != "__init__.py" or path == PACKAGE / "__init__.py":
            continue
        doc = ast.get_docstring(tree_of(path)) or ""
        named = set(re.findall(r"`([\w/.]+)`", doc))
        unit = unit_of(Path(name_of(path)).parts)
        mine = {
            target
            for name, targets in own_imports().items()
            for target in targets - {"__init__"}
            if unit_of(Path(name).parts) == unit and (name, target) not in UPWARD
        }
        if len(doc.splitlines()) < 3 or not re.search(r"\b[Ii]mports?\b", doc):
            wrong.append(f"{name_of(path)}: three lines that say what belongs there and what it imports")
        elif unit != "cli" and mine - named:  # the command line's are in `CLI_MAY_IMPORT`
            wrong.append(f"{name_of(path)}: imports {sorted(mine - named)}, which it does not name")
    assert not wrong


def normal(name: str) -> str:
    """A distribution's name without version, extras and spelling."""
    return re.split(r"[\s\[<>=!~;]", name, maxsplit=1)[0].lower().replace("_", "-")


def declared(*extras: str) -> set[str]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = list(project["dependencies"])
    for extra in extras:
        lines += project["optional-dependencies"][extra]
    return {normal(line) for line in lines}


def undeclared(known: set[str], *folders: str) -> set[str]:
    distributions = packages_distributions()
    return {
        f"{file}: {module}"
        for file, modules in foreign_imports(*folders).items()
        for module in modules
        if not known & {normal(name) for name in distributions.get(module, [module])}
    }


def test_what_the_package_imports_is_declared() -> None:
    optional = {"imageio-ffmpeg"}  # used where it is there and no ffmpeg is
    assert not undeclared(declared("crowds", "dask") | optional, "slammot_graph")


def test_what_tests_and_experiments_import_is_declared() -> None:
    known = declared("crowds", "dev", "docs", "experiments", "matchers", "places", "trackers")
    assert not undeclared(known, "tests", "experiments", "notebooks", "docs")


def test_the_version_is_written_once() -> None:
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert tools["project"]["dynamic"] == ["version"]
    assert tools["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "slammot_graph.__version__"}
    assert "\nversion:" not in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
