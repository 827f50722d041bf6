"""Equilibrium and stability of adhesive rough contacts, on JAX.

It implements V. Rey and J. Bleyer, *Stability analysis of rough surfaces in adhesive normal
contact*, whose equation numbers the documentation quotes.
"""

import importlib.metadata

import lazy_loader

# Each name is imported where it is first used, from the module that `__init__.pyi` gives.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__version__ = importlib.metadata.version(__name__)
