"""The version of the code that a cell runs: a digest of what is executed, not of comments and docstrings."""

import ast
import hashlib
import importlib.metadata
import importlib.util
import json
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
NOT_RUN = ("cli", "viz", "run_folder", "saving.py", "study", "__main__.py", "__init__.py")
"""Parts of the package that no cell runs, but for `study/measures.py`."""
NUMERIC = ("numpy", "scipy", "numba", "gtsam", "kiss-icp")
"""Packages whose versions may change a result."""


@lru_cache(maxsize=64)
def version_of(function: str) -> str:
    """Digest of the code behind a function: the package, the packages it computes with, and the function's own module.

    Parameters
    ----------
    function : str
        "module:name". Outside the package only the definitions count that the function reaches by name within its
        own top-level package, so that another text in a table changes nothing.
    """
    module, _, name = function.partition(":")
    digest = hashlib.sha256(package_version().encode())
    if module.split(".")[0] != PACKAGE.name:
        for text in sorted(_reached(module, name)):
            digest.update(text.encode())
    return digest.hexdigest()[:16]


@lru_cache(maxsize=1)
def package_version() -> str:
    """Digest of the package's sources and of the versions of the numeric packages."""
    digest = hashlib.sha256(json.dumps(numeric_versions()).encode())
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE)
        if name.parts[0] not in NOT_RUN or name.as_posix() == "study/measures.py":
            digest.update(name.as_posix().encode())
            digest.update(_dump(ast.parse(path.read_bytes())).encode())
    return digest.hexdigest()


def numeric_versions() -> dict[str, str]:
    """Versions of Python and of the packages that compute."""
    versions = {name: importlib.metadata.version(name) for name in NUMERIC}
    return {"python": ".".join(map(str, sys.version_info[:2])), **versions}


def _dump(tree: ast.AST) -> str:
    """The tree without docstrings and places."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if (
            not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            or not body
        ):
            continue
        node.body = [line for line in node.body if not _is_text(line)] or [ast.Pass()]
    return ast.dump(tree)


def _is_text(line: ast.stmt) -> bool:
    return (
        isinstance(line, ast.Expr)
        and isinstance(line.value, ast.Constant)
        and isinstance(line.value.value, str)
    )


def _reached(module: str, name: str) -> Iterator[str]:
    """Definitions that a name of a module reaches, each once, as texts."""
    seen: set[tuple[str, str]] = set()
    todo = [(module, name)]
    while todo:
        place = todo.pop()
        if place in seen:
            continue
        seen.add(place)
        for node in _definitions(place[0]).get(place[1], ()):
            if isinstance(node, ast.Import | ast.ImportFrom):
                todo += _imported(node, place[1])
                continue
            yield f"{place} {_dump(node)}"
            modules = _imported_modules(place[0])
            for inner in ast.walk(node):
                if isinstance(inner, ast.Name):
                    todo.append((place[0], inner.id))
                elif isinstance(inner, ast.Attribute) and isinstance(inner.value, ast.Name):
                    owner = modules.get(inner.value.id)
                    if owner is not None:
                        todo.append((owner, inner.attr))
                elif isinstance(inner, ast.ImportFrom) and inner.module and _is_ours(inner.module):
                    todo += [(inner.module, alias.name) for alias in inner.names]


@lru_cache(maxsize=256)
def _definitions(module: str) -> dict[str, list[ast.stmt]]:
    """Top-level statements of a module by the names that they bind; none where it has no source."""
    spec = importlib.util.find_spec(module)
    found: dict[str, list[ast.stmt]] = {}
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return found
    for node in ast.parse(Path(spec.origin).read_bytes()).body:
        for name in _bound(node):
            found.setdefault(name, []).append(node)
    return found


def _bound(node: ast.stmt) -> Iterator[str]:
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.Import | ast.ImportFrom):
        yield from (alias.asname or alias.name.split(".")[0] for alias in node.names)
    else:
        for inner in ast.walk(node):
            if isinstance(inner, ast.Name) and isinstance(inner.ctx, ast.Store):
                yield inner.id


def _imported(node: ast.Import | ast.ImportFrom, name: str) -> list[tuple[str, str]]:
    """Where an imported name is defined, if that is neither the package nor somebody else's."""
    if not isinstance(node, ast.ImportFrom) or node.module is None or not _is_ours(node.module):
        return []
    return [(node.module, alias.name) for alias in node.names if (alias.asname or alias.name) == name]


def _imported_modules(module: str) -> dict[str, str]:
    """Names that stand for a module of the same project."""
    found = {}
    for nodes in _definitions(module).values():
        for node in nodes:
            if isinstance(node, ast.ImportFrom) and node.module is not None and _is_ours(node.module):
                for alias in node.names:
                    found[alias.asname or alias.name] = f"{node.module}.{alias.name}"
    return {name: path for name, path in found.items() if _is_module(path)}


@lru_cache(maxsize=256)
def _is_module(path: str) -> bool:
    try:
        return importlib.util.find_spec(path) is not None
    except ModuleNotFoundError:
        return False


@lru_cache(maxsize=256)
def _is_ours(module: str) -> bool:
    """Whether a module's source lies beside this project, not among installed packages or in the package itself."""
    top = module.split(".", maxsplit=1)[0]
    if top == PACKAGE.name or top in sys.stdlib_module_names or not _is_module(top):
        return False
    spec = importlib.util.find_spec(top)
    places = [] if spec is None else [spec.origin or "", *(spec.submodule_search_locations or [])]
    return not any("site-packages" in place for place in places)
