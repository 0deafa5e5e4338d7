"""Sphinx: the API reference from the docstrings; ``make docs`` builds it."""

from slammot_graph import __version__

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
