"""What all environments share: an episode per reset, a view per step, terms and metrics."""

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
from scan3d_twin.core.presets import DEFAULT_PRESET
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan
from scan3d_twin.envs.episode import Episode
from scan3d_twin.envs.observations import LOST, observation_space, observe
from scan3d_twin.envs.options import EnvOptions
from scan3d_twin.envs.render import Picture, blocks, picture

Observation = dict[str, Any]
Action = TypeVar("Action")
TRIES = 20
"""Scenes that are drawn until the robot finds a target it can look at; 98 of 100 random ones do."""
LOST_AT = 10.0
"""A registration error of so many epsilon is a lost view."""


class ViewPlanEnv(gymnasium.Env[Observation, Action], EzPickle, Generic[Action]):
    """A robot digitises a target; an action decides on the next view.

    An episode begins after the first view. It terminates when the coverage reaches ``goal``, when
    the tour is complete, or by a failure: a registration error above 10 epsilon, the target out of
    view, a bump. It is truncated after ``max_views`` views, or when no viewpoint is feasible.
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
            scene: As for ``load_scene``; "random" is a new random scene in every episode; of
                several one is drawn.
            fidelity: physics, lite or kinematic.
            preset: Named options of the run: best or paper.
            world: Named errors of robot and sensor: ideal, typical or harsh.
            options: Nested options as in a configuration file, over the preset's.
            rewards: Weights of the reward's terms by name; see ``RewardWeights``.
            goal: Coverage at which an episode is a success, 0..1.
            ranges: Fields of ``SceneRanges`` for random scenes.
            noise: Interval (low, high) of the factor on the lidar's errors.
            render_mode: human, rgb_array or None.

        Raises:
            ConfigError: One of them is wrong; the message lists what is valid.
        """
        EzPickle.__init__(
            self, scene, fidelity, preset=preset, world=world, options=options, rewards=rewards,
            goal=goal, ranges=ranges, noise=noise, render_mode=render_mode,
        )  # fmt: skip
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise error.UnsupportedMode(f"render_mode must be one of {modes}, got {render_mode!r}")
        self.render_mode = render_mode
        self.options = EnvOptions.of(
            scene, fidelity, preset, world, options, rewards, goal, ranges, noise
        )
        self.observation_space = spaces.Dict({**observation_space(), **self.own_space()})
        self._episode: Episode | None = None
        self._over = True

    # What an environment adds.

    def own_space(self) -> dict[str, spaces.Space[Any]]:
        """Return the spaces that only this environment has."""
        return {}

    def own_values(self) -> Observation:
        """Return the values of ``own_space``."""
        return {}

    @abstractmethod
    def prepare(self) -> bool:
        """Work out what can be done next; tell whether there is anything."""

    @abstractmethod
    def decode(self, action: Action) -> tuple[Plan, bool]:
        """Return the plan of ``action``, and whether it is a substitute for what was meant."""

    @abstractmethod
    def encode(self, plan: Plan) -> Action:
        """Return the action nearest to ``plan``, which has a viewpoint."""

    def complete(self) -> str | None:
        """Return why the tour is over, or None."""
        return self.episode.context.termination_reason()

    # The environment.

    @property
    def episode(self) -> Episode:
        """The episode under way.

        Raises:
            ResetNeeded: There is none.
        """
        if self._episode is None:
            raise error.ResetNeeded("call reset before anything else")
        return self._episode

    def look(self) -> None:
        """Look around from here, as planners may ask for, and see anew what can be done."""
        self.episode.look()
        self.prepare()

    @property
    def session(self) -> Session:
        """What the robot knows: for planners as policies."""
        return self.episode.session

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode and take its first view.

        Args:
            seed: Of all chance from now on.
            options: None are known.

        Raises:
            ConfigError: There is one.
            ScanError, SceneError: No scene was found in which the robot sees a target.
        """
        if options:
            raise ConfigError(
                f"reset knows no options, got {', '.join(map(str, options))}; scene, fidelity and "
                "all else are arguments of gymnasium.make"
            )
        super().reset(seed=seed)
        self.close()
        for attempt in range(TRIES):
            try:
                self._episode = self._begin()
                if self.episode.sees_target and self.prepare():
                    break
            except (ScanError, SceneError):
                if attempt == TRIES - 1:
                    raise
        else:
            raise ScanError(f"in {TRIES} scenes no view was found that shows the target")
        self._over = False
        if self.render_mode == "human":
            self.render()
        return self._observation(), self._info({}, 0.0)

    def _begin(self) -> Episode:
        stage = self.options.stage(self.np_random)
        scout, seed = self.options.scout(stage, self.np_random)
        try:
            return Episode(stage, scout, seed)
        except BaseException:
            scout.close()
            raise

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Go where ``action`` says and scan there.

        Raises:
            InvalidAction: It does not lie in the action space.
            ResetNeeded: The episode is over.
        """
        if self._over:
            raise error.ResetNeeded("the episode is over: call reset")
        if not self.action_space.contains(action):
            raise error.InvalidAction(f"{action!r} is not in {self.action_space}")
        plan, substituted = self.decode(action)
        episode, before = self.episode, self.episode.score.coverage
        driven, failure = episode.scout.driven, ""
        try:
            episode.go(plan)
        except TwinError as reason:
            failure = f"{type(reason).__name__}: {reason}"
        if not failure:
            failure = self._lost()
        ended = "" if failure else (self.complete() or "")
        if ended.startswith(LOST):
            failure = ended
        coverage = episode.score.coverage
        terms = self.options.weights.terms(
            coverage - before,
            episode.scout.driven - driven,
            misplaced=self._error() > episode.session.config.planning.epsilon,
            failed=bool(failure),
        )
        done = coverage >= self.options.goal or bool(failure)
        complete = bool(ended) and not ended.startswith("max_views")
        terminated = done or complete
        truncated = not terminated and (bool(ended) or not self.prepare())
        self._over = terminated or truncated
        info = self._info(terms, plan.overlap)
        info["substituted"] = substituted
        if self._over:
            info["ended"] = failure or ended or self._why(coverage)
            info["f20"] = episode.score.f_score(episode.session)
        if self.render_mode == "human":
            self.render()
        return self._observation(), float(sum(terms.values())), terminated, truncated, info

    def _why(self, coverage: float) -> str:
        reached = coverage >= self.options.goal
        return "goal reached" if reached else "no viewpoint is feasible"

    def _error(self) -> float:
        errors = self.episode.score.errors
        return errors[-1] if errors else 0.0

    def _lost(self) -> str:
        """Return that the latest view is lost, by the truth, or nothing."""
        if self._error() <= LOST_AT * self.session.config.planning.epsilon:
            return ""
        return f"view lost: registered {1e3 * self._error():.0f} mm off"

    def _observation(self) -> Observation:
        return {**observe(self.episode.context), **self.own_values()}

    def _info(self, terms: dict[str, float], overlap: float) -> dict[str, Any]:
        """Return the metrics; they know the truth."""
        episode = self.episode
        registration = self.session.views[-1].registration
        return {
            "reward_terms": terms,
            "coverage": episode.score.coverage,
            "is_success": episode.score.coverage >= self.options.goal,
            "e_reg": self._error(),
            "E_pred": -1.0 if registration is None else _known(registration.predicted_rmse),
            "eta": overlap,
            "views": len(self.session.views),
            "path_m": episode.scout.driven,
            "sim_time": episode.scout.time,
            "scene": episode.stage.scene.name,
            "run_seed": self.session.seed,
        }

    def render(self) -> Picture | None:
        """Return the top view (256, 256, 3), or print it in mode human; see ``render.py``."""
        if self.render_mode is None:
            gymnasium.logger.warn("render without a render_mode: give one to make()")
            return None
        image = picture(self.session, self.episode.costmap)
        if self.render_mode == "rgb_array":
            return image
        sys.stdout.write(blocks(image))
        return None

    def close(self) -> None:
        """Stop the robot and forget the episode."""
        if self._episode is not None:
            self._episode.close()
        self._episode, self._over = None, True


def _known(value: float) -> float:
    """Return ``value``, or -1 where it is not finite: infos have to equal themselves."""
    return value if math.isfinite(value) else -1.0


Mask = npt.NDArray[np.int8]
