"""The public names of scan3d_twin by the module that holds each; read at run time too."""

from .api.sessions import export_model as export_model
from .api.sessions import load_session as load_session
from .api.sim import run_sim as run_sim
from .core.config import Config as Config
from .core.digitize import digitize as digitize
from .core.errors import TwinError as TwinError
from .core.hal import Robot as Robot
from .core.model.evaluation import evaluate as evaluate
from .core.model.fused_cloud import Model as Model
from .core.model.fused_cloud import build_model as build_model
from .core.observer import Observer as Observer
from .core.observer import Unobserved as Unobserved
from .core.planning import (
    Planner as Planner,
)
from .core.planning import (
    list_planners as list_planners,
)
from .core.planning import (
    make_planner as make_planner,
)
from .core.registration import register as register
from .core.registration.pose_prior import PosePrior as PosePrior
from .core.session import Session as Session
from .core.session import View as View
from .core.types import (
    Plan as Plan,
)
from .core.types import (
    Pose2 as Pose2,
)
from .core.types import (
    RangeImage as RangeImage,
)
from .core.types import (
    RegistrationResult as RegistrationResult,
)
from .core.types import (
    Scan3D as Scan3D,
)
from .envs.policy import PlannerPolicy as PlannerPolicy
from .envs.policy import rollout as rollout
from .real.robot import open_real as open_real
from .sim.config import TwinConfig as TwinConfig
from .sim.robot import open_sim as open_sim
from .sim.scenes.load import load_scene as load_scene
from .sim.scenes.load import scene_names as scene_names

__version__: str
