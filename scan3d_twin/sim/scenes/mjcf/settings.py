"""The global settings of a scene: those of the twin, whatever the file says.

A file's ``<option>``, ``<flag>``, ``<compiler>``, ``<size>`` and ``<statistic>`` were chosen for
its own robot; kept, they would act on ours, which then falls, floats or slides. The scene itself
is at rest (``freeze.py``) and needs none of them. Settings that only say how the file is to be
read (angle, eulerseq, meshdir, ...) remain.
"""

from __future__ import annotations

from typing import Any

import mujoco

READING = frozenset(
    {"authored", "autolimits", "degree", "eulerseq", "fitaabb", "LRopt", "meshdir", "texturedir"}
)
"""Settings of ``<compiler>`` that say how the elements of the file are to be read."""
SIZES = ("memory", "nstack", "njmax", "nconmax")
"""Limits of memory, which a model that grows by a robot may exceed."""
CONTACT = (
    *("contype", "conaffinity", "condim", "priority", "friction", "solmix"),
    *("solref", "solimp", "margin", "gap", "group", "material"),
)
"""Attributes of a geom that a scene's default class may change."""


def reset_settings(spec: Any) -> None:
    """Give ``spec`` the default settings of MuJoCo; the twin's own come when a robot is added."""
    fresh = mujoco.MjSpec()
    _copy(fresh.option, spec.option, _names(fresh.option))
    _copy(fresh.compiler, spec.compiler, [n for n in _names(fresh.compiler) if n not in READING])
    _copy(fresh.compiler.LRopt, spec.compiler.LRopt, _names(fresh.compiler.LRopt))
    _copy(fresh, spec, SIZES)
    spec.stat.meaninertia = fresh.stat.meaninertia  # scales the tolerance of the solver


def reset_contact(geom: Any) -> None:
    """Give a ``geom`` that we add to a scene MuJoCo's contacts, not those of the scene's class."""
    _copy(mujoco.MjSpec().worldbody.add_geom(), geom, CONTACT)


def unify_contacts(spec: Any) -> None:
    """Let all solid geoms of ``spec`` be solid for each other and for the robot.

    A geom is solid if it can collide with anything. Collision masks, priorities and margins that
    were chosen for the scene's own robot would let ours pass, slide or hover.
    """
    for geom in spec.geoms:
        if geom.contype or geom.conaffinity:
            make_solid(geom)


def make_solid(geom: Any) -> None:
    """Let ``geom`` collide with the robot and with loose objects."""
    geom.contype, geom.conaffinity = int(geom.contype) | 1, int(geom.conaffinity) | 1
    geom.priority, geom.margin, geom.gap = min(int(geom.priority), 0), 0.0, 0.0


def _names(values: Any) -> list[str]:
    """Return the names of the settings in ``values``."""
    return [
        name
        for name in dir(values)
        if not name.startswith("_") and not callable(getattr(values, name))
    ]


def _copy(source: Any, target: Any, names: Any) -> None:
    for name in names:
        setattr(target, name, getattr(source, name))
