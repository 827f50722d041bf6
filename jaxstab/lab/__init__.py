"""The laboratory: what a laboratory does with the library, written with its public names alone."""

import lazy_loader

# Each name is imported where it is first used: the report imports Matplotlib.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
