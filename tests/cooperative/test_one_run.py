"""One slide: the soil that it is, what it says, and its files; a scene in which nothing is random."""

import os

import numpy as np
import pytest

from cooperative import runs
from cooperative.__main__ import main
from cooperative.one_run import animation_path, lines, slide, write_slide
from cooperative.scene import parse

PLAIN = """
[slope]
crest = 8.0
height = 8.0
run_per_rise = 1.0
toe = 16.0
foundation = 2.0
[soil]
strength = 40e3
unit_weight = 20e3
young = 2e7
poisson = 0.3
softening_modulus = 85e3
softening_length = "cell"
[rough]
cell = 2.0
spacing = [1.0, 1.0]
[refined]
cell = 2.0
spacing = [1.0, 1.0]
[run]
t_end = 4.0
failure_displacement = 0.5
[campaign]
samples = 10
seed = 3
k_t = 2
"""
RANDOM = PLAIN.replace("strength = 40e3\n", "") + "[strength]\nmean = 40e3\ncov = 0.3\nlength = [20.0, 2.0]\n"


@pytest.fixture(scope="module")
def fails():
    return slide(parse(PLAIN), divide=3.0)


def test_soil_that_is_not_random_stands_and_with_less_strength_slides(fails):
    stands = slide(parse(PLAIN))
    assert stands.stands
    assert stands.failed is None
    assert "it stands" in "\n".join(lines(stands))
    assert not fails.stands
    assert fails.row["displacement"] > fails.failure_displacement
    assert 0 < fails.failed < fails.row["time"]
    assert f"it slides {fails.row['displacement']:.3g} m" in "\n".join(lines(fails))
    assert fails.times[0] == 0
    assert list(fails.times) == sorted(fails.times)
    assert len(fails.times) == len(fails.states)


def test_run_out_counts_from_a_toe_only_where_there_is_one(fails):
    assert "m beyond the toe, where 0.8 m is left; volume" in "\n".join(lines(fails))
    outline = "[ground]\nsurface = [[0, 10], [8, 10], [16, 2], [32, 2]]\n"
    begin, end = PLAIN.index("[slope]"), PLAIN.index("[soil]")
    free = slide(parse(PLAIN[:begin] + outline + PLAIN[end:]), divide=3.0, frames=2)
    assert "m from its rear to its front, where 0.8 m is left; volume" in "\n".join(lines(free))


def test_a_sample_is_that_of_the_campaign():
    campaign = parse(RANDOM)
    soil = runs.random_soil(campaign)
    model = runs.build(campaign, "refined", soil)
    coefficients = runs.coefficients_of(campaign, soil)
    (same,) = runs.run_samples(model, coefficients, [2])
    one = slide(campaign, 2)
    for name in ("displacement", "volume", "time"):
        assert one.row[name] == same.row[name]


def test_mean_soil_has_the_mean_and_median_soil_the_median():
    campaign = parse(RANDOM)
    of = {mean: slide(campaign, mean=mean, frames=2).scene.material.strength for mean in (True, False)}
    np.testing.assert_allclose(of[True], 40e3, rtol=1e-5)
    np.testing.assert_allclose(of[False], 40e3 / np.sqrt(1.09), rtol=1e-5)


@pytest.mark.parametrize(
    ("scene", "options", "message"),
    [
        (PLAIN, {"sample": 0}, "nothing in the scene is random"),
        (RANDOM, {"sample": 10}, "the scene has samples 0 to 9"),
        (RANDOM, {"sample": 1, "mean": True}, "mean soil is that of no sample"),
        (PLAIN, {"divide": 0.0}, "divide = 0: give a finite value above 0"),
        (PLAIN, {"frames": 1}, "frames = 1: give a whole number of 2 or more"),
    ],
)
def test_what_does_not_fit_is_refused(scene, options, message):
    with pytest.raises(ValueError, match=message):
        slide(parse(scene), **options)


@pytest.fixture
def encoder(tmp_path, monkeypatch):
    """An ffmpeg that counts what it is fed, writes that to its last argument, and ends with a status."""
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()

    def made(status=0):
        program.write_text(f'#!/bin/sh\nfor last; do :; done\nwc -c > "$last"\nexit {status}\n')
        program.chmod(0o755)
        monkeypatch.setenv("PATH", str(program.parent), prepend=os.pathsep)

    return made


def test_an_animation_is_an_mp4_where_ffmpeg_is_found_and_else_a_gif(tmp_path, monkeypatch, encoder):
    monkeypatch.setenv("PATH", str(tmp_path / "none"))
    assert animation_path(tmp_path) == tmp_path / "slide.gif"
    assert animation_path(tmp_path, tmp_path / "mine.gif") == tmp_path / "mine.gif"
    with pytest.raises(ValueError, match=r"mine.mp4: an MP4 is written by ffmpeg, which is not found: .*mine.gif"):
        animation_path(tmp_path, tmp_path / "mine.mp4")
    encoder()
    assert animation_path(tmp_path) == tmp_path / "slide.mp4"
    with pytest.raises(ValueError, match=r"mine.avi is no name of an animation: give one that ends in .mp4 or .gif"):
        animation_path(tmp_path, tmp_path / "mine.avi")
    with pytest.raises(ValueError, match="there is no folder"):
        animation_path(tmp_path, tmp_path / "none" / "mine.gif")


def test_an_mp4_gets_every_picture_and_a_failing_ffmpeg_is_named(fails, tmp_path, encoder):
    encoder()
    *_, path = write_slide(fails, tmp_path / "a", animation=tmp_path / "mine.mp4")
    assert path == tmp_path / "mine.mp4"
    assert int(path.read_text()) % (4 * len(fails.states)) == 0
    assert int(path.read_text()) > 1e5 * len(fails.states)
    encoder(status=3)
    with pytest.raises(OSError, match=r"mine.mp4: ffmpeg ends with status 3, give a GIF"):
        list(write_slide(fails, tmp_path / "b", animation=tmp_path / "mine.mp4"))


def test_the_command_writes_pictures_and_a_series(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    scene = tmp_path / "plain.toml"
    scene.write_text(PLAIN)
    assert main(["slide", str(scene), "--divide", "3", "--frames", "5", "--vtk"]) == 0
    printed = capsys.readouterr().out
    assert "it fails" in printed
    folder = tmp_path / "plain-slide"
    assert sorted(path.name for path in folder.iterdir()) == ["profile.png", "slide.gif", "slide.png", "slide.vtkhdf"]
    assert (folder / "slide.gif").read_bytes().startswith(b"GIF89a")
