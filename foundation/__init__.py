"""Shared base of `jaxmpm` and `kl`, so that neither needs the other: pytrees, checks of input, atomic files."""

__version__ = "0.1.0"
