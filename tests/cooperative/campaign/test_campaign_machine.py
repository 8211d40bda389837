"""Whatever happens to a campaign's folder, in any order: it ends as an undisturbed one, or says what is damaged."""

import contextlib
import io
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import textwrap
import time
import warnings
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test

from benchmarks.robustness import hostile_files, invented, lives
from cooperative import campaign
from cooperative.__main__ import main
from cooperative.exports import _export
from cooperative.reporting import _composition, _interactive, _plots
from cooperative.store import DamagedFile, _database, _samples, read_store
from tests import ROOT
from tests.databases import by_sql, delete, finished, spoil

SCENE = invented.SCENE.replace("samples = 50", "samples = 20").replace("refined_runs = 15", "refined_runs = 10")

LIVES = textwrap.dedent("""
    import os, sys, warnings
    from benchmarks.robustness import invented
    from cooperative import campaign
    warnings.simplefilter("ignore")
    invented.invent(seconds=0.005)
    for folder in sys.stdin:
        life = os.fork()
        if life == 0:
            campaign.run(sys.argv[1], folder.strip())
            os._exit(0)
        print(life, flush=True)
        os.waitpid(life, 0)
        print("gone", flush=True)
""")


class Cut(BaseException):
    """An end that nobody expects, at a write."""


class Folder(RuleBasedStateMachine):
    """A campaign's folder and what may happen to it. `undisturbed` and `lives` are set by the test."""

    undisturbed: Path
    lives: subprocess.Popen
    where: Path
    count = 0

    def __init__(self):
        super().__init__()
        type(self).count += 1
        self.folder = self.where / f"campaign-{self.count}"
        self.struck = False  # whether its database was damaged, and not only a row of it

    def there(self):
        """Whether the folder is a campaign's by now."""
        return (self.folder / "campaign.db").exists()

    def runs(self):
        """Grid and number of the runs that have ended, in order."""
        try:
            return by_sql(self.folder, "select grid, sample from run order by 1, 2") if self.there() else []
        except sqlite3.DatabaseError:
            return []

    @rule(command=st.sampled_from(["run", "resume"]))
    def runs_to_the_end(self, command):
        """The answer is that of the undisturbed campaign, or nothing of the scene is left and it says so."""
        if command == "resume" and not self.there():
            return
        refused = None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                source = SCENE if command == "run" else read_store(self.folder).source
                campaign.run(source, self.folder, verify=True)
            except DamagedFile as error:
                refused = str(error)
        if refused is None:
            assert [line for line in lives.differences(self.folder, self.undisturbed) if "aside" not in line] == []
        else:
            assert self.struck, refused
            assert "put back" in refused
            shutil.rmtree(self.folder)
        self.struck = False

    @rule(writes=st.integers(0, 40), after=st.booleans())
    def is_cut_short(self, writes, after):
        """It ends at a write: before a transaction is committed, or just after."""
        left = writes

        @contextlib.contextmanager
        def transaction(*given):
            nonlocal left
            left -= 1
            with _database.transaction(*given) as database:
                yield database
                if left < 0 and not after:
                    raise Cut
            if left < 0:
                raise Cut

        with pytest.MonkeyPatch.context() as patched, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            patched.setattr(_samples, "transaction", transaction)
            with contextlib.suppress(Cut, DamagedFile):
                campaign.run(SCENE, self.folder)

    @rule(milliseconds=st.integers(0, 200))
    def is_killed(self, milliseconds):
        self.lives.stdin.write(f"{self.folder}\n")
        self.lives.stdin.flush()
        life = int(self.lives.stdout.readline())
        time.sleep(milliseconds / 1000)
        os.kill(life, signal.SIGKILL)
        assert self.lives.stdout.readline() == "gone\n"

    @precondition(lambda self: self.runs())
    @rule(seed=st.integers(0, 10**6), what=st.sampled_from(["row", "fields", "database"]))
    def something_is_damaged(self, seed, what):
        generator = random.Random(seed)
        grid, number = generator.choice(self.runs())
        paths = list((self.folder / "fields").glob(f"{grid}-{number:06d}-*.h5"))
        if what == "row":
            with contextlib.suppress(sqlite3.DatabaseError):
                spoil(self.folder, grid, number)
            return
        path = self.folder / "campaign.db" if what == "database" or not paths else paths[0]
        ((_, data),) = list(hostile_files.damaged(path.read_bytes(), 1 + seed % 5, seed=seed))[-1:]
        path.write_bytes(data)
        self.struck = self.struck or path.name == "campaign.db"

    @precondition(lambda self: self.runs())
    @rule(seed=st.integers(0, 10**6))
    def samples_are_deleted(self, seed):
        generator = random.Random(seed)
        for grid, number in generator.sample(self.runs(), generator.randint(1, min(5, len(self.runs())))):
            with contextlib.suppress(sqlite3.DatabaseError):
                delete(self.folder, grid, number)

    @rule(name=st.sampled_from(["summary.json", ".lock", "table.csv", "fields"]))
    def something_else_is_deleted(self, name):
        path = self.folder / name
        if path.is_dir():
            shutil.rmtree(path)
        elif path.is_file():
            path.unlink()

    @precondition(lambda self: self.there())
    @rule(command=st.sampled_from(["report", "status", "export"]))
    def is_looked_at(self, command):
        """Whoever looks gets an answer, or a reason in one line; never a traceback."""
        printed = io.StringIO()
        with contextlib.redirect_stderr(printed), contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            status = main([command, str(self.folder)])
        assert status in (0, 2)
        if status == 2:
            assert printed.getvalue().startswith("error: ")
            assert len(printed.getvalue().splitlines()) == 1

    def teardown(self):
        self.runs_to_the_end("run")


@pytest.mark.usefixtures("unwritten")
def test_a_folder_to_which_anything_happens_ends_as_an_undisturbed_one(tmp_path):
    assert_holds(tmp_path, max_examples=2, stateful_step_count=8)


@pytest.mark.slow
@pytest.mark.usefixtures("unwritten")
def test_a_folder_to_which_anything_happens_often_ends_as_an_undisturbed_one(tmp_path):
    assert_holds(tmp_path, max_examples=40, stateful_step_count=20)


@pytest.fixture
def unwritten(made_up):
    """Made-up runs, whose fields belong to no particles that could be drawn or exported."""
    made_up.setattr(_composition, "_slopes", lambda *_: [])
    made_up.setattr(_plots, "save", lambda *_: None)
    made_up.setattr(_plots, "lay_out", lambda _: None)
    made_up.setattr(_interactive, "_inlined", lambda _: "")
    made_up.setattr(_interactive, "installed", lambda: False)
    made_up.setattr(_export, "_series_of_fields", lambda store, *_: store.folder)


@pytest.mark.usefixtures("unwritten")
def test_a_report_names_the_refined_runs_that_it_cannot_rank(tmp_path, capsys):
    campaign.run(SCENE, tmp_path)
    first, second, *_ = sorted(finished(tmp_path, "refined"))
    delete(tmp_path, "rough", first)
    spoil(tmp_path, "rough", second)
    assert main(["report", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert f"refined run {first} has no rough run beside it: resume" in printed
    assert f"refined run {second} has no rough run beside it: resume" in printed
    assert f"sample {second} of the rough grid does not match its checksum: will be run again" in printed
    with pytest.warns(UserWarning, match="set aside"):
        campaign.run(SCENE, tmp_path)
    assert main(["report", str(tmp_path)]) == 0
    assert "LEFT OUT" not in capsys.readouterr().out


def assert_holds(folder, **how):
    campaign.run(SCENE, folder / "undisturbed")
    command = [sys.executable, "-c", LIVES, SCENE]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT, text=True) as lives:
        machine = type("Machine", (Folder,), {"undisturbed": folder / "undisturbed", "lives": lives, "where": folder})
        checks = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]
        # Without shrinking, which takes minutes here: the steps of a failure are printed as they were.
        chosen = settings(deadline=None, suppress_health_check=checks, phases=[Phase.generate], **how)
        run_state_machine_as_test(machine, settings=chosen)
        lives.stdin.close()
