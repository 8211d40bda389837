"""The site of `make docs`, made by Sphinx from Markdown, notebooks and docstrings: guides, API, results."""

from importlib import import_module
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.errors import ExtensionError

PACKAGES = ("jaxmpm", "kl", "cooperative")

project, author = "jaxmpm", "The jaxmpm authors"
version = release = import_module("jaxmpm").__version__
root_doc = "docs/index"
include_patterns = ["docs/**", "notebooks/*.ipynb", "benchmarks/RESULTS.md", "benchmarks/pages/*.md", "CHANGELOG.md"]
exclude_patterns = ["docs/gallery/**", "docs/templates/**"]
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
templates_path = ["templates"]
nb_execution_mode = "off"
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
maximum_signature_line_length = 80
napoleon_numpy_docstring = False
default_role = "py:obj"
html_theme = "furo"
html_title = f"jaxmpm {version}"


def check_names(app: Sphinx, env: BuildEnvironment) -> None:
    """Fail where a public name stands on no page of the API, or has no docstring."""
    listed = "\n".join(page.read_text("utf-8") for page in Path(app.confdir, "api").glob("*.md")).split()
    faults = []
    for package in map(import_module, PACKAGES):
        for name in package.__all__:
            full = f"{package.__name__}.{name}"
            if name != "__version__" and full not in listed:
                faults.append(f"{full} stands on no page of docs/api")
            elif not isinstance(getattr(package, name), str) and not getattr(package, name).__doc__:
                faults.append(f"{full} has no docstring")
    if faults:
        raise ExtensionError("\n".join(faults))


def escape_bars(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Read the bars of an absolute value or a union in a docstring as they stand, not as a substitution."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def setup(app: Sphinx) -> None:
    """Read docstrings as they are written, and check the public names once all pages are read."""
    app.connect("autodoc-process-docstring", escape_bars)
    app.connect("env-check-consistency", check_names)
