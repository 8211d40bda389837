"""Imports go down only, and each package stands alone."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

# From the bottom up: a module may import what stands before it.
JAXMPM = [
    "pytrees",
    "types",
    "files",
    "check",
    "tensors",
    "shape",
    "stencil",
    "native",
    "primitives",
    "transfer",
    "spectral",
    "softening",
    "materials",
    "frictional",
    "boundary",
    "affine",
    "averages",
    "soil",
    "discretisation",
    "step",
    "diagnostics",
    "equilibrium",
    "integrate",
    "replay",
    "objectives",
    "sensitivity",
    "many",
    "reduction",
    "scenes",
    "io",
]


def imported(path: Path) -> set[str]:
    """Modules that a file imports, in full, with the names taken from packages appended."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def test_every_module_of_the_solver_has_its_layer():
    found = {path.relative_to(ROOT / "jaxmpm").parts[0].removesuffix(".py") for path in modules("jaxmpm")}
    assert found - {"__init__"} <= set(JAXMPM)


@pytest.mark.parametrize("path", modules("jaxmpm"), ids=lambda p: p.stem)
def test_imports_of_the_solver_go_down(path):
    name = path.relative_to(ROOT / "jaxmpm").parts[0].removesuffix(".py")
    if name == "__init__":
        return
    below = JAXMPM[: JAXMPM.index(name) + 1]
    for module in imported(path):
        if module.startswith("jaxmpm."):
            assert module.split(".")[1] in below, f"{name} imports {module}, which stands above it"


@pytest.mark.parametrize(
    ("package", "foreign"),
    [("jaxmpm", ("kl", "cooperative", "benchmarks")), ("kl", ("jaxmpm", "cooperative", "benchmarks"))],
)
def test_lower_packages_know_nothing_of_the_upper(package, foreign):
    for path in modules(package):
        tops = {module.split(".")[0] for module in imported(path)}
        assert not tops & set(foreign), f"{path.name} imports {tops & set(foreign)}"


def test_campaigns_use_only_what_the_packages_export():
    exported = {}
    for package in ("jaxmpm", "kl"):
        tree = ast.parse((ROOT / package / "__init__.py").read_text())
        names = [n for n in ast.walk(tree) if isinstance(n, ast.Assign) and ast.unparse(n.targets[0]) == "__all__"]
        exported[package] = set(ast.literal_eval(names[0].value))
    for path in modules("cooperative"):
        for module in imported(path):
            top, _, rest = module.partition(".")
            if top in exported and rest:
                assert rest in exported[top], f"{path.name} imports {module}, which {top} does not export"
