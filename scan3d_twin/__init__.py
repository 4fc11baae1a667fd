"""Automated 3D digitisation with a vacuum-cleaner robot and a small laser scanner.

The names of this module are the public interface: documented, versioned, and loaded when they are
first used. ``__init__.pyi`` lists them. ``scan3d_twin.extend`` is public too: it holds what another
package's planner, export format or device needs. Everything else in the package is private to it.

Importing it before NumPy selects the kernels of OpenBLAS, so that one seed gives the same bytes on
every processor; see ``scan3d_twin.arithmetic``.
"""

import lazy_loader

from scan3d_twin.arithmetic import fix_arithmetic
from scan3d_twin.core.display import install_renderer

__version__ = "0.2.0"

fix_arithmetic()
install_renderer("scan3d_twin.viz.notebook:render_html")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
