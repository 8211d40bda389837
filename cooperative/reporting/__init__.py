"""What people see of a campaign: words, charts, pictures, one page, progress.

Names are loaded when first asked for, those listed in `__init__.pyi`: what draws takes a second.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
