"""The state of a run as bytes, and back: plain values, arrays and objects of the package, and nothing else.

The bytes are those of `pickle`, since a state is hundreds of small objects that refer to each other and that only
their own classes know how to build. What is read back may name classes of the package's own estimation, arrays and
containers; anything else, which is how pickles do harm, is refused. Outside of the bytes stay what a log knows of its
whole odometry, and spools, which only grow.
"""

import importlib
import io
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from slammot_graph.core.errors import InputError
from slammot_graph.core.odometry_track import OdometryTrack
from slammot_graph.core.spool import Spool

_PLAIN = frozenset(
    {
        ("array", "array"),
        ("array", "_array_reconstructor"),
        ("builtins", "bytearray"),
        ("builtins", "complex"),
        ("builtins", "frozenset"),
        ("builtins", "range"),
        ("builtins", "set"),
        ("builtins", "slice"),
        ("collections", "Counter"),
        ("collections", "OrderedDict"),
        ("collections", "defaultdict"),
        ("collections", "deque"),
        ("numpy", "dtype"),
        ("numpy", "ndarray"),
        ("numpy._core.multiarray", "_reconstruct"),
        ("numpy._core.multiarray", "scalar"),
        ("numpy._core.numeric", "_frombuffer"),
    }
)
"""What else a state consists of."""

_PARTS = frozenset(
    {
        "core",
        "detection",
        "diagnosis",
        "graph",
        "kept_scans",
        "localization",
        "loop_closure",
        "mapping",
        "odometry",
        "pipeline",
        "pipeline_config",
        "registration",
        "tracking",
    }
)
"""Parts of the package whose objects are a run's state."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FrozenRun:
    """The state of a run between two scans.

    Attributes
    ----------
    fingerprint : mapping of str to str
        What the state is bound to: method, settings, versions.
    n_scans : int
        Scans that were taken.
    digest : int
        Checksum of them.
    state : bytes or None
        As `freeze` gives it; None for a method whose state cannot be kept.
    spools : tuple of Spool
        What belongs to it and only grows; not to be changed.
    """

    fingerprint: Mapping[str, str]
    n_scans: int
    digest: int
    state: bytes | None
    spools: tuple[Spool, ...]

    def check(self, expected: Mapping[str, str]) -> None:
        """Refuse to go on as something else than what it is.

        Raises
        ------
        InputError
            The fingerprint is another one.
        """
        for what, text in expected.items():
            if self.fingerprint.get(what) != text:
                raise InputError(
                    f"the checkpoint is of {_NAMES[what]}; run with --overwrite to begin anew, or as it was begun"
                )


_NAMES = {
    "method": "another method",
    "config": "other settings",
    "start": "another start in a saved map",
    "versions": "another version of this program or of its packages",
}


def freeze(state: object, spools: Sequence[Spool], track: OdometryTrack | None) -> bytes:
    """Give a state as bytes, without the bytes of its spools and without the log's odometry `track`.

    Raises
    ------
    TypeError, pickle.PicklingError
        The state holds what cannot be kept.
    """
    numbers = {id(spool): k for k, spool in enumerate(spools)}

    def of_spool(spool: Spool) -> tuple[Callable[..., Any], tuple[int]]:
        return _spool, (numbers[id(spool)],)

    def of_track(one: OdometryTrack) -> Any:
        return (_track, ()) if one is track else object.__reduce_ex__(one, 4)

    file = io.BytesIO()
    pickler = pickle.Pickler(file, protocol=5)
    pickler.dispatch_table = {Spool: of_spool, OdometryTrack: of_track}
    pickler.dump(state)
    return file.getvalue()


def thaw(data: bytes, spools: Sequence[Spool], track: OdometryTrack | None) -> Any:
    """Give the state back that `freeze` was given.

    Raises
    ------
    InputError
        The bytes are not those of a state.
    """
    outside: dict[str, Callable[..., Any]] = {"_spool": lambda k: spools[k], "_track": lambda: track}

    class Unpickler(pickle.Unpickler):
        def find_class(self, module: str, name: str) -> Any:
            if module == __name__ and name in outside:
                return outside[name]
            if (module, name) in _PLAIN:
                return super().find_class(module, name)
            package, _, rest = module.partition(".")
            if package == "slammot_graph" and rest.split(".")[0] in _PARTS and "." not in name:
                found = getattr(importlib.import_module(module), name, None)
                if isinstance(found, type) and found.__module__ == module:
                    return found
            raise pickle.UnpicklingError(f"a state does not hold {module}.{name}")

    try:
        return Unpickler(io.BytesIO(data)).load()
    except Exception as error:  # whatever damaged bytes lead to
        raise InputError(f"not the state of a run: {error}") from error


def _spool(_number: int) -> Spool:
    raise NotImplementedError  # stands for the name alone: `thaw` puts the spool in its place


def _track() -> OdometryTrack:
    raise NotImplementedError
