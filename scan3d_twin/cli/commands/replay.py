"""``twin replay``: repeat registration and planning on recorded sweeps."""

from __future__ import annotations

import json as json_module
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from scan3d_twin.cli.dotted import dotted_options, stated
from scan3d_twin.cli.output import say
from scan3d_twin.core.config import Config, preset_options
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.run.settings import (
    Options,
    Settings,
    build_settings,
    merge_options,
    read_settings,
)

if TYPE_CHECKING:
    DottedOptions = Any
else:
    DottedOptions = dotted_options(Config)

AS_RECORDED = Parameter(show_default=lambda _: "as recorded")
_HEADER = (
    "view", "moved", "turned", "overlap was", "overlap now", "predicted was", "predicted now",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """Options that replace recorded ones; None is as recorded."""

    epsilon: Annotated[float | None, AS_RECORDED] = None
    """Wanted registration error, root mean square [mm]."""
    tour: Annotated[Literal["front", "full"] | None, AS_RECORDED] = None
    """Scan the front or all round."""
    planner: Annotated[str | None, AS_RECORDED] = None
    """Viewpoint planner (`twin planners`)."""
    preset: Annotated[str | None, AS_RECORDED] = None
    """Named set of options: paper or best."""
    config: Path | None = None
    """TOML file of options; the command line overrides it."""
    json: bool = False
    """Print one JSON document instead of a table."""


def replay(
    folder: Path,
    /,
    *,
    options: Annotated[ReplayOptions, Parameter(name="*")] = ReplayOptions(),
    dotted: Annotated[DottedOptions | None, Parameter(name="*")] = None,
) -> None:
    """Repeat registration and planning on a recorded run, and list what differs.

    With the recorded options all poses and plans are identical, bit by bit. With other options
    the robot's path stays as recorded; the table shows the poses that would have come of it, and
    for each view the plan that would have led to it. The default of each option is the recorded
    value.

    Args:
        folder: Folder of a run, or its session file.
        options: Options that replace recorded ones.
        dotted: Likewise, by section.
    """
    from scan3d_twin.cli.progress import make_progress, steps
    from scan3d_twin.core.planning import make_planner
    from scan3d_twin.recording.load import load_session
    from scan3d_twin.recording.replay import replay as run_again

    recorded = load_session(folder)
    effective = _effective(recorded.settings, options, {} if dotted is None else stated(dotted))
    session = recorded.before_end
    planner = make_planner(effective.config.planner, None)
    with make_progress() as progress:
        step = steps(progress, "replayed view", len(session.views))
        again = run_again(session, effective.config, planner, step)
    found = _findings(recorded.session, session, again, recorded.settings, effective)
    say(json_module.dumps(found, indent=2) if options.json else _words(found), sys.stdout)


def _effective(recorded: Settings, options: ReplayOptions, sections: Options) -> Settings:
    """Return the recorded settings under the preset, the file and what is stated."""
    from scan3d_twin.run.settings import settings_toml

    top = {"tour": options.tour, "planner": options.planner}
    flat: dict[str, Any] = {name: value for name, value in top.items() if value is not None}
    if options.epsilon is not None:
        if "epsilon" in sections.get("planning", {}):
            raise ConfigError("--epsilon [mm] and --planning.epsilon [m] are the same; give one")
        flat["planning"] = {"epsilon": options.epsilon / 1e3}
    return build_settings(
        [
            tomllib.loads(settings_toml(recorded)),
            {} if options.preset is None else preset_options(options.preset),
            {} if options.config is None else read_settings(options.config),
            merge_options([sections, flat]),
        ]
    )


def _findings(
    recorded: Any, before: Any, again: Any, old: Settings, new: Settings
) -> dict[str, Any]:
    from scan3d_twin.recording.exact_json import are_equal
    from scan3d_twin.recording.replay import compare_last_plans, compare_sessions, finish_replay

    ended = finish_replay(again, recorded)
    same_end = are_equal((ended.views, ended.misfits), (recorded.views, recorded.misfits))
    rows, last = compare_sessions(before, again), compare_last_plans(before, again)
    compared = rows if last is None else [*rows, last]
    return {
        "identical": same_end and all(row["identical"] for row in compared),
        "identical_at_the_end": same_end,
        "options": _changes(old, new),
        "views": rows,
        "last_plan": last,
    }


def _changes(old: Settings, new: Settings) -> dict[str, list[Any]]:
    """Return the options that differ, by name: as recorded, and now."""
    from scan3d_twin.run.settings import settings_toml

    before, now = (dict(_flat(tomllib.loads(settings_toml(each)))) for each in (old, new))
    return {name: [before[name], now[name]] for name in now if before.get(name) != now[name]}


def _flat(options: Options, where: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for name, value in options.items():
        inner = isinstance(value, dict)
        rows += _flat(value, f"{where}{name}.") if inner else [(where + name, value)]
    return rows


def _words(found: dict[str, Any]) -> str:
    """Return the findings as lines."""
    from scan3d_twin.cli.summary import LENGTH, SHARE, format_cell, format_table

    lines = [f"{name}: {a} recorded, {b} now" for name, (a, b) in found["options"].items()]

    # Compare the views, each with the plan that led to it
    rows = []
    for row in found["views"]:
        then, now = row["recorded"], row["replayed"]
        cells = [
            str(row["view"]),
            format_cell(row["moved_mm"], "{:g} mm"),
            format_cell(row["turned_deg"], "{:g} deg"),
            *(format_cell(each["overlap"], SHARE) for each in (then, now)),
            *(format_cell(each["predicted_rmse_mm"], LENGTH) for each in (then, now)),
        ]
        rows.append(cells if row["identical"] else [*cells, "differs"])
    lines += format_table(_HEADER, rows)

    # Compare what came after them
    last = found["last_plan"]
    if last is not None:
        then, now = _plan_words(last["recorded"]), _plan_words(last["replayed"])
        change = then if last["identical"] else f"was {then}; now {now}"
        lines.append(f"plan after the last view: {change}")
    lines.append(_verdict(found))
    return "\n".join(lines)


def _plan_words(plan: dict[str, Any]) -> str:
    """Return the plan after the last view in words."""
    if plan["viewpoint"] is None:
        return f"none ({plan['reason']})"
    from scan3d_twin.cli.summary import LENGTH, SHARE, format_cell

    overlap = format_cell(plan["overlap"], SHARE)
    error = format_cell(plan["predicted_rmse_mm"], LENGTH)
    return f"{overlap} overlap, predicted error {error} ({plan['reason']})"


def _verdict(found: dict[str, Any]) -> str:
    """Return what differs, in a line."""
    if found["identical"]:
        return "all poses and plans are identical, bit by bit"
    differing = sum(not row["identical"] for row in found["views"])
    verdict = f"{differing} of {len(found['views'])} views differ"
    if found["last_plan"] is not None and not found["last_plan"]["identical"]:
        verdict += "; the plan after the last view differs"
    if not found["identical_at_the_end"]:
        verdict += "; the final poses differ"
    return verdict
