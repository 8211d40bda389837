"""Settings of JAX under which campaigns cannot run, and devices that are not there: it runs, or names them."""

import os
import subprocess
import sys
import warnings

import jax
import pytest

from cooperative import run
from cooperative.__main__ import main
from cooperative.runs import _flags
from tests.cooperative.campaign.test_campaign import TINY

SHORT = TINY.replace("t_end = 4.0", "t_end = 0.1").replace("samples = 6", "samples = 2").replace("k_t = 2", "k_t = 1")
FLAGS = {
    "jax_numpy_rank_promotion": "raise",
    "jax_numpy_dtype_promotion": "strict",
    "jax_disable_jit": True,
    "jax_enable_checks": True,
    "jax_transfer_guard": "disallow",
}


@pytest.fixture
def flag():
    """Sets a flag of JAX until the test ends."""
    before = {name: getattr(jax.config, name) for name in FLAGS}
    yield jax.config.update
    for name, value in before.items():
        jax.config.update(name, value)


@pytest.mark.parametrize("name", FLAGS)
def test_a_script_is_told_which_flag_no_campaign_runs_with(tmp_path, flag, name):
    flag(name, FLAGS[name])
    with pytest.raises(
        ValueError, match=rf"{name.upper()} = {FLAGS[name]}, with which .* do not run: .*config\.update"
    ):
        run(SHORT, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("unrendered")
def test_a_command_runs_whatever_flags_its_environment_has(tmp_path, flag, capsys):
    (tmp_path / "short.toml").write_text(SHORT)
    for name, value in FLAGS.items():
        flag(name, value)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        assert main(["run", str(tmp_path / "short.toml"), "--out", str(tmp_path / "out"), "--workers", "1"]) == 0
    assert "probability of failure" in capsys.readouterr().out
    said = [str(each.message) for each in warned]
    for name, value in FLAGS.items():
        assert any(f"{name.upper()} = {value} has no effect here" in each for each in said)
    assert _flags.unusable_flags() == {}


@pytest.mark.parametrize("error", [AssertionError(), RuntimeError("Unable to initialize backend 'cuda'")])
def test_a_device_that_is_not_there_is_named(tmp_path, monkeypatch, capsys, error):
    def nothing(*_, **__):
        raise error

    monkeypatch.setattr(_flags.jax, "devices", nothing)
    monkeypatch.setattr(jax, "default_backend", nothing)
    monkeypatch.setattr("cooperative.campaign.run", nothing)
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    (tmp_path / "short.toml").write_text(SHORT)
    with pytest.warns(UserWarning, match="a slide may reach the end of the ground"):
        assert main(["run", str(tmp_path / "short.toml"), "--out", str(tmp_path / "out")]) == 2
    assert "error: JAX has no device on JAX_PLATFORMS = cuda" in capsys.readouterr().err
    assert main(["doctor"]) == 2
    assert "self-check:        NOT RUN: there is no device" in capsys.readouterr().out


@pytest.mark.slow
def test_the_doctor_speaks_without_a_device():
    environment = {**os.environ, "JAX_PLATFORMS": "cuda"}
    done = subprocess.run(
        [sys.executable, "-m", "cooperative", "doctor"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "device:            none. JAX has no device on JAX_PLATFORMS = cuda" in done.stdout
    assert "Traceback" not in done.stderr
