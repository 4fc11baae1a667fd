"""Events that a script can wait for by command 158; Create Open Interface, page 16."""

from __future__ import annotations

from collections.abc import Callable

from scan3d_twin.devices.create.emulation.body import Body
from scan3d_twin.devices.create.packets import BumpsDrops, Mode, Packet

Event = Callable[[Body], bool]
"""Predicate on the robot's state."""

_DROPS = BumpsDrops.DROP_LEFT | BumpsDrops.DROP_RIGHT | BumpsDrops.DROP_CASTER
_BUMPS = BumpsDrops.BUMP_LEFT | BumpsDrops.BUMP_RIGHT
_CLIFFS = range(Packet.CLIFF_LEFT, Packet.VIRTUAL_WALL)


def _reading(packet: int) -> Event:
    return lambda body: bool(body.readings()[packet])


def _input(bit: int) -> Event:
    return lambda body: bool(body.inputs & bit)


EVENTS: dict[int, Event] = {
    1: lambda body: bool(body.bumps() & _DROPS),
    2: lambda body: bool(body.bumps() & BumpsDrops.DROP_CASTER),
    3: lambda body: bool(body.bumps() & BumpsDrops.DROP_LEFT),
    4: lambda body: bool(body.bumps() & BumpsDrops.DROP_RIGHT),
    5: lambda body: bool(body.bumps() & _BUMPS),
    6: lambda body: bool(body.bumps() & BumpsDrops.BUMP_LEFT),
    7: lambda body: bool(body.bumps() & BumpsDrops.BUMP_RIGHT),
    8: lambda body: body.virtual_wall,
    9: lambda body: bool(body.readings().get(Packet.WALL)),
    10: lambda body: body.cliff(),
    **{11 + k: _reading(packet) for k, packet in enumerate(_CLIFFS)},
    15: lambda body: bool(body.charger & 2),
    16: lambda body: bool(body.buttons & 4),
    17: lambda body: bool(body.buttons & 1),
    **{18 + k: _input(1 << k) for k in range(4)},
}
"""Predicates by event number; event 22 (mode is Passive) is tested in ``has_happened``."""
PASSIVE_EVENT = 22


def has_happened(event: int, body: Body, mode: Mode) -> bool:
    """Return whether ``event`` has happened; a negative number negates the event."""
    number = abs(event)
    if number == PASSIVE_EVENT:
        there = mode is Mode.PASSIVE
    else:
        there = number in EVENTS and EVENTS[number](body)
    return there == (event > 0)
