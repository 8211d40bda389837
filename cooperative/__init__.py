"""Campaigns: screen samples on a rough grid, refine the ranked ones, estimate how likely the slope runs out.

from cooperative import report, run

run(open("scene.toml", encoding="utf-8").read(), "out", workers=2)
print(report("out"))

Names are loaded when first asked for: those listed in `__init__.pyi`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
