"""Strict TOML for nested frozen dataclasses: what is written can be read, what is misspelt is an error.

TOML has no null: ``None`` is written as the string ``"none"``, and such a string means ``None`` wherever the
field may be ``None``. A field that is one of several dataclasses names its class in the key ``type``.
"""

import dataclasses
import difflib
import enum
import json
import math
import tomllib
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar, Union

from slammot_graph.core.checks import FieldError
from slammot_graph.core.errors import ConfigError
from slammot_graph.core.files import MOST_SETTINGS_BYTES, check_regular

T = TypeVar("T")

_NONE = "none"
_TYPE_KEY = "type"

LARGEST_INTEGER = 2**53
"""Beyond it integers have no exact floating-point number, and far beyond it none at all."""


def load_config(path: str | Path, default: T) -> T:
    """Read a TOML file over a configuration: what the file does not name stays as in `default`.

    Parameters
    ----------
    path : str or Path
    default : frozen dataclass
        Its nested dataclasses are the tables of the file.

    Returns
    -------
    A configuration of the type of `default`.

    Raises
    ------
    ConfigError
        The file cannot be read, is not TOML, holds a key that does not exist, or a value that does not fit.
    """
    check_regular(Path(path), MOST_SETTINGS_BYTES)
    try:
        with Path(path).open("rb") as file:
            values = tomllib.load(file)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    except RecursionError:
        raise ConfigError(f"{path}: not a file of settings: tables within tables without end") from None
    except ValueError as error:  # of TOML, of its encoding, of numbers of thousands of digits
        raise ConfigError(f"{path}: not valid TOML: {_one_line(error)}") from None
    return from_plain(values, default, source=str(path))


def from_plain(values: Mapping[str, Any], default: T, *, source: str = "config") -> T:
    """Lay nested plain values, as made by `to_plain` or read from TOML or JSON, over a configuration.

    Parameters
    ----------
    values : mapping
    default : frozen dataclass
        Its class may have a method ``with_new_keys(values, default, source)`` that moves values from keys of an
        earlier release to those of today.
    source : str
        Where the values come from, for the error's text.

    Raises
    ------
    ConfigError
        A key that does not exist, or a value that does not fit.
    """
    with_new_keys = getattr(type(default), "with_new_keys", None)
    if with_new_keys is not None:
        values = with_new_keys(values, default, source)
    return typing.cast(T, _replace(default, values, _Place(source)))


def to_plain(config: Any) -> dict[str, Any]:
    """Turn a configuration into nested dicts, lists, strings and numbers, fit for strict JSON.

    Tuples become lists, paths strings and enumeration members their values; infinite and undefined numbers
    become the strings ``"inf"``, ``"-inf"`` and ``"nan"``. `from_plain` turns it back.
    """
    return _plain_fields(config, json_only=True)


def to_toml(config: Any) -> str:
    """Write a configuration as TOML, every field named: ``load_config`` gives the same configuration again.

    Raises
    ------
    ConfigError
        A text field that may be ``None`` holds the word that stands for ``None``.
    """
    lines: list[str] = []
    _write_table(_plain_fields(config, json_only=False), (), lines)
    return "\n".join(lines).strip() + "\n"


@dataclasses.dataclass(frozen=True)
class _Place:
    """Where in which source a value stands."""

    source: str
    keys: tuple[str, ...] = ()

    def __truediv__(self, key: str) -> "_Place":
        return _Place(self.source, (*self.keys, key))

    def error(self, text: str) -> ConfigError:
        name = ".".join(self.keys)
        return ConfigError(f"{self.source}: {name}: {text}" if name else f"{self.source}: {text}")

    def refused(self, error: FieldError) -> ConfigError:
        """Name the field by its whole path."""
        name = ".".join((*self.keys, error.key) if error.key else self.keys)
        return ConfigError(
            f"{self.source}: {name} {error.problem}" if name else f"{self.source}: {error.problem}"
        )

    def wrong(self, expected: str, value: Any) -> ConfigError:
        return self.error(f"expected {expected}, not {_shown(value)}")


def _fields(cls: type[Any]) -> dict[str, Any]:
    """Names and resolved types of the fields that can be set."""
    hints = typing.get_type_hints(cls)
    return {field.name: hints[field.name] for field in dataclasses.fields(cls) if field.init}


def _replace(default: Any, values: Mapping[str, Any], place: _Place) -> Any:
    hints = _fields(type(default))
    changes = {}
    for key, value in values.items():
        if key not in hints:
            raise _unknown_key(key, list(hints), place)
        changes[key] = _parse(value, hints[key], getattr(default, key), place / key)
    return _checked(lambda: dataclasses.replace(default, **changes), place)


def _build(cls: type[Any], values: Mapping[str, Any], place: _Place) -> Any:
    """Make a dataclass for which there is no default instance."""
    hints = _fields(cls)
    for key in values:
        if key not in hints:
            raise _unknown_key(key, list(hints), place)
    defaults = {field.name: _default(field) for field in dataclasses.fields(cls)}
    arguments = {key: _parse(value, hints[key], defaults[key], place / key) for key, value in values.items()}
    missing = [key for key in hints if key not in values and defaults[key] is dataclasses.MISSING]
    if missing:
        raise place.error(f"needs the key {missing[0]!r}")
    return _checked(lambda: cls(**arguments), place)


def _default(field: "dataclasses.Field[Any]") -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _checked(make: typing.Callable[[], Any], place: _Place) -> Any:
    try:
        return make()
    except FieldError as error:
        raise place.refused(error) from None
    except ConfigError as error:
        raise place.error(str(error)) from None


def _unknown_key(key: str, known: list[str], place: _Place) -> ConfigError:
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.0)
    hint = f"; the nearest known key is {near[0]!r}" if near else "; nothing can be set here"
    return place.error(f"unknown key {key!r}{hint}")


def _parse(value: Any, hint: Any, default: Any, place: _Place) -> Any:
    options = _options(hint)
    if type(None) in options:
        if value is None or (isinstance(value, str) and value == _NONE):
            return None
        options = [option for option in options if option is not type(None)]
    if len(options) == 1:
        return _parse_one(value, options[0], default, place)
    classes = {str(option.__name__): option for option in options if isinstance(option, type)}
    classes = {name: option for name, option in classes.items() if dataclasses.is_dataclass(option)}
    if classes and isinstance(value, Mapping):
        return _parse_tagged(value, classes, default, place)
    for option in options:
        try:
            return _parse_one(value, option, default, place)
        except ConfigError:
            continue
    raise place.wrong(" or ".join(dict.fromkeys(map(_describe, options))), value)


def _parse_tagged(
    value: Mapping[str, Any], classes: dict[str, type[Any]], default: Any, place: _Place
) -> Any:
    values = dict(value)
    name = values.pop(_TYPE_KEY, next(iter(classes)) if len(classes) == 1 else type(default).__name__)
    if name not in classes:
        raise (place / _TYPE_KEY).wrong(" or ".join(repr(known) for known in classes), name)
    return _parse_one(values, classes[name], default, place)


def _parse_one(value: Any, hint: Any, default: Any, place: _Place) -> Any:
    origin = typing.get_origin(hint)
    if dataclasses.is_dataclass(hint):
        if not isinstance(value, Mapping):
            raise place.wrong("a table", value)
        cls = typing.cast(type[Any], hint)
        return _replace(default, value, place) if type(default) is cls else _build(cls, value, place)
    if origin is typing.Literal:
        return _choice(value, {choice: choice for choice in typing.get_args(hint)}, place)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return _choice(value, {member.value: member for member in hint}, place)
    if origin is tuple:
        return _parse_tuple(value, typing.get_args(hint), hint, place)
    return _parse_scalar(value, hint, place)


def _parse_scalar(value: Any, hint: Any, place: _Place) -> Any:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if is_number and isinstance(value, int) and abs(value) > LARGEST_INTEGER:
        raise place.error(f"integers must lie within +-{LARGEST_INTEGER} (2^53)")
    if hint is float and is_number:
        return float(value)
    if hint is float and value in ("inf", "-inf", "nan"):
        return float(value)
    if hint in (bool, str) and isinstance(value, hint):
        return value
    if hint is int and is_number and isinstance(value, int):
        return value
    if hint is Path and isinstance(value, str):
        return Path(value)
    if hint not in (float, bool, str, int, Path):
        raise TypeError(f"{'.'.join(place.keys)}: fields of type {hint!r} cannot be set from a file")
    raise place.wrong(_describe(hint), value)


def _parse_tuple(value: Any, hints: tuple[Any, ...], hint: Any, place: _Place) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise place.wrong(_describe(hint), value)
    if len(hints) == 2 and hints[1] is Ellipsis:
        hints = (hints[0],) * len(value)
    if len(value) != len(hints):
        raise place.wrong(_describe(hint), value)
    return tuple(
        _parse(item, item_hint, dataclasses.MISSING, place / str(i))
        for i, (item, item_hint) in enumerate(zip(value, hints, strict=True))
    )


def _choice(value: Any, choices: Mapping[Any, Any], place: _Place) -> Any:
    for known, choice in choices.items():
        if type(known) is type(value) and known == value:
            return choice
    raise place.wrong(" or ".join(repr(known) for known in choices), value)


def _options(hint: Any) -> list[Any]:
    """The members of a union, or the type itself."""
    if typing.get_origin(hint) in (Union, types.UnionType):
        return list(typing.get_args(hint))
    return [hint]


def _describe(hint: Any) -> str:
    plain = {float: "a number", int: "an integer", bool: "true or false", str: "a text", Path: "a path"}
    if hint in plain:
        return plain[hint]
    if typing.get_origin(hint) is typing.Literal:
        return " or ".join(map(repr, typing.get_args(hint)))
    if typing.get_origin(hint) is tuple:
        items = typing.get_args(hint)
        return "a list" if len(items) == 2 and items[1] is Ellipsis else f"a list of {len(items)} values"
    if dataclasses.is_dataclass(hint):
        return "a table"
    return str(hint)


def _plain_fields(config: Any, json_only: bool) -> dict[str, Any]:
    hints = _fields(type(config))
    return {name: _plain(getattr(config, name), hint, json_only) for name, hint in hints.items()}


def _plain(value: Any, hint: Any, json_only: bool) -> Any:
    options = _options(hint)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        tag = {_TYPE_KEY: type(value).__name__} if sum(map(dataclasses.is_dataclass, options)) > 1 else {}
        return tag | _plain_fields(value, json_only)
    if isinstance(value, enum.Enum):
        return _plain(value.value, None, json_only)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple | list):
        hints = typing.get_args(hint) if typing.get_origin(hint) is tuple else ()
        if len(hints) != len(value) or Ellipsis in hints:
            hints = (hints[0] if hints else None,) * len(value)
        return [_plain(item, item_hint, json_only) for item, item_hint in zip(value, hints, strict=True)]
    if isinstance(value, float) and json_only and not math.isfinite(value):
        return str(value)
    if value == _NONE and isinstance(value, str) and type(None) in options:
        raise ConfigError(f"the text {_NONE!r} cannot be kept apart from None")
    return value


def _write_table(table: Mapping[str, Any], path: tuple[str, ...], lines: list[str]) -> None:
    nested = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    if path and (len(nested) < len(table) or not nested):
        lines += ["", f"[{'.'.join(_toml_key(key) for key in path)}]"]
    lines += [f"{_toml_key(key)} = {_toml_value(table[key])}" for key in table if key not in nested]
    for key, value in nested.items():
        _write_table(value, (*path, key), lines)


def _toml_key(key: str) -> str:
    return key if key.isascii() and key.isidentifier() else _toml_value(key)


def _toml_value(value: Any) -> str:
    if value is None:
        return _toml_value(_NONE)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return f"[{', '.join(map(_toml_value, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{_toml_key(k)} = {_toml_value(v)}' for k, v in value.items())} }}"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _shown(value: Any) -> str:
    text = _toml_value(value) if not isinstance(value, Mapping) else "a table"
    return text if len(text) <= 60 else text[:57] + "..."


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
