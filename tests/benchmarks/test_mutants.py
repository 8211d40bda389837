"""Mutants: what they change, which tests run for them, and what counts as killed."""

import ast

import pytest

from benchmarks.project import mutants
from benchmarks.project.mutants import Copy, drawn, fates, files_for, mutants_of


@pytest.mark.parametrize(
    ("code", "changed"),
    [
        ("a < b", {"a <= b", "a >= b"}),
        ("a == b in c", {"a != b in c", "a == b not in c"}),
        ("a + b", {"a - b"}),
        ("a and b or c", {"(a and b) and c", "(a or b) or c"}),
        ("not a", {"a"}),
        ("-a", {"a"}),
        ("3", {"4"}),
        ("0.5", {"1.0"}),
        ("0.0", {"1.0"}),
        ("True", {"False"}),
        ("np.minimum(a, b)", {"np.maximum(a, b)"}),
        ("min(a)", {"max(a)"}),
        ("a * (b - c)", {"a / (b - c)", "a * (b + c)"}),
        ("def f():\n    return a", {"def f():\n    return None"}),
    ],
)
def test_one_thing_is_changed_at_a_time(code, changed):
    found = [mutant.put(code.encode()).decode() for mutant in mutants_of("a.py", code)]
    assert len(found) == len(changed)
    assert {ast.unparse(ast.parse(each)) for each in found} == {ast.unparse(ast.parse(each)) for each in changed}


def test_types_and_messages_are_left_alone():
    code = 'def f(x: int | A[1] = None) -> A[1]:\n    raise ValueError(f"{x + 1}", "a" + "b")\n    return\n'
    assert mutants_of("a.py", code) == []


def test_a_draw_is_of_its_seed_and_each_mutant_another_program():
    few = drawn(1, 40)
    assert few == drawn(1, 40) != drawn(2, 40)
    assert len({mutant.name for mutant in few}) == 40
    for mutant in few:
        source = (mutants.ROOT / mutant.path).read_bytes()
        assert ast.dump(ast.parse(mutant.put(source))) != ast.dump(ast.parse(source)), mutant.name
        assert 0 < len(files_for(mutant, mutants.ROOT)) <= mutants.FILES


CODE = "def low(a):\n    return a < 3\n\n\ndef up(a):\n    while a < 3:\n        a = a + 1\n    return a\n"
TESTS = """from kl.own import low, up

def test_broken():
    assert False

def test_low():
    assert low(2) and not low(4)

def test_up():
    assert up(1) == 3
"""


@pytest.fixture
def tiny(tmp_path):
    """A repository of one module and its tests, one of which fails at any rate."""
    files = {"kl/__init__.py": "", "kl/own.py": CODE, "tests/kl/test_own.py": TESTS, "sitecustomize.py": mutants.CLEAR}
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return Copy(tmp_path)


def test_a_mutant_is_killed_by_a_test_that_passes_without_it(tiny, tmp_path, monkeypatch):
    changes = {(*mutant.inside, mutant.change): mutant for mutant in mutants_of("kl/own.py", CODE)}
    chosen = [changes["low", "a < 3 -> a <= 3"], changes["low", "return a < 3 -> return None"], changes["up", "1 -> 2"]]
    monkeypatch.setattr(mutants, "LIMIT", 60.0)
    rows = fates(tiny, chosen, tmp_path / "stored")
    assert [(row["fate"], row["by"].partition("::")[2]) for row in rows] == [
        ("survived", ""),
        ("killed", "test_low"),
        ("survived", ""),
    ]
    assert (tmp_path / "kl" / "own.py").read_text() == CODE
    # What is stored is not tried again.
    (tmp_path / "tests" / "kl" / "test_own.py").write_text("def test_low():\n    pass\n")
    monkeypatch.setattr(Copy, "tried", None)
    assert fates(tiny, chosen, tmp_path / "stored") == rows
    monkeypatch.undo()
    monkeypatch.setattr(mutants, "LIMIT", 5.0)
    (tmp_path / "tests" / "kl" / "test_own.py").write_text(
        "from kl.own import up\n\ndef test_up():\n    assert up(1)\n"
    )
    assert tiny.tried(changes["up", "a + 1 -> a - 1"], ["tests/kl/test_own.py"])["fate"] == mutants.LATE
