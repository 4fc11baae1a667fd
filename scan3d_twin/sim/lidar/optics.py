"""Optics: the power that a surface returns to the lidar.

Emitter and receiver coincide (monostatic), so the half vector is the view vector. Power per beam,
in units of a white diffuse surface facing the sensor at 1 m times 1 / pi:

    P = (rho / pi * cos + F0 * D * G1^2 / (4 * cos) + R) / r^2

with diffuse reflectance rho, normal reflectance F0, the GGX distribution D and Smith shadowing G1
(Walter et al. 2007, eq. 33 and 34) of alpha = roughness^2, and the retro-reflection R. Metals have
no diffuse part, so a shiny curved metal returns only from where it faces the sensor: the paper's
Fig. 6a.

What is drawn with an alpha below 1 is glass: a smooth surface that scatters little (``glass``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import FloatArray, IntArray, read_only
from scan3d_twin.sim.lidar.config import LidarModelConfig
from scan3d_twin.sim.scenes.visibility import drawn_rgba, find_transparency

F0_DIELECTRIC, F0_METAL = 0.04, 0.90
"""Reflectance at normal incidence of plastics, and of aluminium or chrome near 785 nm."""
RETRO = "retro"
"""Name of the tuple of retro-reflective materials; ``prm`` is their coefficient R [cd / lx m^2], 70
for white engineering grade sheeting (ASTM D4956, type I, .2 deg)."""


GLASS_ROUGHNESS = 0.1
"""Roughness of transparent things that state none: polished, so that at 1 m the URG-04LX sees a
pane itself within 6 deg of its normal (assumption)."""
SCATTER_EXPONENT = 4
"""Exponent of alpha that gives the share of a transparent surface that scatters like an opaque one
(assumption). Alpha is drawn for tint as much as for dirt: .25 scatters .4 %, within the haze of
clean float glass (below 1 % by ASTM D1003), and .9 scatters 66 %."""


@dataclass(frozen=True)
class Materials:
    """Optical properties by geom id; the last row is the robot.

    Attributes:
        diffuse: rho / pi (n_geoms + 1,).
        specular: F0 alpha^2 / pi (n_geoms + 1,).
        alpha2: Squared GGX roughness (n_geoms + 1,).
        retro: R (n_geoms + 1,); None where nothing is retro-reflective.
    """

    diffuse: FloatArray
    specular: FloatArray
    alpha2: FloatArray
    retro: FloatArray | None

    @staticmethod
    def of(model: Any, config: LidarModelConfig) -> Materials:
        """Read ``metallic``, ``roughness`` and colour of each geom; unset (-1) is matte.

        MuJoCo's ``specular`` and ``shininess`` are ignored: by default they make everything shiny.
        """
        # Start from matte surfaces
        metallic = np.zeros(model.ngeom + 1)
        roughness = np.full(model.ngeom + 1, config.roughness)
        red = np.full(model.ngeom + 1, config.albedo)
        retro, gains = np.zeros(model.ngeom + 1), _retro_gains(model)

        # Read the material of each geom
        for geom, material in enumerate(model.geom_matid):
            red[geom] = drawn_rgba(model, geom)[0]
            if material >= 0:
                metallic[geom] = max(0.0, float(model.mat_metallic[material]))
                retro[geom] = gains.get(int(material), 0.0)
                if model.mat_roughness[material] >= 0:
                    roughness[geom] = max(0.01, float(model.mat_roughness[material]))

        # Let transparent surfaces scatter little
        alphas = 1 - np.append(find_transparency(model), 0.0)
        matte = (alphas < 1) & (roughness == config.roughness)
        roughness[matte] = GLASS_ROUGHNESS
        scatter = alphas**SCATTER_EXPONENT

        # Precompute the factors of power
        f0 = F0_DIELECTRIC * (1 - metallic) + F0_METAL * metallic
        return Materials(
            diffuse=read_only(scatter * (1 - metallic) * np.minimum(config.albedo, red) / math.pi),
            specular=read_only(f0 * roughness**4 / math.pi),
            alpha2=read_only(roughness**4),
            retro=read_only(retro) if retro.any() else None,
        )

    def power(self, geoms: IntArray, cosines: FloatArray, distances: FloatArray) -> FloatArray:
        """Return P (n,) of hits on ``geoms``; 0 for a miss.

        Args:
            geoms: Geom ids (n,); -1 is the robot itself.
            cosines: Cosines of the incidence, in 0..1 (n,).
            distances: Distances (n,) [m]; inf for a miss.
        """
        cos = np.maximum(cosines, 1e-3)
        alpha2 = self.alpha2.take(geoms)
        cos2 = cos * cos
        slope = cos2 * (alpha2 - 1.0)
        lobe = (slope + 1.0) * (cos + np.sqrt(alpha2 - slope))
        mirrored = self.specular.take(geoms) / (lobe * lobe)
        power: FloatArray = cos * (self.diffuse.take(geoms) + mirrored)
        if self.retro is not None:
            power += self.retro.take(geoms)
        power /= distances * distances
        return power


def _retro_gains(model: Any) -> dict[int, float]:
    """Return R by material id."""
    group = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TUPLE, RETRO)
    if group < 0:
        return {}
    first = model.tuple_adr[group]
    rows = range(first, first + model.tuple_size[group])
    return {int(model.tuple_objid[row]): float(model.tuple_objprm[row]) for row in rows}
