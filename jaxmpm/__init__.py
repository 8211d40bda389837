"""Batched, differentiable generalised-interpolation material point method in 1D, 2D and 3D.

Names are loaded when first asked for: those listed in the stub beside this file.
"""

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, _offered = lazy_loader.attach_stub(__name__, __file__)
__all__ = [*_offered, "__version__"]
