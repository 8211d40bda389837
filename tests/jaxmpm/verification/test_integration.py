"""Return mappings against direct integration of the elastoplastic equations along curved random strain paths."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxmpm as mpm
from jaxmpm.laws import cone
from tests.jaxmpm.laws.test_materials_frictional import PEAK_AND_RESIDUAL, law, tensor

K, G = 8e6, 3e6
ISOTROPIC = np.array([1, 1, 1, 0, 0, 0])
STIFFNESS = (K - 2 * G / 3) * np.outer(ISOTROPIC, ISOTROPIC) + 2 * G * np.eye(6)
TWICE = np.array([1, 1, 1, 2, 2, 2])  # a double contraction counts each shear component twice


@jax.jit
def mapped(material, start, first, second, history, steps):
    """Stress after the strain path first t + second t^2, t from 0 to 1, in `steps` return mappings."""

    def one(n, carry):
        increment = first / steps + second * (2 * n + 1) / steps**2
        return material.update(tuple(increment), *carry, 1 / steps)

    stress, history = jax.lax.fori_loop(0, steps, one, (tuple(start), history))
    return jnp.stack(stress), history


def extrapolated(material, start, first, second, history):
    """The limit of small steps by Romberg's scheme: backward Euler's error is a series in the step."""
    row = []
    for k in range(6):
        new = [np.append(*mapped(material, start, first, second, history, 256 * 2**k))]
        for j, old in enumerate(row):
            new.append(new[j] + (new[j] - old) / (2 ** (j + 1) - 1))
        row = new
    return row[-1]


def j2_normal(stress):
    s = stress - np.mean(stress[:3]) * ISOTROPIC
    return s / (2 * np.sqrt(np.sum(TWICE * s * s) / 2))


def j2_flow(softening_slope):
    """Normal, flow, slope of the yield function in g, g per unit of flow: of J2 that softens by this slope."""
    return lambda stress, g: (j2_normal(stress), j2_normal(stress), softening_slope(g), 1.0)


def frictional_flow(material, surface):
    """The same of a surface (value, normal, flow) of cohesion, friction and dilation; the slope by differences."""

    def at(g):
        return [
            float(v) for v in material.softening.strength(material.cohesion, material.friction, material.dilation, g)
        ]

    def functions(stress, g):
        _, normal, flow = surface(stress, *at(g))
        h = 1e-6
        slope = (surface(stress, *at(g + h))[0] - surface(stress, *at(g - h))[0]) / (2 * h)
        deviatoric = flow - np.mean(flow[:3]) * ISOTROPIC
        return normal, flow, slope, np.sqrt(2 * np.sum(TWICE * deviatoric**2))

    return functions


def cone_surface(stress, cohesion, friction, dilation):
    slope, intercept, dilating = (float(v) for v in cone(mpm.laws.Matching.PLANE_STRAIN, cohesion, friction, dilation))
    normal, third = j2_normal(stress), ISOTROPIC / 3
    value = shear_stress(stress) + slope * np.mean(stress[:3]) - intercept
    return value, normal + slope * third, normal + dilating * third


def pyramid_surface(stress, cohesion, friction, dilation):
    xx, yy, zz, xy, yz, xz = stress
    values, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def dyad(v):
        return np.array([v[0] ** 2, v[1] ** 2, v[2] ** 2, v[0] * v[1], v[1] * v[2], v[0] * v[2]])

    least, greatest = dyad(axes[:, 0]), dyad(axes[:, 2])
    s, r = np.sin(friction), np.sin(dilation)
    value = values[2] * (1 + s) - values[0] * (1 - s) - 2 * cohesion * np.cos(friction)
    return value, greatest * (1 + s) - least * (1 - s), greatest * (1 + r) - least * (1 - r)


def integrated(functions, start, first, second, g):
    """The same path by an explicit method of order 8 on the elastoplastic equations."""

    def rates(t, y):
        normal, flow, slope, per_g = functions(y[:6], y[6])
        strain = first + 2 * second * t
        across = (TWICE * normal) @ STIFFNESS
        multiplier = across @ strain / (across @ flow - slope * per_g)
        assert multiplier > 0, "the path unloads"
        return np.append(STIFFNESS @ (strain - multiplier * flow), per_g * multiplier)

    done = solve_ivp(rates, (0, 1), np.append(start, g), method="DOP853", rtol=1e-12, atol=1e-9)
    return done.y[:, -1]


def shear_stress(stress):
    s = stress - np.mean(stress[:3]) * ISOTROPIC
    return np.sqrt(np.sum(TWICE * s * s) / 2)


def j2(softening):
    return mpm.laws.J2(jnp.asarray(K), jnp.asarray(G), jnp.asarray(4e4), softening)


def case(name):
    """Material, its equations, and the yield function of a stress before any plastic strain."""
    if name == "j2 linear":
        soft = mpm.laws.Softening(jnp.asarray(85e3), jnp.asarray(0.1))
        return j2(soft), j2_flow(lambda g: 85e3), lambda stress: shear_stress(stress) - 4e4
    if name == "j2 exponential":
        soft = mpm.laws.ExponentialSoftening(jnp.asarray(0.2), jnp.asarray(0.3))
        slope = j2_flow(lambda g: 3 / 0.3 * 4e4 * 0.8 * np.exp(-3 * g / 0.3))
        return j2(soft), slope, lambda stress: shear_stress(stress) - 4e4
    kind, surface = {
        "drucker-prager": (mpm.laws.DruckerPrager, cone_surface),
        "mohr-coulomb": (mpm.laws.MohrCoulomb, pyramid_surface),
    }[name]
    material = law(kind, 10.0, softening=PEAK_AND_RESIDUAL | {"strain": 0.5})
    peak = [float(v) for v in (material.cohesion, material.friction, material.dilation)]
    return material, frictional_flow(material, surface), lambda stress: surface(stress, *peak)[0]


def on_surface(value, direction, base):
    """The stress base + k direction at which yield begins."""
    low, high = 0.0, 1e7
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if value(base + middle * direction) < 0 else (low, middle)
    return base + low * direction


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", ["j2 linear", "j2 exponential", "drucker-prager", "mohr-coulomb"])
def test_return_mapping_converges_to_the_differential_equations(name, seed):
    material, functions, value = case(name)
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=6)
    direction[:3] -= direction[:3].mean()
    base = np.array([0.0] * 6 if name.startswith("j2") else [-1e5, -1e5, -1e5, 0, 0, 0])
    start = on_surface(value, direction, base)
    first = direction / np.linalg.norm(direction) * 0.01
    turn = rng.normal(size=6)
    second = turn / np.linalg.norm(turn) * 0.002
    exact = integrated(functions, start, first, second, 0.0)
    ours = extrapolated(material, tensor(start), jnp.asarray(first), jnp.asarray(second), jnp.zeros(()))
    assert np.max(np.abs(ours[:6] - exact[:6])) < 1e-8 * np.max(np.abs(exact[:6]))
    assert abs(ours[6] - exact[6]) < 1e-8


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("strain_95", "steps"), [(0.05, 1), (0.3, 9)])
def test_exponential_softening_in_simple_shear_solves_its_own_equation(strain_95, steps):
    soft = mpm.laws.ExponentialSoftening(jnp.asarray(0.2), jnp.asarray(strain_95))
    material = mpm.laws.J2(jnp.asarray(K), jnp.asarray(G), jnp.asarray(4e4), soft)
    gamma = 0.2
    stress, g = mapped(material, jnp.zeros(6), jnp.zeros(6).at[5].set(gamma / 2), jnp.zeros(6), jnp.zeros(()), steps)
    assert np.isclose(stress[5], G * (gamma - g), rtol=1e-9)
    assert np.isclose(stress[5], 4e4 * (0.2 + 0.8 * np.exp(-3 * g / strain_95)), rtol=1e-9)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("rate", "factor"), [(1e-7, 1.0), (1e-5, 1.0), (1e-3, 1.2), (10.0, 1.6)])
def test_strength_rises_by_a_share_per_tenfold_rate(rate, factor):
    effect = mpm.laws.RateEffect(jnp.asarray(0.1), jnp.asarray(1e-5))
    for soft in (None, mpm.laws.ExponentialSoftening(jnp.asarray(1.0), jnp.asarray(0.3))):
        material = mpm.laws.J2(jnp.asarray(K), jnp.asarray(G), jnp.asarray(4e4), soft, None, effect)
        increment = (0.0, 0.0, 0.0, 0.0, 0.0, jnp.asarray(0.05))
        history = None if soft is None else jnp.zeros(())
        stress, _ = material.update(increment, tensor([0.0] * 6), history, jnp.asarray(0.1 / rate))
        assert np.isclose(stress[5], factor * 4e4, rtol=1e-9)
    with pytest.raises(ValueError, match="needs the time step"):
        material.update(increment, tensor([0.0] * 6), history)
