"""Viewpoint planning: the ``Planner`` protocol, the planners by name, and what they share.

Other packages add planners through the entry point group ``scan3d_twin.planners``: a name and a
class or factory that is called without arguments and returns a ``Planner``. One with a true
attribute ``needs_truth`` is called with the truth instead, and refused where there is none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Protocol

from scan3d_twin.core.errors import ConfigError, UnknownNameError

if TYPE_CHECKING:
    import numpy as np

    from scan3d_twin.core.model.evaluation import Truth
    from scan3d_twin.core.session import Session
    from scan3d_twin.core.types import Plan

ENTRY_POINTS = "scan3d_twin.planners"
"""Entry point group in which other packages offer planners."""


class Planner(Protocol):
    """Decides where to scan next.

    >>> class StayPut:
    ...     def plan(self, session, rng):
    ...         return s3d.Plan(None, 0.0, math.nan, False, (), "one view is enough")
    >>> planner: s3d.Planner = StayPut()
    >>> planner.plan(session, np.random.default_rng(0)).reason
    'one view is enough'
    """

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the plan for the next viewpoint, or one without a viewpoint to end the run.

        Pure: the same session and generator state give the same plan. The session has at least one
        view.
        """
        ...


@dataclass(frozen=True)
class Entry:
    """One planner that can be chosen by name.

    Attributes:
        build: Its class or factory; called with the truth if ``needs_truth``, else without
            arguments.
        summary: One line about it.
        needs_truth: Whether it plans on the truth, which only the twin knows.
    """

    build: Callable[..., Planner]
    summary: str
    needs_truth: bool = False

    @staticmethod
    def of(build: Callable[..., Planner]) -> Entry:
        """Return the entry of a class or factory, with the first line of its docstring."""
        summary = (build.__doc__ or "").strip().split("\n")[0]
        return Entry(build, summary, bool(getattr(build, "needs_truth", False)))


_BUILT_IN = {
    "curvature": "curvature:CurvaturePlanner",
    "fisher": "fisher:FisherPlanner",
    "fixed": "fixed:FixedPlanner",
    "fixed20": "fixed:fixed20",
    "fixed50": "fixed:fixed50",
    "fixed80": "fixed:fixed80",
    "frontier2d": "frontier2d:Frontier2dPlanner",
    "ig": "ig:IgPlanner",
    "oracle": "oracle:OraclePlanner",
    "pito": "pito:PitoPlanner",
    "random": "random_view:RandomPlanner",
    "roberts": "roberts:RobertsPlanner",
    "see": "see:SeePlanner",
    "siicp": "siicp:SiicpPlanner",
}
"""Built-in planners by name, loaded on demand: module in ``planners`` and class or factory."""


def list_planners() -> tuple[str, ...]:
    """Return the names that ``make_planner`` knows.

    >>> {"fisher", "siicp", "oracle"} <= set(s3d.list_planners())
    True
    """
    return tuple(sorted({*_BUILT_IN, *_find_external()}))


def summarise_planner(name: str) -> str:
    """Return one line about the planner ``name``; errors as for ``make_planner``."""
    return _load_entry(name).summary


def check_planner(name: str, *, truth_known: bool) -> None:
    """Check that a planner exists and can plan.

    Args:
        name: Name of the planner.
        truth_known: Whether there is a truth that it could plan on.

    Raises:
        UnknownNameError: There is no planner of this name.
        ConfigError: It needs the truth and there is none, or it cannot be loaded.
    """
    if truth_known and name in _BUILT_IN:
        return
    if _load_entry(name).needs_truth and not truth_known:
        raise ConfigError(
            f"planner {name} plans on the truth, which only the twin knows; "
            "use it with twin sim, or choose another one"
        )


def make_planner(name: str, truth: Truth | None = None) -> Planner:
    """Return the planner ``name``.

    Args:
        name: One of ``list_planners()``, or ``module:attribute`` of a class or factory of your own.
        truth: The truth, for planners that are bounds on the others, such as ``oracle``.

    Raises:
        UnknownNameError: There is no planner of this name.
        ConfigError: It needs the truth and there is none, or it cannot be loaded.

    >>> plan = s3d.make_planner("siicp").plan(session, np.random.default_rng(0))
    >>> plan.viewpoint is None or plan.overlap > 0.0
    True
    """
    check_planner(name, truth_known=truth is not None)
    entry = _load_entry(name)
    return entry.build(truth) if entry.needs_truth else entry.build()


def _load_entry(name: str) -> Entry:
    """Return the entry of the planner ``name``; errors as for ``make_planner``."""
    if name in _BUILT_IN:
        return Entry.of(resolve_name(f"{__name__}.planners.{_BUILT_IN[name]}"))
    others = _find_external()
    if name not in others and ":" not in name:
        raise UnknownNameError("planner", name, list_planners())
    place = others[name].value if name in others else name
    try:
        return Entry.of(resolve_name(place))
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"planner {name} ({place}) cannot be loaded: {error}") from None


def _find_external() -> dict[str, Any]:
    """Return the entry points of other packages by name; they cannot replace built-in ones."""
    found = entry_points(group=ENTRY_POINTS)
    return {point.name: point for point in found if point.name not in _BUILT_IN}
