"""The commands: going on from a folder, how far a campaign is, exports; errors in one line."""

import ast
import gc
import io
import os
import socket
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from cooperative import exports, runs
from cooperative.__main__ import main
from cooperative.reporting import _progress as progress
from cooperative.scene import parse, read_scene
from cooperative.store import FinishedRun, open_store, read_rows, read_sample, read_store, write_sample
from cooperative.summary import summarise
from cooperative.tools import sweep
from jaxmpm.support.text import duration
from tests import ROOT
from tests.cooperative.campaign.test_campaign import TINY
from tests.databases import finished, spoil
from tests.jaxmpm.run.test_io import vtk_steps

PUBLISHED = TINY.replace("samples = 6", "samples = 20")
TWO_PHASE = PUBLISHED.replace('estimator = "published"', "refined_runs = 10")


def invented(number, displacement, *, modes=3, broke_off=False, seconds=2.0):
    row = {"displacement": displacement, "broke_off": broke_off}
    if not broke_off:
        row |= {"depth": 1.0, "runout": 2.0, "volume": 3.0, "area": 4.0}
    return FinishedRun(number, "NOT_FINITE" if broke_off else "SETTLED", 100, seconds, np.zeros(modes), row)


def invented_campaign(folder, text, rough, refined, *, every=2.0):
    """A campaign whose samples were finished `every` seconds, with these displacements: (number, metres); below 0 they
    broke off."""
    modes = runs.random_soil(parse(text)).modes
    with open_store(folder, text) as store:
        for grid, samples in (("rough", rough), ("refined", refined)):
            for at, (number, displacement) in enumerate(samples):
                with pytest.MonkeyPatch.context() as patched:
                    patched.setattr(time, "time", lambda at=at: 1e9 + every * at)
                    write_sample(
                        store, grid, invented(number, abs(displacement), modes=modes, broke_off=displacement < 0)
                    )
    return folder


def test_status_while_screening(tmp_path, capsys):
    folder = invented_campaign(tmp_path / "c", TWO_PHASE, [(n, 2.0 if n < 2 else 0.1) for n in range(8)], [])
    status = progress.progress_of(folder)
    rough, refined = status.grids
    assert (rough.done, rough.planned, refined.done, refined.planned) == (8, 20, 0, 10)
    assert rough.hourly == pytest.approx(1800)
    assert rough.seconds_left == pytest.approx(24)
    # Four particles for one, and half the step: eight times a rough run each.
    assert refined.seconds_left == pytest.approx(10 * 8 * 2)
    assert status.estimate.probability == 2 / 8
    assert main(["status", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "8 of 20 samples, 1,800 per hour, 24 s left" in printed
    assert "not known yet  (rough grid alone; no refined run counts so far)" in printed
    assert "screening is not complete: 0.25 of the samples so far fail on the rough grid" in printed


@pytest.mark.parametrize("scene", [TWO_PHASE, PUBLISHED], ids=["two-phase", "published"])
def test_a_report_while_screening_says_so_and_gives_the_share_on_the_rough_grid(scene, tmp_path):
    # As many rough runs broke off as a campaign of so few samples would have refined runs.
    rough = [(n, -0.5 if n < 3 else 2.0 if n < 5 else 0.1) for n in range(8)]
    folder = invented_campaign(tmp_path / "c", scene, rough, [])
    campaign, store = parse(scene), read_store(folder)
    summary = summarise(campaign, read_rows(store, "rough"), read_rows(store, "refined"))
    assert summary.probability.value == 2 / 5
    # What the refined grid makes of them is open.
    assert summary.probability.interval == (0.0, 1.0)
    assert summary.probability.estimator == "rough grid alone"
    assert summary.cost.finished is None
    assert summary.notes[0].startswith("screening is not complete")
    assert "3 rough runs gave no answer" in summary.notes[1]
    assert progress.progress_of(folder).estimate.probability == 2 / 5


def test_status_of_refined_runs(tmp_path):
    rough = [(n, 3.0 - 0.1 * n) for n in range(20)]
    folder = invented_campaign(tmp_path / "c", PUBLISHED, rough, [(0, 5.0), (1, 4.0), (2, 0.2)], every=10.0)
    refined = progress.progress_of(folder).grids[1]
    # k_t = 2: one stands, one more is needed at least.
    assert (refined.done, refined.planned, refined.at_least) == (3, 4, True)
    assert refined.hourly == pytest.approx(360)
    assert refined.seconds_left == pytest.approx(10)
    estimate = progress.progress_of(folder).estimate
    assert estimate.probability == 2 / 20
    assert estimate.method == "published n/N"


def test_status_counts_what_broke_off_and_names_what_is_damaged(tmp_path, capsys):
    folder = invented_campaign(tmp_path / "c", TWO_PHASE, [(0, -1.0), (1, 0.1), (2, 0.1)], [])
    spoil(folder, "rough", 2)
    assert main(["status", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert "1 broke off" in printed
    assert "sample 2 of the rough grid does not match its checksum" in printed
    assert finished(folder, "rough").keys() == {0, 1, 2}


def test_status_leaves_the_lock_alone_and_says_who_holds_it(tmp_path):
    with open_store(tmp_path / "c", TINY):
        assert progress.progress_of(tmp_path / "c").controller == f"process {os.getpid()} on {socket.gethostname()}"
    (tmp_path / "c" / ".lock").write_text(f"process 4194305 on {socket.gethostname()}")
    assert "has ended" in progress.progress_of(tmp_path / "c").controller
    (tmp_path / "c" / ".lock").write_text("process 7 on elsewhere")
    assert "cannot be seen from here" in progress.progress_of(tmp_path / "c").controller


def test_status_is_watched_until_the_campaign_ends(tmp_path, monkeypatch, capsys):
    folder, slept = invented_campaign(tmp_path / "c", TWO_PHASE, [(0, 0.1)], []), []

    def sleep(seconds):
        slept.append(seconds)
        if len(slept) == 2:
            (folder / ".lock").write_text(f"process 4194305 on {socket.gethostname()}")

    (folder / ".lock").write_text(f"process {os.getpid()} on {socket.gethostname()}")
    monkeypatch.setattr(progress.time, "sleep", sleep)
    assert main(["status", str(folder), "--watch", "0.5"]) == 0
    assert slept == [0.5, 0.5]
    printed = capsys.readouterr().out
    assert printed.count("1 of 20 samples") == 3
    assert printed.rstrip().count("has ended") == 1
    assert main(["status", str(folder), "--watch", "-1"]) == 2
    assert "--watch -1: give the seconds between two looks" in capsys.readouterr().err


def test_a_watcher_that_is_stopped_promises_nothing(tmp_path, monkeypatch, capsys):
    folder = invented_campaign(tmp_path / "c", TWO_PHASE, [(0, 0.1)], [])
    (folder / ".lock").write_text(f"process {os.getpid()} on {socket.gethostname()}")

    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(progress.time, "sleep", interrupted)
    assert main(["status", str(folder), "--watch"]) == 130
    assert capsys.readouterr().err == "\nstopped by SIGINT\n"


def test_a_pause_is_no_pace():
    ended = [0.0, 10.0, 20.0, 50_000.0, 50_010.0]
    assert progress.seconds_per_sample(ended, [10.0] * 5) == pytest.approx(10)
    assert np.isnan(progress.seconds_per_sample([1.0], [1.0]))


@pytest.mark.parametrize(("seconds", "text"), [(45, "45 s"), (720, "12 min"), (12_600, "3.5 h"), (260_000, "3 days")])
def test_durations_are_written_as_people_write_them(seconds, text):
    assert duration(seconds) == text


def test_export_writes_the_table_and_the_series(tiny_campaign, capsys):
    folder, _ = tiny_campaign
    assert main(["export", str(folder)]) == 0
    written = capsys.readouterr().out.split()
    refined = read_rows(read_store(folder), "refined").numbers
    assert f"{folder}/table.csv" in written
    assert len(written) == 1 + 6 + len(refined)
    sample = read_sample(read_store(folder), "refined", refined[0])
    times, steps = vtk_steps(folder / "series" / f"refined-{refined[0]:06d}.vtkhdf")
    assert times[0] == 0
    assert not steps[0][1]["displacement"].any()
    np.testing.assert_array_equal(steps[1][1]["displacement"][:, [0, 2]].T, sample.fields["displacement"])
    np.testing.assert_array_equal(steps[1][1]["plastic_strain"], sample.fields["plastic_strain"])
    assert steps[1][1]["strength"].std() > 0
    text = (folder / "README.txt").read_text()
    assert [path.name for path in folder.iterdir() if path.name not in text] == []


def test_export_runs_a_sample_again_for_its_moments(tiny_campaign, capsys):
    folder, _ = tiny_campaign
    assert main(["export", str(folder), "--sample", "2", "--grid", "rough", "--frames", "3"]) == 0
    path = capsys.readouterr().out.strip()
    stored = read_sample(read_store(folder), "rough", 2)
    model = runs.build(parse(TINY), "rough", runs.random_soil(parse(TINY)))
    times, steps = vtk_steps(path)
    np.testing.assert_allclose(times, np.linspace(0, stored.steps * float(model.scene.numerics.time_step), 3))
    # The same run, bit for bit.
    np.testing.assert_array_equal(steps[-1][1]["displacement"][:, [0, 2]].T, stored.fields["displacement"])
    assert {"velocity", "stress"} <= steps[0][1].keys()


def test_fields_that_were_not_stored_are_named(tiny_campaign, tmp_path, capsys):
    with open_store(tmp_path / "bare", TINY) as store:
        write_sample(store, "rough", replace(read_sample(read_store(tiny_campaign[0]), "rough", 1), fields={}))
    assert len(list(exports.export(tmp_path / "bare"))) == 1
    assert main(["export", str(tmp_path / "bare"), "--sample", "1", "--grid", "rough"]) == 2
    assert "[campaign] fields" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["status", "{nothing}"], "holds no campaign: give the folder of one"),
        (["resume", "{nothing}"], "holds no campaign: give the folder of one"),
        (["export", "{nothing}"], "holds no campaign: give the folder of one"),
        (["export", "{empty}"], "no finished sample yet: start the run first"),
        (["report", "{empty}"], "no finished sample yet: start the run first"),
        (["export", "{empty}", "--sample", "5"], "sample 5 is not finished on the refined grid: give one of none yet"),
        (["export", "{done}", "--frames", "3"], "give --sample too"),
        (["export", "{done}", "--sample", "1", "--grid", "rough", "--frames", "1"], "frames = 1: give 2 or more"),
    ],
)
def test_errors_are_one_line_and_exit_code_2(arguments, message, tiny_campaign, tmp_path, capsys):
    open_store(tmp_path / "empty", TINY).close()
    folders = {"nothing": tmp_path / "nothing", "empty": tmp_path / "empty", "done": tiny_campaign[0]}
    assert main([argument.format(**folders) for argument in arguments]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("error: ")
    assert message in printed
    assert printed.count("\n") == 1


def test_sweep_runs_its_campaigns(tmp_path, capsys, monkeypatch):
    asked = {}

    def run(scene, folder, *, workers, progress):
        asked.update(scene=scene, folder=folder, workers=workers, progress=progress)

    monkeypatch.setattr(sweep, "run", run)
    scene = tmp_path / "sweep.toml"
    scene.write_text(f"{TINY}\n[sweep]\ncov = [0.2, 0.4]\n")
    assert main(["sweep", str(scene), "--out", str(tmp_path / "out"), "--workers", "2"]) == 0
    assert asked == {"scene": read_scene(scene), "folder": tmp_path / "out", "workers": 2, "progress": True}
    assert "sweep.json" in capsys.readouterr().out
    monkeypatch.undo()
    scene.write_text("[sweep]\n")
    assert main(["sweep", str(scene), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_status_of_a_folder_without_samples(tmp_path, capsys):
    open_store(tmp_path / "c", TINY).close()
    assert main(["status", str(tmp_path / "c")]) == 0
    assert "no finished sample yet" in capsys.readouterr().out


POOR = """
import os, sys
from benchmarks.robustness import invented
from cooperative import campaign
from cooperative.__main__ import main
folder = sys.argv[1]
assert sys.stderr is None
assert main(["new", "--kind", "section", "--out", f"{folder}/new.toml"]) == 0
assert main(["example", "demo", "--out", f"{folder}/demo.toml"]) == 0
assert main(["check", f"{folder}/none.toml"]) == 2
assert os.open(os.devnull, os.O_RDONLY) > 2
invented.invent()
scene = invented.SCENE.replace('"tiny"', '"B\\u00f6schung"').replace("samples = 50", "samples = 20")
campaign.run(scene, f"{folder}/out", progress=True)
assert main(["status", f"{folder}/out"]) == 0
"""


def test_commands_work_in_an_ascii_locale_with_stderr_closed(tmp_path):
    environment = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    # The shell closes stderr, as a service or a scheduler may.
    command = ["sh", "-c", 'exec "$@" 2>&-', "sh", sys.executable, "-c", POOR, str(tmp_path)]
    environment["PYTHONIOENCODING"] = "ascii"
    done = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE)
    assert done.returncode == 0, done.stdout
    printed = done.stdout.decode("ascii")
    assert "\nB\\xf6schung" in printed
    assert "20 of 20 samples" in printed
    assert (tmp_path / "new.toml").read_text(encoding="utf-8").startswith("#:schema")
    assert (tmp_path / "out" / "progress.log").read_text(encoding="utf-8").endswith("done\n")


def test_every_text_file_that_a_package_opens_has_an_encoding():
    without = []
    for package in ("jaxmpm", "kl", "cooperative"):
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                name = getattr(node.func, "attr", getattr(node.func, "id", "")) if isinstance(node, ast.Call) else ""
                if name in ("read_text", "write_text") or (name == "open" and isinstance(node.func, ast.Name)):
                    words = {keyword.arg for keyword in node.keywords}
                    binary = any(isinstance(each, ast.Constant) and "b" in str(each.value) for each in node.args[1:])
                    without += [] if "encoding" in words or binary else [f"{path}:{node.lineno}"]
    assert without == []


@pytest.mark.parametrize(
    "arguments", [["--help"], ["check", "--help"], ["--version"], ["run"], ["new"], ["example", "demo"]]
)
def test_what_computes_nothing_loads_no_jax(arguments, tmp_path):
    script = """if True:
        import contextlib, sys
        from cooperative.__main__ import main
        with contextlib.suppress(SystemExit):
            main(sys.argv[1:])
        print("jax" in sys.modules, "numpy" in sys.modules)
    """
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout.splitlines()[-1] == "False False"


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("arguments", [["new"], ["example", "demo"], ["status", "none"]], ids=" ".join)
def test_a_command_whose_reader_leaves_ends_without_a_word(arguments, unbuffered, tmp_path):
    """As `head` leaves; a shell shows 141 for a program that SIGPIPE ended. Errors go to the closed pipe as well."""
    command, environment = [sys.executable, "-m", "cooperative", *arguments], os.environ | {"PYTHONPATH": str(ROOT)}
    read, write = os.pipe()
    os.close(read)
    errors = write if arguments[0] == "status" else subprocess.PIPE
    with open(write, "wb"):
        done = subprocess.run(
            command, cwd=tmp_path, env=environment | {"PYTHONUNBUFFERED": unbuffered}, stdout=write, stderr=errors
        )
    assert done.returncode == 141
    assert not done.stderr


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_command_says_at_a_terminal_that_it_loads_and_leaves_the_collector_as_it_was(tmp_path, monkeypatch, capsys):
    missing = ["check", str(tmp_path / "none.toml")]
    assert main(missing) == 2
    assert capsys.readouterr().err.startswith("error: there is no scene")
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert main(missing) == 2
    said = sys.stderr.getvalue().splitlines()
    assert said[0] == "jaxmpm check: loading ..."
    assert said[1].startswith("error: there is no scene")
    assert gc.isenabled()
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert main(["new", "--out", str(tmp_path / "new.toml")]) == 0
    assert sys.stderr.getvalue() == ""
