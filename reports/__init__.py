"""Reports: pages and texts drawn from saved results only, and the same figures as axes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
