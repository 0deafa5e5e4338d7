"""The results of a study: one tidy table as Parquet and CSV, what failed, how long it took, and where it is from."""

import csv
import io
import json
import math
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slammot_graph import __version__
from slammot_graph.core.errors import InputError
from slammot_graph.study.code_version import PACKAGE, numeric_versions, package_version
from slammot_graph.study.plan import Planned

LABELS = ("world", "method", "override", "seed")


@dataclass(frozen=True, kw_only=True)
class Results:
    """What `write_results` wrote.

    Attributes
    ----------
    rows : list of dict
        The labels, then the measures; numbers or text.
    measures : list of str
    origin : mapping
        Title, command, revision, versions and the like.
    """

    rows: list[dict[str, Any]]
    measures: list[str]
    origin: Mapping[str, Any]


def write_results(
    folder: Path,
    rows: Sequence[Planned],
    records: Mapping[str, Mapping[str, Any]],
    errors: Mapping[str, str],
    origin: Mapping[str, Any],
) -> None:
    """Write ``results.parquet`` and ``.csv``, ``times.csv``, ``failed.csv`` and ``origin.json``.

    The results are equal bit by bit whoever computed them in whatever order; what depends on the machine is in
    ``times.csv``.

    Parameters
    ----------
    folder : Path
    rows : sequence of Planned
    records : mapping
        Of the finished cells by digest, see `CellStore.records`; rows without one are left out.
    errors : mapping
        Of failed cells by digest.
    origin : mapping
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    done = [row for row in rows if row.cell.digest in records]
    measures = list(dict.fromkeys(name for row in done for name in records[row.cell.digest]["scores"]))
    columns: dict[str, list[Any]] = {name: [getattr(row, name) for row in done] for name in LABELS}
    for name in measures:
        columns[name] = [_number(records[row.cell.digest]["scores"].get(name)) for row in done]
    columns["cell"] = [row.cell.digest for row in done]
    types: dict[str, Any] = dict.fromkeys(columns, pa.string()) | {"seed": pa.int64()}
    types |= dict.fromkeys(measures, pa.float64())
    table = pa.table({name: pa.array(values, types[name]) for name, values in columns.items()})
    with replaced(folder / "results.parquet") as path:
        pq.write_table(table, path)
    write_csv(folder / "results.csv", list(columns), zip(*columns.values(), strict=True))
    times = [
        (
            *_labels(row),
            row.cell.digest,
            records[row.cell.digest]["seconds"],
            records[row.cell.digest]["host"],
        )
        for row in done
    ]
    write_csv(folder / "times.csv", [*LABELS, "cell", "seconds", "host"], times)
    failed = [
        (*_labels(row), row.cell.digest, errors[row.cell.digest]) for row in rows if row.cell.digest in errors
    ]
    write_csv(folder / "failed.csv", [*LABELS, "cell", "error"], failed)
    content = {**origin, "n_rows": len(rows), "n_finished": len(done), "n_failed": len(failed)}
    with replaced(folder / "origin.json") as path:
        path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read_results(folder: Path) -> Results:
    """Read what `write_results` wrote.

    Raises
    ------
    InputError
        The folder holds no results of a study.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(folder / "results.parquet")
        origin = json.loads((folder / "origin.json").read_text(encoding="utf-8"))
        names = [name for name in table.column_names if name not in (*LABELS, "cell")]
        rows = table.to_pylist()
        if not set(LABELS) <= set(table.column_names) or not isinstance(origin, dict):
            raise ValueError("other columns")
    except OSError as error:
        raise InputError(
            f"{folder}: no results of a study ({error.strerror or 'not found'}); make them with: slammot-graph study"
            f" STUDY.toml --output {folder}"
        ) from None
    except (pa.ArrowException, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(
            f"{folder}: its results are damaged ({reason}); run the study again, finished cells are kept"
        ) from None
    return Results(rows=rows, measures=names, origin=origin)


def origin_of(title: str, argv: Sequence[str] | None = None) -> dict[str, Any]:
    """Where results are from: command, revision, versions and machine."""
    words = list(sys.argv[1:] if argv is None else argv)
    return {
        "title": title,
        "command": shlex.join(["slammot-graph", *words]),
        "version": __version__,
        "revision": revision(),
        "code": package_version()[:16],
        "versions": numeric_versions(),
        "machine": machine(),
    }


def revision(folder: Path = PACKAGE) -> str:
    """The revision of the checkout that a folder is in; "unknown" outside of one."""

    def git(*words: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(folder), *words], capture_output=True, text=True, check=False, timeout=20
        )
        return done.stdout.strip()

    try:
        if not git("ls-files", "--", str(PACKAGE / "__init__.py")):
            return "unknown"  # an installed package in somebody else's checkout
        changed = git("status", "--porcelain", "--", str(PACKAGE))
        return (git("rev-parse", "--short", "HEAD") or "unknown") + (
            " with local changes in slammot_graph" if changed else ""
        )
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"


def machine() -> str:
    """Processor and cores."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.processor() or 'unknown CPU'}, {os.cpu_count()} cores"


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Give a temporary path of this process alone that replaces `path` in the end."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror or error}); free some space or name another --output"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_csv(path: Path, heading: Sequence[str], rows: Any) -> None:
    """Write a CSV file atomically; numbers so that reading gives the same ones again, NaN and None empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heading)
    writer.writerows([_cell(value) for value in row] for row in rows)
    with replaced(path) as temporary:
        temporary.write_text(text.getvalue(), encoding="utf-8")


def _labels(row: Planned) -> tuple[Any, ...]:
    return tuple(getattr(row, name) for name in LABELS)


def _cell(value: Any) -> Any:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return repr(value) if isinstance(value, float) else value


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
