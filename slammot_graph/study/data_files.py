"""Files that cells read, known by the digest of their content: found on whatever machine computes the cell."""

import hashlib
import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from slammot_graph.core.errors import InputError
from slammot_graph.core.files import check_regular

DATA_VARIABLE = "SLAMMOT_DATA"
"""Environment variable: a folder in whose tree files are looked for by name and digest."""
CACHE_VARIABLE = "SLAMMOT_CACHE"
"""Environment variable: the folder of files that came from another machine, in place of the user's cache."""
_BLOCK = 1 << 20


@dataclass(frozen=True, kw_only=True)
class DataFile:
    """A file, or the folder of a ROS 2 bag.

    Attributes
    ----------
    path : str
        Where it lies on the machine that planned the study.
    digest : str
        SHA-256 of its content, of a folder that of its files' names and contents.
    """

    path: str
    digest: str

    @property
    def name(self) -> str:
        """Its name without folders."""
        return Path(self.path).name


class MissingDataError(InputError):
    """A file that a cell needs is not on this machine."""

    def __init__(self, file: DataFile) -> None:
        super().__init__(
            f"{file.path}: not on this machine with the content that was planned; set {DATA_VARIABLE} to the folder"
            " of the logs"
        )
        self.file = file


def data_file(path: Path) -> DataFile:
    """Name a file by its content.

    Raises
    ------
    InputError
        It cannot be read.
    """
    check_regular(path)
    try:
        return DataFile(path=str(path), digest=digest_of(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path") from None


def digest_of(path: Path) -> str:
    """SHA-256 of the content of a file or folder."""
    return _digest(str(path), _state(path))


def find(file: DataFile) -> Path:
    """Find a file on this machine: at its path, among what was brought here, or below $SLAMMOT_DATA.

    Raises
    ------
    MissingDataError
        It is nowhere.
    """
    known = Path(file.path)
    if known.exists() and digest_of(known) == file.digest:
        return known
    brought = cache_folder() / file.digest / file.name
    if brought.exists():
        return brought
    named = os.environ.get(DATA_VARIABLE)
    for path in sorted(Path(named).rglob(file.name)) if named else []:
        if digest_of(path) == file.digest:
            return path
    raise MissingDataError(file)


def cache_folder() -> Path:
    """Where files from other machines are kept."""
    named = os.environ.get(CACHE_VARIABLE)
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(named) if named else Path(home) / "slammot_graph" / "data"


def content_of(path: Path) -> dict[str, bytes]:
    """Files of a path by their names relative to it; "" for a single one."""
    if path.is_dir():
        return {one.relative_to(path).as_posix(): one.read_bytes() for one in _files(path)}
    return {"": path.read_bytes()}


def keep(file: DataFile, content: dict[str, bytes]) -> None:
    """Put a file into this machine's cache; the last step is one rename, so that nobody sees half of it."""
    final = cache_folder() / file.digest
    if final.exists():
        return
    folder = final.with_name(f".{file.digest}.{os.getpid()}")
    for name, data in content.items():
        path = folder / file.name / name if name else folder / file.name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    try:
        folder.rename(final)
    except OSError:  # another process was faster
        for path in sorted(folder.rglob("*"), reverse=True):
            path.rmdir() if path.is_dir() else path.unlink()
        folder.rmdir()


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _state(path: Path) -> tuple[tuple[str, int, int], ...]:
    """Names, sizes and times: as long as they stay, the digest does."""
    files = _files(path) if path.is_dir() else [path]
    return tuple((str(one), one.stat().st_size, one.stat().st_mtime_ns) for one in files)


@lru_cache(maxsize=1024)
def _digest(path: str, state: tuple[tuple[str, int, int], ...]) -> str:
    root, digest = Path(path), hashlib.sha256()
    for name, size, _ in state:
        if root.is_dir():
            digest.update(f"{Path(name).relative_to(root).as_posix()} {size}\n".encode())
        with Path(name).open("rb") as file:
            while block := file.read(_BLOCK):
                digest.update(block)
    return digest.hexdigest()
