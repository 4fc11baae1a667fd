"""Several runs side by side: what was asked, what came of it, and how far apart the models are."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.model.evaluation import Distances
from scan3d_twin.core.model.fused_cloud import Model, build_model
from scan3d_twin.core.registration import register
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.recording.load import RecordedRun, load_session, run_folder
from scan3d_twin.recording.overview.listing import REPORT, read_report_or_state
from scan3d_twin.run.folder import readable
from scan3d_twin.run.report import Report
from scan3d_twin.run.settings import settings_toml

_REPORTED = (
    "scene", "seed", "planner", "epsilon_mm", "views", "stop_reason", "points", "coverage_20mm",
    "coverage_by_view", "max_registration_error_mm", "path_m", "sim_time_s", "warnings",
)  # fmt: skip
"""Keys of a report that a comparison repeats."""
VOXEL = 0.01
"""Side of the voxels of the models that are compared [m]; half of what counts as covered."""
MAX_DISTANCE = 0.10
"""Distance beyond which a place is in one model only, and no error of the other [m]."""


@dataclass(frozen=True, eq=False)
class ComparedRun:
    """A run beside the first one.

    Attributes:
        name: Its folder, as far as the names differ.
        options: Its effective options by dotted name.
        report: Its ``report.json``; empty where there is none.
        session: Its views.
        model: Its model, in the frame ``world`` of the first run.
        T_first_own: From its own ``world`` to that of the first run.
        distances: From each point to the nearest of the first run's model (n,) [m]; infinite beyond
            ``MAX_DISTANCE``. Of the first run: to the nearest of the second.
        apart: Statistics of the finite ones; None where the models could not be laid on each other.
        in_both: Share of the points with a finite distance.
    """

    name: str
    options: Mapping[str, Any]
    report: Report
    session: Session
    model: Model
    T_first_own: Pose2
    distances: FloatArray
    apart: Distances | None
    in_both: float


def compare_runs(places: Sequence[Path]) -> list[ComparedRun]:
    """Return the runs in the folders or session files ``places``, the first one as reference.

    The models are laid on the first one by registration without a prior, since each run has its
    own frame ``world``.

    Raises:
        ConfigError: They are fewer than two.
        FileError: One of them cannot be read.
    """
    if len(places) < 2:
        raise ConfigError(f"a comparison takes at least two runs, got {len(places)}")
    runs = [load_session(place) for place in places]
    names = _tell_apart([run_folder(place).resolve() for place in places])
    models = [build_model(run.session, VOXEL) for run in runs]

    # Lay each model on the first one
    poses = [Pose2(), *(_lay_on(models[0], model) for model in models[1:])]
    laid = [_moved(model, pose) for model, pose in zip(models, poses, strict=True)]
    return [
        _compare(names[k], run, laid[k], laid[1] if k == 0 else laid[0], poses[k] or Pose2())
        if (poses[k] if k else poses[1]) is not None
        else _unrelated(names[k], run, laid[k])
        for k, run in enumerate(runs)
    ]


def find_differences(runs: Sequence[ComparedRun]) -> dict[str, list[Any]]:
    """Return the options by dotted name that are not the same in all ``runs``, with the values."""
    keys = sorted({key for run in runs for key in run.options})
    values = {key: [run.options.get(key) for run in runs] for key in keys}
    return {key: each for key, each in values.items() if any(one != each[0] for one in each)}


def summarise(runs: Sequence[ComparedRun]) -> dict[str, Any]:
    """Return the comparison as plain values, in millimetres and seconds, for JSON and tables."""
    return {
        "runs": [
            {
                "name": run.name,
                **{key: run.report.get(key) for key in _REPORTED},
                "accuracy_median_mm": (run.report.get("accuracy_mm") or {}).get("median"),
                "distance_mm": None if run.apart is None else _millimetres(run.apart),
                "in_both": round(run.in_both, 4),
            }
            for run in runs
        ],
        "differences": find_differences(runs),
    }


def _millimetres(distances: Distances) -> dict[str, float]:
    return {key: round(1e3 * value, 2) for key, value in asdict(distances).items()}


def _tell_apart(folders: Sequence[Path]) -> list[str]:
    """Return the shortest ends of the paths that differ; whole paths if two are the same."""
    for depth in range(1, max(len(folder.parts) for folder in folders)):
        names = [readable("/".join(folder.parts[-depth:])) for folder in folders]
        if len(set(names)) == len(names):
            return names
    return [readable(folder) for folder in folders]


def _lay_on(target: Model, source: Model) -> Pose2 | None:
    """Return ``T_target_source``, or None where they do not fit on each other."""
    try:
        result = register(target.points, source.points)
    except RegistrationError:
        return None
    return Pose2.from_matrix(result.T_target_source) if result.converged else None


def _moved(model: Model, pose: Pose2 | None) -> Model:
    if pose is None:
        return model
    return Model(pose.apply(model.points), pose.rotate(model.normals), model.sigma, model.view)


def _compare(
    name: str, run: RecordedRun, model: Model, other: Model, T_first_own: Pose2
) -> ComparedRun:
    distances, _ = Tree.of(other.points).closest(model.points, MAX_DISTANCE)
    near = distances[np.isfinite(distances)]
    return ComparedRun(
        name, _options(run), _report(run), run.session, model, T_first_own, distances,
        Distances.of(near) if len(near) else None, len(near) / max(1, len(distances)),
    )  # fmt: skip


def _unrelated(name: str, run: RecordedRun, model: Model) -> ComparedRun:
    """Return a run whose model does not fit on the first one's."""
    nowhere = np.full(len(model), np.inf)
    return ComparedRun(
        name,
        _options(run),
        read_report_or_state(run_folder(run.path) / REPORT)[0],
        run.session,
        model,
        Pose2(),
        nowhere,
        None,
        0.0,
    )


def _report(run: RecordedRun) -> Report:
    return read_report_or_state(run_folder(run.path) / REPORT)[0]


def _options(run: RecordedRun) -> dict[str, Any]:
    """Return the effective options of ``run`` by dotted name."""
    return dict(_flatten(tomllib.loads(settings_toml(run.settings)), ""))


def _flatten(table: Mapping[str, Any], where: str) -> list[tuple[str, Any]]:
    found = []
    for key, value in table.items():
        name = f"{where}{key}"
        found += _flatten(value, f"{name}.") if isinstance(value, dict) else [(name, value)]
    return found
