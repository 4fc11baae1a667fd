"""Base of all environments: reset, step, reward, termination and truncation, infos."""

from __future__ import annotations

import math
import sys
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import error, spaces
from gymnasium.utils import EzPickle

from scan3d_twin.core.errors import ConfigError, ScanError, SceneError, TwinError
from scan3d_twin.core.planning.context import explain_view_limit
from scan3d_twin.core.presets import DEFAULT_PRESET
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan
from scan3d_twin.envs.episode import Episode
from scan3d_twin.envs.observations import TARGET_LOST, observation_space, observe
from scan3d_twin.envs.options import EnvOptions
from scan3d_twin.envs.render import Picture, draw_picture, format_blocks

Observation = dict[str, Any]
Action = TypeVar("Action")
MAX_SCENE_DRAWS = 20
"""Scenes drawn at most until the robot sees a target; it does in 98 of 100 random ones."""
LOST_VIEW_EPSILONS = 10.0
"""A view is lost if its registration error exceeds this many epsilon."""


class ViewPlanEnv(gymnasium.Env[Observation, Action], EzPickle, Generic[Action]):
    """View planning: a robot digitises a target, and an action chooses the next view.

    An episode starts after the first view. It terminates when the coverage reaches ``goal``, when
    the tour is complete, or on failure: a registration error above 10 epsilon, the target out of
    view, a bump. It is truncated after ``max_views`` views or when no viewpoint is feasible.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - as gymnasium has it
        "render_modes": ["human", "rgb_array"],
        "render_fps": 2,
    }

    def __init__(
        self,
        scene: str | Sequence[str] = "three_boxes",
        fidelity: str = "physics",
        *,
        preset: str = DEFAULT_PRESET,
        world: str = "typical",
        options: Mapping[str, Any] | None = None,
        rewards: Mapping[str, float] | None = None,
        goal: float = 0.95,
        ranges: Mapping[str, Any] | None = None,
        noise: Sequence[float] | None = None,
        render_mode: str | None = None,
    ) -> None:
        """Check the options; nothing is simulated before the first reset.

        Args:
            scene: Name as for ``load_scene``, or "random" for a new random scene in every episode;
                one of several is drawn for each episode.
            fidelity: physics, lite or kinematic.
            preset: Named options of the run: best or paper.
            world: Named errors of robot and sensor: ideal, typical, harsh or unfiltered.
            options: Nested options as in a configuration file; they override the preset.
            rewards: Weights of the reward terms by name; see ``RewardWeights``.
            goal: Coverage at which an episode is a success, 0..1.
            ranges: Fields of ``SceneRanges`` for random scenes.
            noise: Interval (low, high) of the factor on the lidar's errors.
            render_mode: human, rgb_array or None.

        Raises:
            ConfigError: An argument is invalid; the message lists the valid values.
        """
        EzPickle.__init__(
            self, scene, fidelity, preset=preset, world=world, options=options, rewards=rewards,
            goal=goal, ranges=ranges, noise=noise, render_mode=render_mode,
        )  # fmt: skip

        # Check the options.
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise error.UnsupportedMode(f"render_mode must be one of {modes}, got {render_mode!r}")
        self.render_mode = render_mode
        self.options = EnvOptions.of(
            scene, fidelity, preset, world, options, rewards, goal, ranges, noise
        )

        # Declare the observation space.
        self.observation_space = spaces.Dict({**observation_space(), **self.extra_spaces()})
        self._episode: Episode | None = None
        self._is_done = True

    # For subclasses.

    def extra_spaces(self) -> dict[str, spaces.Space[Any]]:
        """Return the observation spaces that this environment adds."""
        return {}

    def extra_observation(self) -> Observation:
        """Return the observations in ``extra_spaces``."""
        return {}

    @abstractmethod
    def update_actions(self) -> bool:
        """Update the feasible actions; return whether there is one."""

    @abstractmethod
    def plan_of_action(self, action: Action) -> tuple[Plan, bool]:
        """Return the plan of ``action``, and whether it stands in for an infeasible action."""

    @abstractmethod
    def action_of_plan(self, plan: Plan) -> Action:
        """Return the action nearest to ``plan``, which has a viewpoint."""

    def completion_reason(self) -> str | None:
        """Return why the tour is complete, or None."""
        return self.episode.context.termination_reason()

    # Gymnasium's interface.

    @property
    def episode(self) -> Episode:
        """The current episode.

        Raises:
            ResetNeeded: There is none before the first reset.
        """
        if self._episode is None:
            raise error.ResetNeeded("call reset before anything else")
        return self._episode

    def look(self) -> None:
        """Take a panorama, as planners may ask for, and update the feasible actions."""
        self.episode.look()
        self.update_actions()

    @property
    def session(self) -> Session:
        """The session of the current episode, which planners as policies read."""
        return self.episode.session

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode and take its first view.

        Args:
            seed: Seeds all randomness from now on.
            options: There are none.

        Raises:
            ConfigError: An option was given.
            ScanError, SceneError: No scene was found in which the robot sees a target.
        """
        if options:
            raise ConfigError(
                f"reset knows no options, got {', '.join(map(str, options))}; scene, fidelity and "
                "all else are arguments of gymnasium.make"
            )

        # Draw a scene with a visible target.
        super().reset(seed=seed)
        self.close()
        for attempt in range(MAX_SCENE_DRAWS):
            try:
                self._episode = self._begin()
                if self.episode.sees_target and self.update_actions():
                    break
            except (ScanError, SceneError):
                if attempt == MAX_SCENE_DRAWS - 1:
                    raise
        else:
            raise ScanError(f"in {MAX_SCENE_DRAWS} scenes no view was found that shows the target")

        # Return the first observation.
        self._is_done = False
        if self.render_mode == "human":
            self.render()
        return self._observation(), self._info({}, 0.0)

    def _begin(self) -> Episode:
        prepared = self.options.draw_scene(self.np_random)
        source, seed = self.options.open_source(prepared, self.np_random)
        try:
            return Episode(prepared, source, seed)
        except BaseException:
            source.close()
            raise

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive to the viewpoint of ``action``, scan there and return the reward.

        Raises:
            InvalidAction: The action is not in the action space.
            ResetNeeded: The episode is over.
        """
        if self._is_done:
            raise error.ResetNeeded("the episode is over: call reset")
        if not self.action_space.contains(action):
            raise error.InvalidAction(f"{action!r} is not in {self.action_space}")

        # Drive and scan.
        plan, substituted = self.plan_of_action(action)
        episode, before = self.episode, self.episode.score.coverage
        driven, failure = episode.source.driven, ""
        try:
            episode.go(plan)
        except TwinError as reason:
            failure = f"{type(reason).__name__}: {reason}"
        if not failure:
            failure = self._lost_view_reason()
        ended = "" if failure else (self.completion_reason() or "")
        if ended.startswith(TARGET_LOST):
            failure = ended

        # Sum up the reward terms.
        coverage = episode.score.coverage
        terms = self.options.weights.terms(
            coverage - before,
            episode.source.driven - driven,
            misplaced=self._registration_error() > episode.session.config.planning.epsilon,
            failed=bool(failure),
        )

        # Decide on termination and truncation.
        done = coverage >= self.options.goal or bool(failure)
        complete = bool(ended) and ended != explain_view_limit(self.session)
        terminated = done or complete
        truncated = not terminated and (bool(ended) or not self.update_actions())
        self._is_done = terminated or truncated

        # Report the metrics.
        info = self._info(terms, plan.overlap)
        info["substituted"] = substituted
        if self._is_done:
            info["ended"] = failure or ended or self._end_reason(coverage)
            info["f20"] = episode.score.f_score(episode.session)
        if self.render_mode == "human":
            self.render()
        return self._observation(), float(sum(terms.values())), terminated, truncated, info

    def _end_reason(self, coverage: float) -> str:
        reached = coverage >= self.options.goal
        return "goal reached" if reached else "no viewpoint is feasible"

    def _registration_error(self) -> float:
        errors = self.episode.score.errors
        return errors[-1] if errors else 0.0

    def _lost_view_reason(self) -> str:
        """Return a message if the latest view is lost, judged by the truth, else ""."""
        if self._registration_error() <= LOST_VIEW_EPSILONS * self.session.config.planning.epsilon:
            return ""
        return f"view lost: registered {1e3 * self._registration_error():.0f} mm off"

    def _observation(self) -> Observation:
        return {**observe(self.episode.context), **self.extra_observation()}

    def _info(self, terms: dict[str, float], overlap: float) -> dict[str, Any]:
        """Return the metrics, some of them by the truth."""
        episode = self.episode
        registration = self.session.views[-1].registration
        return {
            "reward_terms": terms,
            "coverage": episode.score.coverage,
            "is_success": episode.score.coverage >= self.options.goal,
            "e_reg": self._registration_error(),
            "E_pred": -1.0
            if registration is None
            else _finite_or_unknown(registration.predicted_rmse),
            "eta": overlap,
            "views": len(self.session.views),
            "path_m": episode.source.driven,
            "sim_time": episode.source.time,
            "scene": episode.prepared.scene.name,
            "run_seed": self.session.seed,
        }

    def render(self) -> Picture | None:
        """Return the top view (256, 256, 3), or print it in mode human."""
        if self.render_mode is None:
            gymnasium.logger.warn("render without a render_mode: give one to make()")
            return None
        image = draw_picture(self.session, self.episode.costmap)
        if self.render_mode == "rgb_array":
            return image
        sys.stdout.write(format_blocks(image))
        return None

    def close(self) -> None:
        """Stop the robot and end the episode."""
        if self._episode is not None:
            self._episode.close()
        self._episode, self._is_done = None, True


def _finite_or_unknown(value: float) -> float:
    """Return ``value``, or -1 if it is not finite: unlike NaN, infos must equal themselves."""
    return value if math.isfinite(value) else -1.0


Mask = npt.NDArray[np.int8]
