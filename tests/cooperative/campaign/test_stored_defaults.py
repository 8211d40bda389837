"""A default may change: campaigns begun before go on as they were, new ones follow, and their folders say which."""

import numpy as np
import pytest

from benchmarks.robustness.invented import LAYERED
from cooperative import campaign, sweep
from cooperative.scene import built, campaign_of, parse, settled
from cooperative.store import FIRST_DEFAULTS, open_store, read_store, scene_digest
from tests.cooperative.campaign.test_campaign import TINY
from tests.cooperative.scene.test_mixed_scenes import MIXED
from tests.cooperative.scene.test_random_soil import SAND


def steps(text):
    return {grid: shape.cfl for grid, shape in parse(text).grids.items()}


def test_a_new_scene_has_todays_default_and_its_own_word():
    assert steps(TINY) == {"rough": 0.9, "refined": 0.9}
    assert steps(TINY.replace("[rough]", "[rough]\ncfl = 0.3")) == {"rough": 0.3, "refined": 0.9}
    assert steps(TINY.replace("[rough]", "[rough]\ncfl = 0.3") + FIRST_DEFAULTS) == {"rough": 0.3, "refined": 0.5}


def test_a_folder_begun_before_goes_on_with_the_default_of_its_time(tmp_path):
    (tmp_path / "samples").mkdir()
    (tmp_path / "scene.toml").write_text(TINY)
    store = read_store(tmp_path)
    assert {shape.cfl for shape in campaign_of(store).grids.values()} == {0.5}
    assert (campaign_of(store).plan.valley, parse(TINY).plan.valley) == (0.05, 0.5)
    assert store.digest == scene_digest(TINY)
    source = settled(TINY, tmp_path)
    assert set(steps(source).values()) == {0.5}
    with open_store(tmp_path, source) as held:
        assert held.digest == scene_digest(TINY)
    assert (tmp_path / "scene.toml").read_text() == TINY


def test_a_folder_begun_with_a_step_that_is_refused_now_still_opens(tmp_path):
    for name, cfl in (("first", 0.5), ("later", 0.9)):
        (tmp_path / name / "samples").mkdir(parents=True)
        defaults = "" if name == "first" else "\n[defaults]\ncfl = 0.9\n"
        (tmp_path / name / "scene.toml").write_text(TINY.replace("[rough]", '[rough]\nscheme = "usl"') + defaults)
        assert campaign_of(read_store(tmp_path / name)).rough.cfl == cfl


def test_a_folder_keeps_the_default_that_it_was_begun_with(tmp_path):
    source = settled(TINY, tmp_path)
    today = {"cfl": 0.9, "gap_memory": True, "valley": 0.5, "early": True, "order": "stencil"}
    today |= {"gap_average": True, "fbar": False}
    assert source.beside == {"defaults": today}
    with open_store(tmp_path, source) as store:
        assert store.digest == scene_digest(
            TINY
            + "[defaults]\ncfl = 0.9\ngap_memory = true\nvalley = 0.5\nearly = true\norder = 'stencil'\n"
            + "gap_average = true\nfbar = false\n"
        )
    assert (tmp_path / "scene.toml").read_text() == TINY
    stored = (tmp_path / "campaign.json").read_text()
    (tmp_path / "campaign.json").write_text(stored.replace("0.9", "0.7"))
    assert settled(TINY, tmp_path).beside["defaults"]["cfl"] == 0.7
    assert settled(source, tmp_path) == source
    with pytest.raises(ValueError, match=r"defaults.cfl is 0.7 there and 0.9 now"):
        open_store(tmp_path, source)


def test_a_folder_that_was_killed_as_it_began_is_begun_anew(tmp_path):
    for content in ('{"defaults": {"cfl": 0.7, "gap_memory": true}}', '{"defaults": {"cfl": 0.7}, "files": {}}'):
        (tmp_path / "campaign.json").write_text(content)
        assert settled(TINY, tmp_path).beside["defaults"]["cfl"] == 0.9
        with pytest.raises(ValueError, match="holds no campaign"):
            read_store(tmp_path)
    with open_store(tmp_path, TINY) as store:
        assert store.digest == scene_digest(TINY)
    assert set(steps(read_store(tmp_path).source).values()) == {0.5}


@pytest.mark.parametrize("content", ["[1.0", "[]", "\x00", "[" * 100_000])
def test_a_damaged_file_beside_a_scene_is_named(tmp_path, content):
    with open_store(tmp_path, settled(TINY, tmp_path)):
        pass
    (tmp_path / "campaign.json").write_text(content)
    for opened in (lambda: read_store(tmp_path), lambda: campaign.run(TINY, tmp_path)):
        with pytest.raises(ValueError, match=r"campaign\.json is damaged .*put back the file"):
            opened()


def remembers(text):
    """Whether each of the soils of a scene remembers its gap, that of its layers too."""
    campaign = parse(text)
    return {layer.soil.gap_memory for layer in campaign.site.soils(campaign.soil)} | {campaign.soil.gap_memory}


@pytest.mark.parametrize("scene", [TINY, LAYERED])
def test_a_folder_that_is_older_than_a_default_goes_on_without_it(scene, tmp_path):
    # The version before had the time step of today, and a cutoff that forgets.
    stored = scene + "\n[defaults]\ncfl = 0.9\n"
    (tmp_path / "scene.toml").write_text(stored)
    assert remembers(scene) == {True}
    assert remembers(settled(scene, tmp_path)) == remembers(stored) == {False}
    assert remembers(scene + FIRST_DEFAULTS) == {False}
    assert set(steps(settled(scene, tmp_path)).values()) == {0.9}
    with open_store(tmp_path, settled(scene, tmp_path)) as held:
        assert held.digest == scene_digest(stored)
    own = LAYERED.replace("tension_cutoff = 0.0", "tension_cutoff = 0.0\ngap_memory = true")
    assert remembers(own + "\n[defaults]\ncfl = 0.9\n") == {True}


def ends_early(asked):
    """Whether runs of which only the class is asked for end early."""
    return parse(asked).settles(stop_at=1.0).early is not None


def test_runs_of_folders_that_are_older_than_early_classes_do_not_end_early(tmp_path):
    (tmp_path / "scene.toml").write_text(TINY + "\n[defaults]\ncfl = 0.9\ngap_memory = true\n")
    assert ends_early(TINY)
    assert ends_early(settled(TINY, tmp_path / "new"))
    assert not ends_early(settled(TINY, tmp_path))
    assert not ends_early(TINY.replace("[run]", "[run]\nearly = false"))
    assert ends_early(settled(TINY.replace("[run]", "[run]\nearly = true"), tmp_path))


def test_particles_of_older_folders_keep_their_order(tmp_path):
    (tmp_path / "scene.toml").write_text(TINY + "\n[defaults]\ncfl = 0.9\ngap_memory = true\n")
    (new, _), (old, _) = (
        built(parse(settled(TINY, folder)), "rough", at_rest=False) for folder in (tmp_path / "new", tmp_path)
    )
    cells = np.asarray((old.particles.position - np.array(old.grid.origin)[:, None]) / old.grid.cell)
    assert (np.lexsort(np.floor(cells)[::-1]) == np.arange(cells.shape[1])).all()
    assert not (np.asarray(new.particles.position) == np.asarray(old.particles.position)).all()


def test_gaps_of_older_folders_stay_with_their_particles(tmp_path):
    (tmp_path / "scene.toml").write_text(SAND + "\n[defaults]\ncfl = 0.9\ngap_memory = true\n")
    (new, _), (old, _) = (
        built(parse(settled(SAND, folder)), "rough", at_rest=False) for folder in (tmp_path / "new", tmp_path)
    )
    assert (new.cell_average, new.gap_average) == (True, True)
    assert (old.cell_average, old.gap_average) == (True, False)


def cures(text):
    """Whether the average over cells and F-bar, of the rough grid as it is built."""
    scene, _ = built(parse(text), "rough", at_rest=False)
    return scene.cell_average, scene.fbar


@pytest.mark.parametrize(
    ("scene", "new", "old"),
    [
        (TINY, (True, False), (False, True)),
        (TINY.replace("[rough]", "[rough]\ncell_average = true"), (True, False), (True, False)),
        (TINY.replace("[rough]", "[rough]\nfbar = true"), (False, True), (False, True)),
        (TINY.replace("[rough]", "[rough]\nfbar = false"), (False, False), (False, False)),
        (TINY.replace("[rough]", "[rough]\ncell_average = false"), (False, False), (False, True)),
        (SAND, (True, False), (True, False)),
        (LAYERED, (True, False), (False, True)),
        (MIXED, (True, False), (True, False)),
    ],
)
def test_grids_of_older_folders_keep_their_cure_of_locking(scene, new, old, tmp_path):
    before = "\n[defaults]\ncfl = 0.9\ngap_memory = true\norder = 'stencil'\ngap_average = true\n"
    (tmp_path / "scene.toml").write_text(scene + before)
    assert cures(settled(scene, tmp_path)) == old
    assert cures(settled(scene, tmp_path / "new")) == cures(scene) == new


class _Looked(Exception):
    pass


def test_campaigns_and_sweeps_look_in_their_folders(tmp_path, monkeypatch):
    seen = []

    def look(asked, *_):
        seen.append({shape.cfl for shape in asked.grids.values()})
        raise _Looked

    monkeypatch.setattr(campaign.runs, "check_size", look)
    monkeypatch.setattr(sweep, "check_size", look)
    swept = TINY + "[sweep]\ncov = [0.2]\n"
    for begin, name, inside, text in (
        (campaign.run, "scene.toml", "samples", TINY), (sweep.run, "sweep.toml", "campaigns", swept)
    ):  # fmt: skip
        for made in ("nothing", "its text", "its text and results"):
            folder = tmp_path / f"{name}, {made}"
            folder.mkdir()
            if made != "nothing":
                (folder / name).write_text(text)
            if "results" in made:
                (folder / inside).mkdir()
            with pytest.raises(_Looked):
                begin(text, folder)
    # A scene alone was put there by its author, and has today's defaults.
    assert seen == 2 * [{0.9}, {0.9}, {0.5}]


@pytest.mark.parametrize(
    ("table", "match"),
    [
        ("cfl = 'fast'", "cfl = 'fast' is text"),
        ("cfl = 0.9\nstep = 1.0", "unknown key 'step'"),
        ("", "lacks cfl"),
        ("cfl = ", "not valid TOML"),
    ],
)
def test_other_defaults_in_a_folder_are_named(tmp_path, table, match):
    (tmp_path / "scene.toml").write_text(f"{TINY}\n[defaults]\n{table}\n")
    with pytest.raises(ValueError, match=match):
        campaign.run(TINY, tmp_path)
