"""Viewpoint planning: the ``Planner`` protocol, the planners by name, and what they share.

Other packages add planners by the entry point group ``scan3d_twin.planners``: a name, and something
that is called without arguments and returns a ``Planner`` (docs/extending.md). What has a true
attribute ``needs_truth`` is called with the truth, and is refused where nobody knows it. What has
options of its own has a frozen dataclass as its attribute ``Options``, and is called with one of
those last; its fields have defaults, and are int, float, str, bool or a Literal of texts. They are
stated with the name, as in ``patient:overlap=0.9:rest=true``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from importlib.metadata import entry_points
from inspect import signature
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args, get_origin, get_type_hints

from scan3d_twin.core.errors import ConfigError, TwinError, UnknownNameError
from scan3d_twin.core.options import parse_options
from scan3d_twin.core.plugins import PluginError, load_plugin

if TYPE_CHECKING:
    import numpy as np

    from scan3d_twin.core.model.truth import Truth
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
        build: Makes it; called with the truth if it ``needs_truth``, then with its options if it
            has any.
        summary: One line.
        needs_truth: Whether it plans on the truth, which only the twin knows.
        options: Dataclass of its own options; None if it has none.
    """

    build: Callable[..., Planner]
    summary: str
    needs_truth: bool = False
    options: type | None = None

    @staticmethod
    def of(build: Callable[..., Planner]) -> Entry:
        """Return the entry of a class or factory, with the first line of its docstring."""
        summary = (build.__doc__ or "").strip().split("\n")[0]
        needs_truth = bool(getattr(build, "needs_truth", False))
        return Entry(build, summary, needs_truth, getattr(build, "Options", None))

    def options_of(self, planner: str) -> tuple[Any, ...]:
        """Return the options that are stated with ``planner``'s name: one object, or none.

        Raises:
            ConfigError: There is no such option or value.
        """
        name, words = _split(planner)
        if self.options is not None:
            try:
                return (parse_options(self.options, words, f"planner {name}"),)
            except (TypeError, ValueError) as error:
                raise ConfigError(f"options of planner {name}: {error}") from error
        if words:
            raise ConfigError(f"planner {name} has no options of its own, got {':'.join(words)}")
        return ()


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
    entry = _load_entry(name)
    if entry.options is None:
        return entry.summary
    options = (f"{f.name}={f.default}" for f in fields(entry.options))
    return f"{entry.summary} Options: {', '.join(options)}."


def check_planner(name: str, *, truth_known: bool) -> None:
    """Check that a planner exists and can plan.

    Args:
        name: Name of the planner.
        truth_known: Whether there is a truth that it could plan on.

    Raises:
        UnknownNameError: There is none of this name.
        ConfigError: It needs the truth, has no such option, or cannot be loaded.
    """
    if truth_known and name in _BUILT_IN:
        return
    entry = _load_entry(name)
    entry.options_of(name)
    if entry.needs_truth and not truth_known:
        raise ConfigError(
            f"planner {name} plans on the truth, which only the twin knows; "
            "use it with twin sim, or choose another one"
        )


def make_planner(name: str, truth: Truth | None = None) -> Planner:
    """Return the planner ``name``.

    Args:
        name: One of ``list_planners()``, or ``module:attribute`` of a class or factory of your own;
            its options follow, as in ``patient:overlap=0.9``.
        truth: The truth, for planners that are bounds on the others, such as ``oracle``.

    Raises:
        UnknownNameError: There is none of this name.
        ConfigError: It needs the truth and there is none, it has no such option, or it cannot be
            loaded.

    >>> plan = s3d.make_planner("siicp").plan(session, np.random.default_rng(0))
    >>> plan.viewpoint is None or plan.overlap > 0.0
    True
    """
    check_planner(name, truth_known=truth is not None)
    entry = _load_entry(name)
    arguments = (truth,) if entry.needs_truth else ()
    return entry.build(*arguments, *entry.options_of(name))


def _split(planner: str) -> tuple[str, list[str]]:
    """Return the name in ``planner``, and the options that follow it."""
    parts = planner.split(":")
    words = [part for part in parts if "=" in part]
    return ":".join(part for part in parts if part not in words), words


def _load_entry(planner: str) -> Entry:
    """Return the entry of a planner named with its options; errors as for ``make_planner``."""
    name, _ = _split(planner)
    if name in _BUILT_IN:
        return Entry.of(resolve_name(f"{__name__}.planners.{_BUILT_IN[name]}"))
    others = _find_external()
    if name not in others and ":" not in name:
        raise UnknownNameError("planner", name, list_planners())
    place = others[name].value if name in others else name
    build = load_plugin("planner", name, place)
    if not callable(build):
        raise PluginError("planner", name, place, f"it is no class or factory but {build!r}")
    entry = Entry.of(build)
    if entry.options is not None and (fault := _find_fault(entry.options)):
        raise PluginError("planner", name, place, f"its Options {fault}")
    return _guard(entry, name, place)


def _find_fault(options: Any) -> str:
    """Return why words cannot state the fields of the class ``options``; empty if they can."""
    if not is_dataclass(options) or not isinstance(options, type):
        return "must be a dataclass"
    try:
        hints = get_type_hints(options)
    except (NameError, TypeError) as error:
        return f"have a type that is not known: {error}"
    for each in fields(options):
        hint = hints[each.name]
        texts = get_origin(hint) is Literal and all(isinstance(x, str) for x in get_args(hint))
        if hint not in (int, float, str, bool) and not texts:
            kinds = "int, float, str, bool or a Literal of texts"
            return f"have {each.name} of type {each.type}; can be {kinds}"
        if each.default is MISSING:
            return f"have no default for {each.name}"
    return ""


def _guard(entry: Entry, name: str, place: str) -> Entry:
    """Return the ``entry`` of another package's planner; its failures become ``PluginError``."""
    # Refuse what cannot be called as the protocol has it.
    wanted = ["the truth"] * entry.needs_truth + ["its Options"] * (entry.options is not None)
    try:
        signature(entry.build).bind(*wanted)
    except (TypeError, ValueError) as error:
        called = f"is called with {' and '.join(wanted) or 'no argument'}"
        raise PluginError("planner", name, place, f"it {called}: {error}") from error

    def build(*arguments: Any) -> Planner:
        try:
            planner = entry.build(*arguments)
        except TwinError:
            raise
        except Exception as error:
            raise PluginError("planner", name, place, error) from error
        if not callable(getattr(planner, "plan", None)):
            raise PluginError("planner", name, place, f"{planner!r} has no method plan")
        return planner

    return replace(entry, build=build)


def _find_external() -> dict[str, Any]:
    """Return the entry points of other packages by name; they cannot replace built-in ones."""
    found = entry_points(group=ENTRY_POINTS)
    return {point.name: point for point in found if point.name not in _BUILT_IN}
