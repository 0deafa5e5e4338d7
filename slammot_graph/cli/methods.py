"""The commands that say what there is: `methods` and `config`."""

from typing import Annotated

import tyro
from rich.table import Table

from slammot_graph.cli.console import EXIT_OK, stdout


def methods_command() -> int:
    """List the methods of the registry: what each is, and what it changes."""
    from slammot_graph.methods import METHODS

    table = Table("method", "what it is", title="Methods")
    for method in METHODS.values():
        table.add_row(method.name, method.summary)
    stdout().print(table)
    return EXIT_OK


def config_command(*, method: Annotated[str, tyro.conf.arg(metavar="NAME")] = "graph") -> int:
    """Print all settings of a method as TOML, to be changed and given to `run --config`.

    Parameters
    ----------
    method
        One of those that `slammot-graph methods` lists.
    """
    from slammot_graph.core.config import to_toml
    from slammot_graph.methods import get_method

    chosen = get_method(method)
    text = f"# slammot-graph run LOG --output DIR --method {chosen.name} --config FILE.toml\n"
    stdout().print(text + to_toml(chosen.config), end="", soft_wrap=True)
    return EXIT_OK
