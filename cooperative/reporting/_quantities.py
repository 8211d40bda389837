"""How each parameter of soil is drawn: its name, symbol and unit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quantity:
    """How a parameter of soil is drawn.

    Args:
        word: its name in plain words.
        symbol: in the mathematics of matplotlib.
        unit: of its scale.
        size: of that unit, in SI units or degrees.
    """

    word: str
    symbol: str
    unit: str
    size: float = 1.0

    @property
    def label(self) -> str:
        """Label of its scale."""
        return f"{self.word} {self.symbol} [{self.unit}]"


QUANTITIES = {
    "strength": Quantity("undrained strength", "$S_u$", "kPa", 1e3),
    "strength_ratio": Quantity("undrained strength over effective vertical stress", r"$S_u/\sigma'_v$", "-"),
    "cohesion": Quantity("cohesion", "$c$", "kPa", 1e3),
    "friction": Quantity("friction angle", r"$\varphi$", "degrees"),
    "dilation": Quantity("dilation angle", r"$\psi$", "degrees"),
    "young": Quantity("Young's modulus", "$E$", "MPa", 1e6),
    "poisson": Quantity("Poisson's ratio", r"$\nu$", "-"),
    "unit_weight": Quantity("unit weight", r"$\gamma$", "kN/m3", 1e3),
    "softening_modulus": Quantity("softening modulus", "$H$", "kPa", 1e3),
    "residual_cohesion": Quantity("residual cohesion", "$c_r$", "kPa", 1e3),
    "residual_friction": Quantity("residual friction angle", r"$\varphi_r$", "degrees"),
    "residual_ratio": Quantity("residual over peak strength", "$r$", "-"),
    "strain_95": Quantity("plastic strain of 95 % of the loss", r"$\gamma_{95}$", "-"),
    "softening_strain": Quantity("plastic strain of the loss", r"$\gamma_r$", "-"),
    "rate_coefficient": Quantity("rise of strength per tenfold rate", r"$\mu$", "-"),
}


def quantity(name: str) -> Quantity:
    """How a parameter is drawn; one that a law of the user's own has, by its name and in its own unit."""
    return QUANTITIES.get(name, Quantity(name.replace("_", " "), "", "in its own unit"))
