"""Sphinx: the API reference from the docstrings; ``make docs`` builds it."""

import re
import shutil
import sys
from pathlib import Path

from slammot_graph import __version__

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS.parent))

project = "slammot_graph"
author = "The slammot_graph developers"
project_copyright = author
version = release = __version__

extensions = [
    "sphinx.ext.apidoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "numpydoc",
    "myst_parser",
]
exclude_patterns = ["api/modules.rst"]
default_role = "code"

apidoc_modules = [
    {
        "path": "../slammot_graph",
        "destination": "api",
        "separate_modules": True,
        "module_first": True,
        "exclude_patterns": ["../slammot_graph/__main__.py"],
        "automodule_options": {"members", "show-inheritance"},
    }
]

autodoc_default_options = {
    "ignore-module-all": True,  # each name once, in the module that defines it
    "exclude-members": "cKDTree",  # SciPy's, whose signature autodoc cannot read
}
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say more: shapes, units and frames
autodoc_preserve_defaults = True
numpydoc_show_class_members = False  # autodoc lists them

html_title = "slammot_graph"
html_theme_options = {"page_width": "1100px", "description": "2D laser SLAM among moving people"}


def write_gallery() -> None:
    """A page for each experiment, with its picture, command and table, and one that lists them."""
    from experiments.gallery import ENTRIES

    folder = DOCS / "gallery"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    rows = []
    for entry in ENTRIES:
        page = [f"# {entry.what}", "", f"`{entry.command}`", ""]
        if entry.figure is not None:
            page += [f"```{{image}} ../../experiments/figures/{entry.figure}.png", ":width: 100%", "```", ""]
        if entry.table.is_file():
            text = entry.table.read_text(encoding="utf-8").partition("\n")[2]
            page.append(re.sub(r"figures/(\w+\.png)", r"experiments/figures/\1", text))
        (folder / f"{entry.name}.md").write_text("\n".join(page) + "\n", encoding="utf-8")
        picture = f"![](../../experiments/figures/{entry.figure}.png)" if entry.figure else ""
        rows.append(f"| [{entry.what}]({entry.name}.md) | `{entry.command}` | {picture} |")
    head = ["# Experiments", "", "Each with its command, picture and table; all by `make tables`.", ""]
    head += ["| experiment | command | |", "|---|---|---|"]
    toc = ["", "```{toctree}", ":hidden:", "", *(entry.name for entry in ENTRIES), "```", ""]
    (folder / "index.md").write_text("\n".join([*head, *rows, *toc]), encoding="utf-8")


write_gallery()
