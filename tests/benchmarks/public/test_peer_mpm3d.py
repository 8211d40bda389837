"""This solver beside MPM3D-F90, by positions that it printed once: mpm3d_positions.csv."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import jaxmpm as mpm
from benchmarks.measure import Refused
from benchmarks.public import peer_mpm3d
from benchmarks.public.peer_mpm3d import Case

SHAPE = mpm.Slope(crest=8.0, height=8.0, run_per_rise=1.0, toe=16.0, foundation=4.0)
CASES = [
    Case("GIMP", mpm.Scheme.MUSL, "J2", SHAPE, times=(2.0,)),
    Case("linear", mpm.Scheme.USF, "c-phi", SHAPE, times=(2.0,)),
]
STORED = np.loadtxt(Path(__file__).with_name("mpm3d_positions.csv"), delimiter=",", skiprows=1).T


def test_positions_are_those_of_the_published_solver():
    row = peer_mpm3d.compared(CASES[0], STORED[None, :2])
    assert row["largest_m"][0] < 2e-9  # stored to nine decimals
    assert 1e-4 < row["own_floor_m"][0] < 1e-2  # GIMP reaches nodes that the published solver takes as empty


def test_positions_are_those_of_the_published_solver_with_hat_functions_and_friction():
    assert np.abs(peer_mpm3d.ours(CASES[1]) - STORED[2:]).max() < 2e-9


@pytest.mark.parametrize(
    ("stress", "mean", "shear"),
    [
        ((0.0, 1000.0), 0.0, 1000.0),  # inside: only the tension goes
        ((-100.0, 5e4), -100.0, 21e3),  # under pressure back to the strength
        ((1000.0, 5e4), 1000.0, 21e3),  # beyond the corner the tension stays
    ],
)
def test_soil_without_friction_returns_as_published(stress, mean, shear):
    pressure, q = stress
    law = peer_mpm3d.PublishedCone(*(jnp.asarray(number) for number in (1e8, 4e7, 0.0, 21e3, 0.0)))
    zero = (0.0,) * 6
    (xx, yy, zz, xy, *_), _ = law.update(zero, (pressure, pressure, pressure, q, 0.0, 0.0), None)
    assert (xx + yy + zz) / 3 == pytest.approx(mean, abs=1e-2)
    assert xy == pytest.approx(shear)


def test_the_input_holds_the_slice_with_a_cell_beyond_its_walls():
    lines = peer_mpm3d.deck(CASES[0]).splitlines()
    assert "spx -2 34" in lines
    assert "spy -2 4" in lines
    assert "gimp" in lines
    first = lines.index("particle point 1 440") + 1
    assert lines[first].split() == ["1", "1", "2000", "0.5", "0.5", "0.5"]
    assert all(len(word) <= 20 for line in lines[1:] for word in line.split())  # what the solver reads of a word


def test_a_program_that_is_missing_fails_or_rounds_is_refused(tmp_path):
    with pytest.raises(ValueError, match="give --binary PATH"):
        peer_mpm3d.run(quick=True)
    with pytest.raises(ValueError, match="is no program: give the one"):
        peer_mpm3d.theirs(CASES[0], tmp_path / "none")
    broken = tmp_path / "broken"
    broken.write_text("#!/bin/sh\necho material\nexit 3\n")
    with pytest.raises(Refused, match="is no program: give the one"):
        peer_mpm3d.theirs(CASES[0], broken)
    broken.chmod(0o755)
    with pytest.raises(ValueError, match="ended with 3 on GIMP, MUSL, J2: material"):
        peer_mpm3d.theirs(CASES[0], broken)
    with pytest.raises(ValueError, match="too few digits"):
        peer_mpm3d.pictures('ZONE T="time 0.2E+01"\n  0.5040E+00  0.5000E+00  0.4941E+00\n')


def test_a_slide_that_ends_in_no_time_is_compared_before(tmp_path, monkeypatch):
    def gives(pictures, then=""):
        zones = "".join("ZONE\\n" + row * count for count in pictures)
        program.write_text(f"#!/bin/sh\n{then}\nprintf '{zones}' > slope_anim.dat\n")
        program.chmod(0o755)

    program, row = tmp_path / "program", "  0.5040000000000000E+00  0.5 0.4941\\n"
    monkeypatch.setattr(peer_mpm3d, "LONGEST", 0.5)
    case = Case("linear", mpm.Scheme.USL, "J2", SHAPE, times=(1.0, 2.0, 4.0))
    # It gives the positions of the start and after a second, and does not reach the fourth.
    gives([2, 2], then="grep -q 'endtime 1$' slope.mpm || exec sleep 60")
    assert peer_mpm3d.theirs(case, program).tolist() == [[[0.504], [0.4941]]]
    # It loses a particle within the second second, or in the first.
    gives([4, 4, 2, 2, 2])
    assert peer_mpm3d.theirs(case, program).shape == (1, 2, 2)
    gives([4, 2, 2, 2, 2])
    assert peer_mpm3d.beside(case, program) == {"case": "linear, USL, J2", "reached_s": 0.0}
    gives([], then="exec sleep 60")
    assert peer_mpm3d.beside(case, program)["reached_s"] == 0
    monkeypatch.setattr(peer_mpm3d, "ROOT", tmp_path)
    monkeypatch.setattr(peer_mpm3d, "LONGEST", 0.05)
    with pytest.raises(Refused, match=r"reaches 1 s of no case in 0\.05 s: build it with -O2"):
        peer_mpm3d.run(quick=True, binary=program)
