from __future__ import annotations

import math
import sys
from dataclasses import dataclass, make_dataclass
from importlib.metadata import EntryPoint, EntryPoints
from typing import Literal

import numpy as np
import pytest
from sessions import PILASTERS, WALL, session_at

from scan3d_twin.core import planning
from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.planning import (
    check_planner,
    list_planners,
    make_planner,
    summarise_planner,
)
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan


class Stubborn:
    """Ends every scan at once.

    And nothing else.
    """

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        return Plan(None, 0.0, math.nan, False, (), "stubborn")


class Omniscient(Stubborn):
    """Knows the truth."""

    needs_truth = True

    def __init__(self, truth: object) -> None:
        self.truth = truth


@pytest.fixture
def plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another package that offers planners, one of them under a name of ours."""
    points = [
        EntryPoint("stubborn", f"{__name__}:Stubborn", planning.ENTRY_POINTS),
        EntryPoint("omniscient", f"{__name__}:Omniscient", planning.ENTRY_POINTS),
        EntryPoint("broken", "scan3d_twin.no_such_module:Planner", planning.ENTRY_POINTS),
        EntryPoint("fisher", f"{__name__}:Stubborn", planning.ENTRY_POINTS),
    ]
    monkeypatch.setattr(
        planning, "entry_points", lambda group: EntryPoints(points).select(group=group)
    )


def test_every_planner_has_one_line() -> None:
    for name in list_planners():
        text = summarise_planner(name)
        assert text.endswith("."), name
        assert "\n" not in text
        assert len(text) < 90


def test_the_names_of_the_paper_and_its_rivals() -> None:
    assert {"siicp", "fisher", "fixed", "fixed20", "fixed50", "fixed80"} <= set(list_planners())


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match="fixed20, fixed50"):
        make_planner("best")


@pytest.mark.usefixtures("plugins")
def test_another_package_adds_planners() -> None:
    assert "stubborn" in list_planners()
    assert summarise_planner("stubborn") == "Ends every scan at once."
    plan = make_planner("stubborn").plan(session_at(WALL), np.random.default_rng(0))
    assert plan.reason == "stubborn"


@pytest.mark.usefixtures("plugins")
def test_another_package_does_not_replace_ours() -> None:
    assert type(make_planner("fisher")).__name__ == "FisherPlanner"


@pytest.mark.usefixtures("plugins")
def test_a_plugin_that_does_not_load_is_a_wrong_name() -> None:
    with pytest.raises(ConfigError, match=r"broken .* cannot be loaded"):
        make_planner("broken")


@pytest.mark.usefixtures("plugins")
def test_the_truth_goes_to_those_alone_that_need_it() -> None:
    truth = object()
    assert make_planner("omniscient", truth).truth is truth  # type: ignore[arg-type, attr-defined]
    assert not hasattr(make_planner("stubborn", truth), "truth")  # type: ignore[arg-type]
    check_planner("omniscient", truth_known=True)
    with pytest.raises(ConfigError, match="only the twin knows"):
        check_planner("omniscient", truth_known=False)
    with pytest.raises(ConfigError, match="only the twin knows"):
        make_planner("omniscient")


@pytest.fixture(scope="module")
def wall() -> Session:
    """Return a session in front of a bare wall."""
    return session_at(WALL)


@pytest.fixture(scope="module")
def pilasters() -> Session:
    """Return a session in front of a wall with pilasters."""
    return session_at(PILASTERS)


@pytest.mark.parametrize("name", ["fixed", "fixed20", "fixed50", "fixed80", "pito", "curvature"])
def test_plans_are_pure_and_complete(name: str, pilasters: Session) -> None:
    a, b = (make_planner(name).plan(pilasters, np.random.default_rng(k)) for k in (0, 0))
    assert a == b
    assert a.viewpoint is not None
    assert a.candidates[-1].viewpoint == a.viewpoint
    assert a.candidates[-1].feasible
    assert a.predicted_rmse > 0
    assert a.reason


def returns_a_number() -> int:
    return 3


def fails() -> Stubborn:
    raise OSError("no weights")


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("a_dict", "it is no class or factory but {}"),
        ("Omniscient.__init__", "it is called with no argument: missing a required argument"),
        ("returns_a_number", "3 has no method plan"),
        ("fails", "OSError: no weights"),
    ],
)
def test_what_is_no_planner_is_refused_in_one_line(
    name: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "homemade", sys.modules[__name__])
    monkeypatch.setattr(sys.modules[__name__], "a_dict", {}, raising=False)
    with pytest.raises(
        ConfigError, match=r"^planner homemade:\S+ \(homemade.*cannot be loaded: "
    ) as told:
        make_planner(f"homemade:{name}")
    assert reason in str(told.value)
    assert "\n" not in str(told.value)


class Tunable(Stubborn):
    """Has options."""

    Options: type

    def __init__(self, options: object) -> None:
        self.options = options


def with_option(hint: object, default: object) -> type:
    return make_dataclass("Options", [("x", hint, default)], frozen=True)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (with_option(float | None, None), r"x of type float \| None; can be int, float, str"),
        (with_option(Literal[1, 2], 1), "x of type typing.Literal"),
        (with_option("Missing", 1), "type that is not known: name 'Missing'"),
        (make_dataclass("Options", [("x", float)]), "no default for x"),
        (int, "must be a dataclass"),
    ],
)
def test_options_that_words_cannot_state_are_refused(
    options: type, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "homemade", sys.modules[__name__])
    monkeypatch.setattr(Tunable, "Options", options, raising=False)
    with pytest.raises(ConfigError, match=rf"cannot be loaded: its Options .*{reason}"):
        make_planner("homemade:Tunable")


@pytest.mark.parametrize("text", ["inf", "nan", "-inf"])
def test_options_are_finite_even_without_bounds(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "homemade", sys.modules[__name__])
    monkeypatch.setattr(Tunable, "Options", with_option(float, 1.0), raising=False)
    assert make_planner("homemade:Tunable:x=2").options.x == 2.0  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match=rf"x must be finite, got {text}"):
        make_planner(f"homemade:Tunable:x={text}")


@dataclass(frozen=True)
class Even:
    x: int = 2

    def __post_init__(self) -> None:
        if self.x % 2:
            raise ValueError(f"{self.x} is odd")


def test_options_can_check_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "homemade", sys.modules[__name__])
    monkeypatch.setattr(Tunable, "Options", Even, raising=False)
    with pytest.raises(ConfigError, match=r"^options of planner homemade:Tunable: 3 is odd$"):
        make_planner("homemade:Tunable:x=3")


class Homemade:
    """Ends at once: a planner of somebody else's."""

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        return Plan(None, 0.0, 0.0, False, (), "homemade")


def test_a_planner_is_named_by_its_module_and_attribute(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "homemade", sys.modules[__name__])
    planner = make_planner("homemade:Homemade")
    assert type(planner).__name__ == "Homemade"
    with pytest.raises(ConfigError, match="cannot be loaded"):
        make_planner("homemade:Missing")
    with pytest.raises(ConfigError, match="cannot be loaded"):
        make_planner("no_such_module:Planner")
