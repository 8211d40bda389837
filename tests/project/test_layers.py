"""Imports go down only, from room to room, and each package stands alone."""

import ast
import importlib
import inspect
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

from tests import ROOT

# From the bottom up: a room, or a module that stands alone, may import what stands before it.
ROOMS = {
    "jaxmpm": (
        "support grid protocols types storage tensors transfer laws boundary equations _step diagnostics soil setup "
        "ground seepage run io plot"
    ),
    "kl": "_values _checks types axis marginal sampling field estimation soil gstools plots",
    "cooperative": (
        "names worker estimate store measure laboratory example_scenes scene runs summary folder hazard campaign "
        "exports reporting one_run doctor tools"
    ),
}
ENTRANCES = {"cooperative": {"__main__", "_arguments", "_commands"}}
# What is no campaign stands apart: the commands and users import it, the rest of `cooperative` never does.
WING = "cooperative.tools"
FOREIGN = {
    "jaxmpm": {"kl", "cooperative", "benchmarks", "tests"},
    "kl": {"jaxmpm", "cooperative", "benchmarks", "tests"},
    "cooperative": {"benchmarks", "tests"},
}


def imported(path: Path) -> set[str]:
    """Modules that a file imports, in full, with the names taken from packages appended."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path} has a relative import: name the module in full"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def room_of(path: Path) -> str:
    """The room or lone module that a file belongs to; "__init__" for that of the package."""
    return path.relative_to(ROOT).parts[1].removesuffix(".py")


MODULES = [path for package in ROOMS for path in modules(package)]


@pytest.mark.parametrize("package", ROOMS)
def test_every_module_stands_in_a_room(package):
    rooms = {room_of(path) for path in modules(package)} - {"__init__"} - ENTRANCES.get(package, set())
    assert rooms == set(ROOMS[package].split())


IMPORTS = [(path, path.relative_to(ROOT).parts[0], module) for path in MODULES for module in imported(path)]


def test_imports_go_down_and_stay_out_of_other_rooms_insides():
    for path, package, module in IMPORTS:
        room, order = room_of(path), ROOMS[package].split()
        top, *inside = module.split(".")
        if room == "__init__" or room in ENTRANCES.get(package, set()):
            continue
        if top != package or not inside or inside[0] not in order:
            continue
        assert inside[0] in order[: order.index(room) + 1], f"{path} imports {module}, which stands above it"
        if inside[0] != room:
            private = [name for name in inside[1:-1] if name.startswith("_")] or inside[-1].startswith("_")
            assert not private, f"{path} imports {module}, which is the inside of another room"


def test_estimates_are_made_of_arrays_alone():
    for path, _, module in IMPORTS:
        if path.is_relative_to(ROOT / "cooperative" / "estimate"):
            top = module.split(".")[0]
            assert module.startswith("cooperative.estimate") or top in {*sys.stdlib_module_names, "numpy", "scipy"}, (
                path
            )


def test_packages_know_nothing_of_those_above():
    for path, package, module in IMPORTS:
        assert module.split(".")[0] not in FOREIGN[package], f"{path} imports {module}"


def named(path: Path) -> set[str]:
    """Modules that a file imports, and every text in it that an import at run time could be given."""
    nodes = ast.walk(ast.parse(path.read_text()))
    return imported(path) | {node.value for node in nodes if isinstance(node, ast.Constant) and type(node.value) is str}


def in_wing(module: str) -> bool:
    return module == WING or module.startswith(f"{WING}.")


CORE = [
    path
    for path in modules("cooperative")
    if not in_wing(".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"))
    and room_of(path) not in ENTRANCES["cooperative"]
]


def test_a_campaign_imports_nothing_of_the_wing():
    for path in CORE:
        wrong = [module for module in named(path) if in_wing(module)]
        assert not wrong, f"{path} imports {wrong}, which is no part of a campaign"


def test_a_campaign_loads_nothing_of_the_wing():
    # A fresh process takes seconds to load JAX and matplotlib.
    script = """if True:
        import sys
        import cooperative.runs, cooperative.reporting
        slow = {"matplotlib", "scipy.optimize", "scipy.special", "scipy.stats"}
        print(*sorted(slow & sys.modules.keys()))
        import cooperative.campaign
        for name in cooperative.__all__:
            getattr(cooperative, name)
        print(*sys.modules)
    """
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    slow, names = done.stdout.splitlines()
    assert slow == "", "`check` loads what takes half a second and few commands need"
    loaded = names.split()
    assert {"cooperative.campaign", "cooperative.exports", "cooperative.reporting"} <= set(loaded)
    assert [module for module in loaded if in_wing(module)] == []


def test_an_import_of_the_wing_is_seen_wherever_it_stands(tmp_path):
    for number, text in enumerate(
        (
            "from cooperative.tools import sweep",
            "def f():\n    import cooperative.tools.safety._search as s",
            "from cooperative.tools import sweep_report",
            "from cooperative.tools.research.rare import form",
            "import_module('cooperative.tools.soundings')",
        )
    ):
        path = tmp_path / f"{number}.py"
        path.write_text(text)
        assert any(map(in_wing, named(path))), text
    assert not any(map(in_wing, ("cooperative.reporting._sweep", "cooperative.toolshed", "cooperative.scene.tables")))


def exported(package: str) -> set[str]:
    """Public names of a package, and those of the modules among them with a dot between."""
    top = importlib.import_module(package)
    rooms = {name: getattr(top, name) for name in top.__all__ if inspect.ismodule(getattr(top, name))}
    inner = {f"{room}.{name}" for room, module in rooms.items() for name in getattr(module, "__all__", vars(module))}
    return {*top.__all__, *(name for name in inner if not name.rpartition(".")[2].startswith("_"))}


def test_campaigns_use_only_what_the_packages_export():
    known = {package: exported(package) for package in ("jaxmpm", "kl")}
    for path in modules("cooperative"):
        for module in imported(path):
            top, _, rest = module.partition(".")
            if top in known and rest and not rest.startswith("support."):
                assert rest in known[top], f"{path.name} imports {module}, which {top} does not export"


def test_no_function_has_its_modules_name():
    for path in MODULES:
        functions = {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}
        assert path.stem.startswith("_") or path.stem not in functions, path


def code(path: Path) -> list[str]:
    """Lines of a module as they are spelt in one way, without imports and what stands there for people."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            left_out = ast.Import | ast.ImportFrom
            rest = [each for each in body if not isinstance(each, left_out) and not is_text(each)]
            node.body = rest or [ast.Pass()]
    return [line.strip() for line in ast.unparse(tree).splitlines() if line.strip()]


def is_text(node: ast.AST) -> bool:
    """Whether a statement is a text for people."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def repeated(paths: dict[str, list[Path]], lines: int) -> dict[str, set[str]]:
    """Passages of so many lines that stand in more than one room: passage -> rooms."""
    passages = defaultdict(set)
    for room, files in paths.items():
        for path in files:
            spelt = code(path)
            for first in range(len(spelt) - lines + 1):
                passages["\n".join(spelt[first : first + lines])].add(room)
    return {passage: rooms for passage, rooms in passages.items() if len(rooms) > 1}


def test_no_room_repeats_six_lines_of_another():
    rooms = defaultdict(list)
    for path in MODULES:
        rooms[f"{path.relative_to(ROOT).parts[0]}.{room_of(path)}"].append(path)
    assert repeated(rooms, 6) == {}


def test_repetition_is_seen_however_it_is_laid_out(tmp_path):
    passage = "a = f(1, 2)\nb = g(a)\n# why\nc = a + b\nd = c\n\ne = d\nf = [e,\n     a]\n"
    for name, text in {"one": passage, "two": "import os\n" + passage.replace("f(1, 2)", "f(1,\n  2)")}.items():
        (tmp_path / f"{name}.py").write_text(text)
    rooms = {name: [tmp_path / f"{name}.py"] for name in ("one", "two")}
    assert len(repeated(rooms, 6)) == 1


def test_no_class_name_stands_twice_in_the_packages():
    places = defaultdict(list)
    for path in MODULES:
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(path.relative_to(ROOT))
    twice = {name: paths for name, paths in places.items() if len(paths) > 1}
    assert not twice, f"each of these names stands for several things: {twice}"
