"""Restart points: a long run that was stopped or killed ends as if nothing had happened, bit for bit."""

from dataclasses import dataclass, replace

import h5py
import numpy as np
import pytest

from cooperative import runs
from cooperative.runs import Stopped, run_samples
from cooperative.store import SLIDES, Source, open_store, restart_path, write_sample
from jaxmpm import Status, solve, with_soil
from jaxmpm.run import Rule
from tests.cooperative.campaign.test_campaign import TINY, changed
from tests.scenes import model_of

OFTEN = changed("k_t = 2", "k_t = 2\nrestart_every = 1e-6")


class Broken(Exception):
    """Of a run that a test breaks off."""


def model_and_coefficients(text):
    model = model_of(text, "refined", at_rest=True)
    return model, runs.coefficients_of(model.campaign, model.soil)


def stop_after(chunks):
    seen = []

    def on_chunk(_):
        seen.append(None)
        if len(seen) > chunks:
            raise Broken

    return on_chunk, seen


def assert_same_sample(first, second):
    assert (first.number, first.status, first.steps) == (second.number, second.status, second.steps)
    assert dict(first.row) == dict(second.row)
    assert first.fields.keys() == second.fields.keys()
    for name, values in first.fields.items():
        assert values.tobytes() == second.fields[name].tobytes()


@pytest.fixture
def folder(tmp_path):
    """A campaign's folder, for restart points."""
    open_store(tmp_path / "campaign", OFTEN).close()
    return tmp_path / "campaign"


@pytest.fixture(scope="module")
def undisturbed():
    """Refined runs of all samples without any restart point; first one that slides, then one that settles."""
    model, coefficients = model_and_coefficients(OFTEN)
    samples = {s.number: s for s in runs.run_samples(model, coefficients, range(6), width=1)}
    slides = next(n for n, s in samples.items() if s.row["displacement"] > 1)
    stands = next(n for n, s in samples.items() if s.status == "SETTLED" and s.row["displacement"] < 1)
    return model, coefficients, {n: samples[n] for n in (slides, stands, *sorted(samples.keys() - {slides, stands}))}


def test_failures_leave_frames_that_a_run_for_them_alone_gives_too(undisturbed):
    model, _, samples = undisturbed
    limit = model.campaign.run.failure_displacement
    for sample in samples.values():
        far = sample.row["displacement"]
        assert ("frames" in sample.fields) == (far > limit)
        if far > limit:
            frames, times = sample.fields["frames"], sample.fields["frame_times"]
            assert frames.dtype == np.float16
            assert len(times) == 1 + (far > 5 * limit)
            states = solve(
                *with_soil(model.scene, model.state, strength=model.strength(sample.coefficients)),
                t_end=float(times[-1]), snapshots=times.tolist(),
            ).snapshots  # fmt: skip
            alone = np.stack([np.asarray(state.displacement) for state in states])
            np.testing.assert_array_equal(frames, alone.astype(np.float16))
            reached = np.linalg.norm(alone, axis=1).max(axis=1)
            assert (reached > np.array([1, 5])[: len(times)] * limit).all()


def test_frames_are_stored_only_where_fields_are(undisturbed):
    model, coefficients, samples = undisturbed
    number = next(iter(samples))
    bare = replace(model, campaign=replace(model.campaign, plan=replace(model.campaign.plan, fields=())))
    (sample,) = run_samples(bare, coefficients, [number], width=1)
    assert sample.fields.keys() == {"slice_depth"}
    assert dict(sample.row) == dict(samples[number].row)


@pytest.mark.parametrize("which", [0, 1], ids=["slides", "settles"])
def test_an_interrupted_run_ends_as_the_undisturbed_one(which, undisturbed, folder):
    model, coefficients, samples = undisturbed
    number = list(samples)[which]
    whole, all_chunks = stop_after(10_000)
    list(runs.run_samples(model, coefficients, [number], width=1, on_chunk=whole))
    done = 0
    # Stopped twice, each time after going on from the restart point before.
    for chunks in (len(all_chunks) // 3, len(all_chunks) // 4):
        on_chunk, _ = stop_after(chunks)
        with pytest.raises(Broken):
            list(runs.run_samples(model, coefficients, [number], width=1, on_chunk=on_chunk, restart_in=folder))
        point = restart_path(folder, "refined", number)
        assert point.exists()
        done += chunks
    with h5py.File(point) as file:
        assert ("frames" in file["about"]) == (which == 0)
    on_chunk, left = stop_after(10_000)
    (again,) = runs.run_samples(model, coefficients, [number], width=1, on_chunk=on_chunk, restart_in=folder)
    assert len(left) == len(all_chunks) - done
    assert_same_sample(again, samples[number])


def test_lanes_go_on_from_restart_points_beside_fresh_ones(undisturbed, folder):
    model, coefficients, samples = undisturbed
    first, second, *_ = samples
    on_chunk, _ = stop_after(3)
    with pytest.raises(Broken):
        list(runs.run_samples(model, coefficients, [second], width=1, on_chunk=on_chunk, restart_in=folder))
    for width in (1, 2):
        again = runs.run_samples(model, coefficients, [first, second], width=width, restart_in=folder)
        for sample in again:
            assert_same_sample(sample, samples[sample.number])


def test_a_campaign_that_was_written_in_python_has_restart_points(tmp_path):
    model, coefficients = model_and_coefficients(OFTEN)
    folder = tmp_path / "written"
    open_store(folder, Source(None, {"campaign": {"name": "written"}})).close()
    on_chunk, _ = stop_after(1)
    with pytest.raises(Broken):
        list(runs.run_samples(model, coefficients, [0], width=1, on_chunk=on_chunk, restart_in=folder))
    assert restart_path(folder, "refined", 0).exists()


def test_short_runs_write_none(folder):
    model, coefficients = model_and_coefficients(TINY)
    list(runs.run_samples(model, coefficients, [0], width=1, restart_in=folder))
    assert not (folder / "restart").exists()


def test_a_folder_that_a_worker_does_not_see_is_run_without(undisturbed, tmp_path):
    model, coefficients, samples = undisturbed
    number = next(iter(samples))
    (alone,) = runs.run_samples(model, coefficients, [number], width=1, restart_in=tmp_path / "elsewhere")
    assert_same_sample(alone, samples[number])
    assert list(tmp_path.iterdir()) == []


def test_damaged_and_foreign_restart_points_are_named_and_the_run_starts_afresh(undisturbed, folder):
    model, coefficients, samples = undisturbed
    number = next(iter(samples))
    on_chunk, _ = stop_after(3)
    with pytest.raises(Broken):
        list(runs.run_samples(model, coefficients, [number], width=1, on_chunk=on_chunk, restart_in=folder))
    path = restart_path(folder, "refined", number)
    whole = path.read_bytes()
    other = next(n for n in samples if n != number)
    for content, at, reason in (
        (whole[:-7], number, "does not match its checksum"),
        (whole, other, "another scene or sample"),
    ):
        path.unlink(missing_ok=True)
        there = restart_path(folder, "refined", at)
        there.write_bytes(content)
        with pytest.warns(UserWarning, match=rf"{there.name} .*{reason}.*starts afresh"):
            (again,) = runs.run_samples(model, coefficients, [at], width=1, restart_in=folder)
        assert_same_sample(again, samples[at])
        assert there.with_name(there.name + ".damaged").read_bytes() == content


def test_a_finished_sample_has_no_restart_point(undisturbed, tmp_path):
    _, _, samples = undisturbed
    sample = next(iter(samples.values()))
    with open_store(tmp_path / "c", OFTEN) as store:
        path = restart_path(store.folder, "refined", sample.number)
        path.parent.mkdir()
        path.write_bytes(b"")
        write_sample(store, "refined", sample)
        assert not path.exists()


def test_a_run_asked_to_stop_writes_its_restart_point_and_goes_on_from_it(undisturbed, folder):
    _, coefficients, samples = undisturbed
    number = next(iter(samples))
    # Restart points are due after ten minutes: only the stop makes one.
    model, _ = model_and_coefficients(TINY)
    asked = iter([False] * 4)
    with pytest.raises(Stopped):
        list(run_samples(model, coefficients, [number], width=1, restart_in=folder, stop=lambda: next(asked, True)))
    assert restart_path(folder, "refined", number).exists()
    on_chunk, left = stop_after(10_000)
    (again,) = run_samples(model, coefficients, [number], width=1, on_chunk=on_chunk, restart_in=folder)
    assert_same_sample(again, samples[number])
    on_chunk, whole = stop_after(10_000)
    list(run_samples(model, coefficients, [number], width=1, on_chunk=on_chunk))
    assert 0 < len(left) < len(whole)


def test_a_stop_begins_no_further_sample_and_loses_none_that_ended(undisturbed):
    model, coefficients, samples = undisturbed
    ended = []
    runs = run_samples(model, coefficients, iter(range(6)), width=2, stop=lambda: bool(ended))
    ended.append(next(runs))
    with pytest.raises(Stopped):
        ended += runs
    assert 1 <= len(ended) <= 2
    for sample in ended:
        assert_same_sample(sample, samples[sample.number])


@dataclass(frozen=True)
class AtOnce(Rule):
    """A rule that decides a run at its first look, and says how far it would move (m)."""

    would_move: float

    def measure(self, scene, state):
        return state.step

    def judge(self, memory, reading):
        return memory, np.where(reading.measured > 0, Status.DECIDED, Status.RUNNING)

    def foreseen(self, displacement, time):
        assert 0 <= displacement < 1 < 10 * time
        return self.would_move


@pytest.mark.parametrize("would_move", [0.0, 5.0])
def test_a_rule_says_itself_how_a_run_counts_that_it_ends(folder, undisturbed, would_move):
    model, coefficients, samples = undisturbed
    _, stands, *_ = samples
    rules = [AtOnce(would_move), *model.campaign.rules(1.0)]
    (ended,) = run_samples(model, coefficients, [stands], width=1, rules=rules, restart_in=folder)
    assert (ended.status, ended.row["displacement"], ended.row["broke_off"]) == ("DECIDED", would_move, False)
    # Only a run that counts as a failure may be asked to slide on.
    assert restart_path(folder, SLIDES, stands).exists() == (would_move > model.campaign.run.failure_displacement)
