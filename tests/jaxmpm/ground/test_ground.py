"""What ground is: a slope drawn as a section, its toe and crest, and a class of a user's own in the place of both."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import jaxmpm as mpm

CLAY = mpm.Soil(strength=40e3, tension_cutoff=0.0)
SAND = mpm.FrictionalSoil(cohesion=1e3, friction=35.0)
NUMERICS = mpm.Discretisation(2.0, (1.0, 1.0))
LINE = [(0, 16), (30, 16), (54, 4), (96, 4)]


@dataclass(frozen=True)
class Embankment:
    """An embankment on level ground, with a berm half way down (m)."""

    height: float = 8.0
    berm: float = 6.0
    subsoil: float = 4.0

    @property
    def outline(self) -> mpm.Section:
        x = np.cumsum([0, 10, self.height, self.berm, self.height, 20])
        rise = np.array([1, 1, 0.5, 0.5, 0, 0]) * self.height
        return mpm.Section(tuple(zip(x, self.subsoil + rise, strict=True)), toe=x[4], crest=x[1])

    @property
    def corner(self):
        return self.outline.corner

    @property
    def extent(self):
        return self.outline.extent

    @property
    def face(self):
        return self.outline.face

    def heights(self, x):
        return self.outline.heights(x)

    def layer_of(self, layers, position, _):
        return (position[1] < self.subsoil).astype(int) if len(layers) > 1 else np.zeros(position.shape[1], int)

    def build(self, layers, discretisation, *, gravity=9.81, at_rest=True):
        return mpm.scene_of(self, layers, discretisation, gravity=gravity, at_rest=at_rest)


@settings(max_examples=6, deadline=None)
@given(*(st.integers(2, 12) for _ in range(4)), st.sampled_from([0.0, 1.0, 1.5, 2.0]), st.sampled_from([0.5, 1.0]))
def test_a_slope_drawn_as_a_section_has_the_same_particles(crest, height, toe, foundation, run, spacing):
    height, toe = 2 * height, 2 * toe
    slope = mpm.Slope(2.0 * crest, height, run, toe + run * height % 2, foundation)
    top = foundation + height
    line = [(0, top), (slope.crest, top), (slope.toe_x, foundation), (slope.length, foundation)]
    drawn = mpm.Section(line, toe=slope.toe_x, crest=slope.crest)
    assert drawn.face == slope.face
    assert drawn.volume == pytest.approx(slope.volume)
    numerics = mpm.Discretisation(2.0, (spacing, spacing))
    one, other = (shape.build([mpm.Layer(CLAY)], numerics, at_rest=False)[0] for shape in (slope, drawn))
    assert one.grid == other.grid
    assert one.boundary.walls == other.boundary.walls
    for name in ("position", "mass", "volume"):
        assert np.array_equal(getattr(one.particles, name), getattr(other.particles, name))


def test_a_toe_is_counted_from_the_surface():
    assert mpm.Section(LINE).face is None
    assert mpm.Section(LINE, toe=54.0).face == mpm.Face(54.0, 4.0, 12.0)
    # The crest is by default the highest ground before the toe; behind a hill it is elsewhere.
    hill = [(0, 25), (10, 25), (20, 16), (30, 16), (54, 4), (96, 4)]
    assert mpm.Section(hill, toe=54.0).face.height == 21.0
    assert mpm.Section(hill, toe=54.0, crest=30.0).face.height == 12.0
    assert mpm.Section(hill, toe=54.0, crest=42.0).face.height == 6.0
    # Of an upright face the toe is its lower end, the crest its upper one; ground may rise beyond a toe.
    assert mpm.Section([(0, 9), (8, 9), (8, 3), (20, 3)], toe=8.0, crest=8.0).face == mpm.Face(8.0, 3.0, 6.0)
    assert mpm.Section([(0, 9), (6, 3), (20, 5)], toe=6.0).face == mpm.Face(6.0, 3.0, 6.0)


REFUSED = {
    "outside": ({"toe": 500.0}, "toe = 500 m lies outside the ground, which reaches from x = 0 to 96 m"),
    "at the wall": ({"toe": 96.0}, "toe = 96 m lies outside the ground"),
    "on the face": ({"toe": 40.0}, "toe = 40 m is no foot of a slope.*give x = 54 m"),
    "at the crest": ({"toe": 30.0}, "toe = 30 m is no foot of a slope"),
    "none": ({"toe": float("nan")}, "toe = nan m: give a finite value"),
    "crest beyond": ({"toe": 54.0, "crest": 70.0}, "crest = 70 m lies on the other side of the toe at x = 54 m"),
    "crest outside": (
        {"toe": 54.0, "crest": -1.0},
        "crest = -1 m lies outside the ground, which reaches from x = 0 to 96 m",
    ),
    "crest alone": ({"crest": 30.0}, "crest = 30 m without a toe.*give toe"),
    "low crest": ({"toe": 54.0, "crest": 54.0}, "crest = 54 m is 0 m above the toe"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_toe_that_the_surface_has_not_is_refused(name):
    given, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        mpm.section(mpm.Section(LINE, **given), CLAY, NUMERICS, at_rest=False)


def test_a_surface_without_a_foot_has_no_toe():
    with pytest.raises(ValueError, match="the surface has none between the walls, leave the toe out"):
        mpm.Section([(0, 4), (42, 8), (96, 4)], toe=42.0).check()


@example(steps=[-6, -3, 0, 2], crest=None)
@example(steps=[-4, 4], crest=None)
@example(steps=[5, -5, 0], crest=1)
@given(steps=st.lists(st.integers(-6, 6), min_size=2, max_size=5), crest=st.none() | st.integers(0, 5))
def test_a_section_and_its_mirror_image_have_the_same_faces(steps, crest):
    x, z = 4.0 * np.arange(len(steps) + 1), 20.0 + np.cumsum([0, *steps])
    crest = None if crest is None else min(4.0 * crest, x[-1])

    def faces(x, z, crest):
        """The face whose toe each point is, None where it is refused."""
        for toe in x[1:-1]:
            try:
                yield mpm.Section(list(zip(x, z, strict=True)), toe=toe, crest=crest).face
            except ValueError:
                yield None

    mirrored = None if crest is None else x[-1] - crest
    for face, image in zip(faces(x, z, crest), list(faces(x[-1] - x[::-1], z[::-1], mirrored))[::-1], strict=True):
        assert (face is None) == (image is None)
        if face is None:
            continue
        assert (face.toe_x, face.toe_z, face.height) == (x[-1] - image.toe_x, image.toe_z, image.height)
        # A valley whose sides are as high as each other is the foot of the side to its left.
        assert face.downhill == -image.downhill or (face.downhill == image.downhill == 1)


def test_a_ground_of_ones_own_is_built_like_the_section_it_draws():
    own = Embankment()
    layers = [mpm.Layer(CLAY, bottom=((0, 4.0), (52, 4.0))), mpm.Layer(CLAY)]
    (one, start), (other, drawn) = (
        mpm.ground.build_ground(each, layers, NUMERICS, gravity=9.0, at_rest=True) for each in (own, own.outline)
    )
    for a, b in ((one.particles.position, other.particles.position), (one.particles.mass, other.particles.mass)):
        assert np.array_equal(a, b)
    assert one.grid == other.grid
    assert np.array_equal(start.stress, drawn.stress)
    assert np.array_equal(*(mpm.ground.layer_of(each, layers, np.array(one.particles.position, float), NUMERICS)
                            for each in (own, own.outline)))  # fmt: skip


def test_what_a_ground_does_not_tell_follows_from_its_surface_and_layers():
    own, layers = Embankment(), [mpm.Layer(CLAY, bottom=((0, 4.0), (52, 4.0))), mpm.Layer(SAND)]
    assert mpm.ground.cells(own, NUMERICS) == own.outline.cells(NUMERICS)
    assert mpm.ground.volume(own) == pytest.approx(own.outline.volume, rel=1e-5)
    assert mpm.ground.relief(own) == pytest.approx(own.outline.relief)
    for one, other in zip(mpm.ground.thicknesses(own, layers), own.outline.thicknesses(layers), strict=True):
        assert one.metres == pytest.approx(other.metres, abs=12 / 256)
        assert one.weak == other.weak
    for number in (0, 1):
        corner, extent = mpm.ground.box_of(own, layers, number)
        low, edges = own.outline.box_of(layers, number)
        # It holds the layer, and is larger by two parts of each axis at most.
        assert (np.array(corner) <= low).all()
        assert (np.add(corner, extent) >= np.add(low, edges)).all()
        assert (np.array(extent) <= edges + 2 * np.array(own.extent) / (512, 256) + 1e-9).all()
    with pytest.raises(ValueError, match="layer 3 lies nowhere"):
        mpm.ground.box_of(own, [*layers, mpm.Layer(SAND)], 2)


@dataclass(frozen=True)
class Notch:
    """A cliff 6 m high over a notch 2 m high and 3 m deep, across a width of 8 m: no line draws it."""

    corner = (5.0, -4.0, 1.0)
    extent = (24.0, 8.0, 8.0)
    face = mpm.Face(15.0, 3.0, 6.0)

    def heights(self, x, y):
        return np.where(x < 15.0, 9.0, 3.0) + 0 * y

    def layer_of(self, layers, position, _):
        return np.zeros(position.shape[1], int)

    def build(self, layers, discretisation, **loads):
        def inside(at):
            x, y, z = at
            return (z < self.heights(x, y)) & ~((x > 12) & (z > 3) & (z < 5))

        return mpm.scene_of(self, layers, discretisation, inside=inside, ends=("roller", "fixed"), **loads)


def test_a_ground_may_overhang():
    numerics = mpm.Discretisation(2.0, (1.0, 1.0, 1.0))
    scene, state = mpm.ground.build_ground(Notch(), [mpm.Layer(CLAY)], numerics, gravity=9.81, at_rest=True)
    assert float(np.sum(scene.particles.volume)) == 8 * (24 * 8 - 14 * 6 - 3 * 2)
    assert mpm.ground.volume(Notch()) == pytest.approx(8 * (24 * 8 - 14 * 6), rel=0.01)
    assert {(wall.axis, wall.hold) for wall in scene.boundary.walls} == {(0, "roller"), (1, "fixed"), (2, "fixed")}
    # Soil over the notch hangs on what is behind it.
    x, _, z = np.asarray(scene.particles.position)
    assert float(np.asarray(state.stress)[0][(x > 11) & (x < 13) & (z > 8)].mean()) > 0


def test_grounds_that_are_none_are_refused():
    class Nothing:
        corner = (0.0, 0.0)

    with pytest.raises(ValueError, match="Nothing lacks extent, face, heights, build, layer_of"):
        mpm.ground.build_ground(Nothing(), [mpm.Layer(CLAY)], NUMERICS)
    with pytest.raises(ValueError, match=r"water = 3\.0, and Embankment\.build takes none"):
        mpm.ground.build_ground(Embankment(), [mpm.Layer(SAND)], NUMERICS, water=3.0)
    with pytest.raises(ValueError, match="a Slope has 2 layers"):
        mpm.Slope().build([mpm.Layer(SAND), mpm.Layer(SAND)], NUMERICS)

    class Flat(Embankment):
        extent = (52.0, 0.0)

    with pytest.raises(ValueError, match=r"extent = 0 m at \[1\]"):
        mpm.ground.build_ground(Flat(), [mpm.Layer(SAND)], NUMERICS)

    class Beyond(Embankment):
        face = mpm.Face(toe_x=60.0, toe_z=4.0, height=8.0)

    with pytest.raises(ValueError, match=r"Beyond has its toe at x = 60 m, outside the ground.* from 0 to 52 m"):
        mpm.ground.build_ground(Beyond(), [mpm.Layer(SAND)], NUMERICS)

    class Lost(Embankment):
        def layer_of(self, layers, position, _):
            return np.full(position.shape[1], 2)

    with pytest.raises(ValueError, match=r"Lost\.layer_of gave layers 2 to 2: give 0 to 0"):
        mpm.ground.build_ground(Lost(), [mpm.Layer(SAND)], NUMERICS)
    with pytest.raises(ValueError, match=r"the ground's length = 52 m is no whole multiple of cell = 3 m"):
        mpm.ground.build_ground(Embankment(), [mpm.Layer(SAND)], mpm.Discretisation(3.0, (1.0, 1.0)))


def test_no_room_but_ground_asks_of_what_class_a_ground_is():
    root = Path(mpm.__file__).parent.parent
    classes = {"Slope", "Section", "Terrain"}
    for path in [*(root / "cooperative").rglob("*.py"), *(root / "jaxmpm").rglob("*.py")]:
        if path.parent.name == "ground":
            continue
        for call in ast.walk(ast.parse(path.read_text())):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") in ("isinstance", "issubclass", "type"):
                assert not classes & {getattr(node, "id", None) for node in ast.walk(call)}, f"{path}: {call.lineno}"
