"""Manufactured motion and other exact solutions that several tests share."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

import jaxmpm as mpm

ELASTIC = mpm.Soil(unit_weight=9.81e3, young=1e6, poisson=0.3)


def order(cells, errors):
    """Slope of log error against log cell size, by least squares."""
    return np.polyfit(np.log(cells), np.log(errors), 1)[0]


def manufactured(cells, dimension, *, amplitude=0.02, cfl=0.1, finest=None, **choices):
    """Scene, state and exact displacement (X, t) of an axis-aligned standing wave in a unit cube.

    u_i = A sin(2 pi X_i) sin(c pi t + i pi), held by the body force that it needs. With the law s' = C : d on fixed
    axes the Cauchy stress is that of the logarithmic strain, s_i = lambda ln J + 2 G ln F_i, and P_i = J s_i / F_i.
    Source: Wallstedt and Guilkey (2008), 10.1016/j.jcp.2008.07.019, section 5.1, for this law in place of theirs.
    """
    h = 1 / cells
    numerics = mpm.Discretisation(h, (h / 2,) * dimension, cfl=cfl, **choices)
    ones = (1.0,) * dimension
    scene, state = mpm.block(
        ones, ELASTIC, numerics, domain=ones, corner=(0.0,) * dimension, walls="roller", speed=1e-3
    )
    bulk, shear = float(scene.material.bulk), float(scene.material.shear)
    density = 9.81e3 / 9.81
    c = np.sqrt(1e6 / density)

    def exact(x, t):
        phase = jnp.arange(dimension)[:, None] * jnp.pi
        return amplitude * jnp.sin(2 * jnp.pi * x) * jnp.sin(c * jnp.pi * t + phase)

    def stretch(x, t):
        return 1 + jax.jvp(lambda y: exact(y, t), (x,), (jnp.ones_like(x),))[1]

    def nominal_stress(x, t):
        f = stretch(x, t)
        j = jnp.prod(f, axis=0)
        return j / f * ((bulk - 2 * shear / 3) * jnp.log(j) + 2 * shear * jnp.log(f))

    def body_force(x, t):
        # Each component varies along its own axis for P_i; the others enter through J and are held there.
        slope = [
            jax.jvp(lambda y, i=i: nominal_stress(y, t)[i], (x,), (jnp.zeros_like(x).at[i].set(1),))[1]
            for i in range(dimension)
        ]
        return -((c * jnp.pi) ** 2) * exact(x, t) - jnp.stack(slope) / density

    _, velocity = jax.jvp(lambda t: exact(scene.particles.position, t), (jnp.zeros(()),), (jnp.ones(()),))
    dt = cfl / (finest or cells) / float(jnp.sqrt(scene.material.p_wave_modulus / density))
    scene = replace(scene, body_force=body_force, time_step=jnp.asarray(dt))
    return scene, replace(state, velocity=velocity), exact


def manufactured_error(cells, dimension, *, t_end=0.02, **choices):
    """Largest error of a particle's displacement over the amplitude, at t_end (s)."""
    amplitude = choices.setdefault("amplitude", 0.02)
    scene, state, exact = manufactured(cells, dimension, **choices)
    final = mpm.solve(scene, state, t_end=t_end).raise_if_failed().state
    time = int(final.step) * float(scene.time_step)
    return float(jnp.max(jnp.abs(final.displacement - exact(scene.particles.position, time)))) / amplitude
