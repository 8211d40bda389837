"""Exact and independent answers of flow in the ground, in NumPy and SciPy alone.

Each is derived anew where its paper is not at hand, and is held by a second derivation in the tests.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq


@dataclass(frozen=True)
class Layered:
    """Rain on layers of Gardner's soil with one alpha, above a water table at z = 0 (Srivastava and Yeh 1991).

    With U = exp(alpha (psi + z)) the equation is r U_t = (p U')', r = alpha dtheta exp(-alpha z), p = K exp(-alpha z):
    a Sturm-Liouville problem in which U and p U' pass the layers' boundaries unchanged. U = 1 at the table,
    p U' = alpha q at the surface.

    thickness, conductivity, capacity: of the layers from the table upwards, m, m/s, and porosity less residual.
    """

    alpha: float
    thickness: Sequence[float]
    conductivity: Sequence[float]
    capacity: Sequence[float]

    @property
    def tops(self) -> np.ndarray:
        return np.cumsum(self.thickness)

    def steady(self, rain: float, z: np.ndarray) -> np.ndarray:
        """U of steady rain (m/s)."""
        u, low = np.ones_like(z), 0.0
        for top, k in zip(self.tops, self.conductivity, strict=True):
            u += rain / k * (np.exp(self.alpha * np.clip(z, low, top)) - math.exp(self.alpha * low))
            low = top
        return u

    def _mode(self, mu: float, z: np.ndarray) -> tuple[np.ndarray, float]:
        """U of a mode that decays at the rate mu, at rising z, and its p U' at the surface."""
        value, slope, low = 0.0, 1.0, 0.0  # U and p U' at the foot of a layer
        u = np.zeros_like(z)
        for top, k, c in zip(self.tops, self.conductivity, self.capacity, strict=True):
            # U'' - alpha U' + (alpha c mu / k) U = 0
            square = self.alpha * c * mu / k - self.alpha**2 / 4
            w = np.emath.sqrt(square)
            derivative = slope * math.exp(self.alpha * low) / k
            b = (derivative - self.alpha / 2 * value) / w

            def of(x: np.ndarray | float, value=value, b=b, w=w) -> tuple[np.ndarray, np.ndarray]:
                grow, c_, s_ = np.exp(self.alpha / 2 * x), np.cos(w * x), np.sin(w * x)
                here = grow * (value * c_ + b * s_)
                return here.real, (self.alpha / 2 * here + grow * w * (b * c_ - value * s_)).real

            inside = (z >= low) & (z <= top)
            u[inside] = of(z[inside] - low)[0]
            value, derivative = (float(part) for part in of(top - low))
            slope, low = k * math.exp(-self.alpha * top) * derivative, top
        return u, slope

    def heads(self, before: float, rain: float, z: np.ndarray, t: float, modes: int = 120) -> np.ndarray:
        """Pressure heads (m) at heights z (m) at a time (s) after rain has changed from one rate to another (m/s)."""
        slope_at_top = lambda mu: self._mode(mu, np.zeros(0))[1]  # noqa: E731
        # Rates grow as the square of their number; steps are a tenth of the distance of the next two.
        rates: list[float] = []
        diffusivity = max(k / (self.alpha * c) for k, c in zip(self.conductivity, self.capacity, strict=True))
        base = diffusivity * (math.pi / self.tops[-1]) ** 2
        step = 0.01 * min(k / c * self.alpha for k, c in zip(self.conductivity, self.capacity, strict=True)) / 4
        low, at_low = 1e-9 * step, slope_at_top(1e-9 * step)
        while len(rates) < modes:
            high = low + max(step, 0.02 * math.sqrt(low * base))
            at_high = slope_at_top(high)
            if at_low * at_high < 0:
                rates.append(brentq(slope_at_top, low, high, xtol=1e-16 * base, rtol=1e-14))
            low, at_low = high, at_high
            if len(rates) > 3 and rates[-1] * t > 60:
                break
        x, weight = _gauss(np.r_[0.0, self.tops], 200)
        u = self.steady(rain, z)
        difference = self.steady(before, x) - self.steady(rain, x)
        c = np.select([x <= top for top in self.tops], self.capacity)
        r = weight * c * np.exp(-self.alpha * x)
        order = np.argsort(z)
        for mu in rates:
            mode, _ = self._mode(mu, x)
            share = np.sum(r * difference * mode) / np.sum(r * mode**2)
            at = np.empty_like(z)
            at[order] = self._mode(mu, z[order])[0]
            u = u + share * at * math.exp(-mu * t)
        return np.log(u) / self.alpha - z


def _gauss(ends: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights of Gauss and Legendre between each two ends."""
    x, w = np.polynomial.legendre.leggauss(n)
    halves = np.diff(ends) / 2
    return np.concatenate([low + h * (1 + x) for low, h in zip(ends, halves, strict=False)]), np.concatenate(
        [h * w for h in halves]
    )


def one_layer(soil: Layered, before: float, rain: float, z: np.ndarray, t: float) -> np.ndarray:
    """Pressure heads (m) of one layer as Srivastava and Yeh (1991), doi:10.1029/90WR02772, print them."""
    alpha, (depth,), (conductivity,), (capacity,) = soil.alpha, soil.thickness, soil.conductivity, soil.capacity
    length, height, time = alpha * depth, alpha * z, alpha * conductivity * t / capacity
    ends = (np.arange(400) + 0.5) * math.pi / length, (np.arange(400) + 1.0) * math.pi / length
    equation = lambda x: math.sin(x * length) + 2 * x * math.cos(x * length)  # noqa: E731
    roots = np.array([brentq(equation, a, b) for a, b in zip(*ends, strict=True)])[:, None]
    terms = np.sin(roots * height) * np.sin(roots * length) * np.exp(-(roots**2) * time)
    total = np.sum(terms / (1 + length / 2 + 2 * roots**2 * length), axis=0)
    q, q0 = rain / conductivity, before / conductivity
    k = q - (q - 1) * np.exp(-height) - 4 * (q - q0) * np.exp((length - height) / 2 - time / 4) * total
    return np.log(k) / alpha


def tracy(
    alpha: float, conductivity: float, capacity: float, edges: Sequence[float], driest: float, at: np.ndarray, t: float
) -> np.ndarray:
    """Pressure heads (m) at points (d, N) m in a section or solid, dry but for its top (Tracy 2006).

    The heads of the sides and the base stay at `driest` (m), the top has relative conductivities from there to 1 in the
    shape of a sine along each level axis. Source: Tracy (2006), doi:10.1029/2005WR004638, with Gardner's soil.
    """
    *level, height = edges
    *plan, z = at
    dry = math.exp(alpha * driest)
    beta = math.sqrt(alpha**2 / 4 + sum((math.pi / a) ** 2 for a in level))
    k = np.arange(1, 400)[:, None]
    rate, wave = alpha * capacity / conductivity, k * math.pi / height
    decay = (beta**2 + wave**2) / rate
    series = np.sum((-1.0) ** k * wave / decay * np.sin(wave * z) * np.exp(-decay * t), axis=0)
    column = np.sinh(beta * z) / math.sinh(beta * height) + 2 / (height * rate) * series
    shape = np.prod([np.sin(math.pi * x / a) for x, a in zip(plan, level, strict=True)], axis=0)
    return np.log(dry + (1 - dry) * shape * np.exp(alpha * (height - z) / 2) * column) / alpha


def tracy_top(alpha: float, edges: Sequence[float], driest: float) -> Callable[[np.ndarray], np.ndarray]:
    """Pressure heads (m) of the top of `tracy`, a function of positions (d, N) m."""
    dry = math.exp(alpha * driest)

    def heads(at: np.ndarray) -> np.ndarray:
        shape = np.prod([np.sin(math.pi * x / a) for x, a in zip(at[:-1], edges[:-1], strict=True)], axis=0)
        return np.asarray(np.log(dry + (1 - dry) * shape) / alpha)

    return heads


@dataclass(frozen=True)
class Curves:
    """Retention and conductivity of van Genuchten and Mualem, by their printed formulae."""

    conductivity: float
    alpha: float
    n: float
    porosity: float
    residual: float

    def water(self, head: np.ndarray) -> np.ndarray:
        m = 1 - 1 / self.n
        return (
            self.residual + (self.porosity - self.residual) * (1 + (self.alpha * np.maximum(-head, 0)) ** self.n) ** -m
        )

    def capacity(self, head: np.ndarray) -> np.ndarray:
        m, x = 1 - 1 / self.n, self.alpha * np.maximum(-head, 0)
        span = self.porosity - self.residual
        return span * m * self.n * self.alpha * x ** (self.n - 1) * (1 + x**self.n) ** (-m - 1)

    def k(self, head: np.ndarray) -> np.ndarray:
        m, x = 1 - 1 / self.n, self.alpha * np.maximum(-head, 0)
        s = (1 + x**self.n) ** -m
        return self.conductivity * np.sqrt(s) * (1 - x ** (self.n - 1) * s) ** 2


def column(
    soil: Curves, height: float, cells: int, top: float, base: float, initial: float, times: Sequence[float]
) -> np.ndarray:
    """Pressure heads (times, cells) m of an unsaturated column with given heads at its ends, by the method of lines.

    Fluxes are those of the mean conductivity; LSODA keeps the error in time below 1e-8.
    """
    dz = height / cells

    def rates(_: float, head: np.ndarray) -> np.ndarray:
        k, k_base, k_top = soil.k(head), soil.k(np.array(base)), soil.k(np.array(top))
        inner = (k[1:] + k[:-1]) / 2 * (np.diff(head) / dz + 1)
        below = (k_base + k[0]) / 2 * ((head[0] - base) / (dz / 2) + 1)
        above = (k_top + k[-1]) / 2 * ((top - head[-1]) / (dz / 2) + 1)
        flux = np.r_[below, inner, above]
        return np.asarray(np.diff(flux) / dz / soil.capacity(head))

    done = solve_ivp(
        rates, (0, times[-1]), np.full(cells, initial), "LSODA", times, rtol=1e-8, atol=1e-8, lband=1, uband=1
    )
    return np.asarray(done.y.T)


def front(z: np.ndarray, head: np.ndarray, at: float) -> float:
    """Highest height (m) below which heads are below `at` (m), of heads that rise with height."""
    return float(np.interp(at, head, z))


def sorptivity(soil: Curves, wet: float, dry: float) -> float:
    """Philip's sorptivity (m/s^0.5): level soil whose end is brought from one head to another (m).

    With the similarity variable s = x / sqrt(t) the equation is -(s / 2) C psi' = (K psi')'. The flux at the end is
    found so that the head falls to that of dry soil; the sorptivity is twice it. Source: Philip (1957),
    doi:10.1097/00010694-195705000-00002.
    """

    # Along the head: s' = -K / f, f' = -(s / 2) C, where f is the flux times sqrt(t), from the end inwards.
    def excess(flux: float) -> float:
        def slopes(head: float, state: np.ndarray) -> list[float]:
            s, f = state
            at = np.array(head)
            return [-float(soil.k(at)) / f, float(soil.capacity(at)) * s / 2]

        empty = lambda _, state: state[1] - 1e-9 * flux  # noqa: E731
        empty.terminal = True  # type: ignore[attr-defined]
        done = solve_ivp(slopes, (wet, dry), [0.0, flux], "LSODA", rtol=1e-10, atol=1e-16, events=empty)
        # Too little flux is used up before the soil is dry; too much is left over.
        return float(done.y[1, -1]) - 1e-9 * flux if done.t[-1] <= dry else -abs(float(done.t[-1]) - dry) - 1e-30

    low, high = 1e-12, 1.0
    for _ in range(200):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if excess(middle) < 0 else (low, middle)
        if high / low < 1 + 1e-10:
            break
    return 2 * math.sqrt(low * high)


def dupuit(conductivity: float, up: float, down: float, length: float) -> float:
    """Discharge (m2/s) through a rectangular dam between two levels above its base (m), exact by Charny (1951)."""
    return conductivity * (up**2 - down**2) / (2 * length)


def kirkham(conductivity: float, depth: float, base: float, spacing: float, radius: float) -> float:
    """Discharge (m2/s) of each of many drains at atmospheric pressure below soil that is ponded to its surface.

    depth, base: of the drains and of the impervious base below the surface (m). By images: sinks and sources, mirrored
    with the other sign at the surface and with their own at the base. Source: Kirkham (1949),
    doi:10.1029/TR030i003p00369.
    """
    period = 2 * math.pi / spacing

    def potential(above: float) -> float:
        """Of a row of sinks `above` (m) the point, less what cancels in the sum."""
        x = period * abs(above)
        return 0.5 * (x + 2 * math.log1p(-math.exp(-x)) if x > 1e-9 else 0)

    total = math.log(period * radius)  # cosh(x) - 1 -> x^2 / 2 beside the sink itself, as in potential(radius)
    for k in range(-60, 61):
        sign = (-1) ** k
        if k:
            total += sign * potential(2 * base * k)
        total -= sign * potential(2 * depth + 2 * base * k)
    return 2 * math.pi * conductivity * depth / -total
