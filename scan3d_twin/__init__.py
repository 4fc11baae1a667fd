"""Automated 3D digitisation with a vacuum-cleaner robot and a small laser scanner.

The names of this module are the public interface: documented, versioned, and loaded when they are
first used. ``__init__.pyi`` lists them. Everything else in the package is private to it.
"""

import lazy_loader

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
