"""A scene's global settings and default classes do not reach the robot, setting by setting."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from scan3d_twin.core.errors import SceneError
from scan3d_twin.sim.config import IDEAL_ROBOT
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.world import PREFIX, RobotErrors, build_model

BODY = """<worldbody>
  <site name="spawn" pos="-1.5 0 0"/>
  <body name="target" pos=".3 0 .3">
    <geom type="box" size=".3 .3 .3"/>
    <geom name="visual" type="box" size=".1 .1 .1" pos="0 0 .4" contype="0" conaffinity="0"/>
    <body name="part" pos="0 0 .5"><geom type="sphere" size=".1"/></body>
  </body>
  <body name="arm" pos="1 1 .5">
    <joint name="hinge" axis="0 1 0" range="-1 1" limited="true"/>
    <geom type="capsule" size=".05 .2"/>
  </body>
  <body name="ball" pos="1 -1 .1"><freejoint/><geom size=".1"/></body>
</worldbody>
<actuator><position name="motor" joint="hinge"/></actuator>
<keyframe><key name="bent" qpos=".5 1 -1 .1 1 0 0 0"/></keyframe>"""
"""A scene with something for each setting: joints, visual and static parts, a loose ball."""

VALUES = {
    "real": ("0.5",),
    "real(3)": ("1 2 3",),
    "int": ("1", "3"),
    "int(2)": ("1 2",),
    "int(31)": ("0", "0 1 2"),
    "string": ("other",),
    "option-o_solref": (".1 1",),
    "option-o_solimp": (".1 .2 .01 .5 2",),
    "option-o_friction": (".1 .1 .1 .1 .1",),
    "compiler-eulerseq": ("zyx",),
}
"""Values by the type of a setting, or by its name."""

REFUSED = {"compiler-coordinate"}
"""Settings that MuJoCo itself refuses."""

_ENTRY = re.compile(
    r"\.\. _((?:option|compiler)-[\w-]+):\n\n:at:`\w+`(?:, :at:`\w+`)*: ?:at-val:`([^`]*)`"
)


def settings() -> list[tuple[str, str]]:
    """Return each setting of MuJoCo's schema with each of its values but the default."""
    docs = Path(mujoco.__file__).parent / "doc"
    reference = dict(_ENTRY.findall((docs / "XMLreference.rst").read_text()))
    schema = re.findall(r"<((?:option|compiler)-[\w-]+)>", (docs / "XMLschema.rst").read_text())
    found = []
    for name in sorted(set(schema) - {"option-flag", "compiler-lengthrange"}):
        kind, _, default = reference.get(name, "").partition(', "')
        if kind.startswith("["):
            values = [each.strip() for each in kind.strip("[]").split(",")]
            values.remove(default.partition('"')[0])
        else:
            values = list(VALUES.get(name) or VALUES[kind.partition(", ")[0]])
        found += [(name, value) for value in values]
    return found


def scene_xml(setting: str = "", value: str = "") -> str:
    """Return the scene with one setting."""
    element, *inner, name = setting.split("-") if setting else ("", "")
    head = f'{name}="{value}"'
    for tag in (*inner, element):
        head = f"<{tag} {head}/>" if not head.startswith("<") else f"<{tag}>{head}</{tag}>"
    return f"<mujoco>{head if setting else ''}{BODY}</mujoco>"


def fingerprint(path: Path, text: str) -> dict[str, bytes]:
    """Return all numbers of the scene's model and of its physics."""
    path.write_text(text)
    scene = load_scene(str(path))
    robot = RobotErrors.draw(IDEAL_ROBOT, np.random.default_rng(0))
    model = build_model(scene, "create2", robot)
    found = {"spawn": repr(scene.spawn).encode()}
    for part, values in (("scene", scene.model), ("physics", model), ("option", model.opt)):
        for name in dir(values):
            value = None if name.startswith("_") else getattr(values, name)
            if isinstance(value, np.ndarray | int | float):
                found[f"{part}.{name}"] = np.asarray(value).tobytes()
    return found


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return fingerprint(tmp_path_factory.mktemp("plain") / "scene.xml", scene_xml())


@pytest.mark.filterwarnings("ignore:.*deprecated")
@pytest.mark.parametrize(("setting", "value"), settings())
def test_a_setting_changes_nothing_or_is_refused_by_name(plain, tmp_path, setting, value):
    text, name = scene_xml(setting, value), setting.rpartition("-")[2]
    if setting in REFUSED:
        with pytest.raises(SceneError, match=name):
            fingerprint(tmp_path / "scene.xml", text)
        return
    found = fingerprint(tmp_path / "scene.xml", text)
    assert {name for name in plain if found[name] != plain[name]} == set()


def test_most_settings_are_taken():
    assert len(settings()) > 95


ADVERSE = """<default>
  <geom contype="0" conaffinity="0" friction="0.01 0.005 0.0001" density="10" condim="1"
        margin="0.02" gap="0.01" solref="0.1 1" solimp=".1 .2 .01 .5 2" priority="5" group="3"/>
  <joint damping="50" armature="5" stiffness="9" frictionloss="3" limited="true" range="0 .1"/>
  <site type="box" size="1 1 1"/>
  <general ctrllimited="true" ctrlrange="-0.1 0.1" gear="3"/>
  <velocity kv="9"/><intvelocity kp="1"/><dcmotor motorconst="1 1" resistance="2" cogging="1 2 3"/>
</default>"""
EXPLICIT = """<worldbody><site name="spawn" pos="-1.5 0 0" type="sphere" size=".1 .1 .1"/>
<geom name="target" type="box" size=".3 .3 .3" pos=".3 0 .3" density="1000"
      friction="1 .005 .0001" condim="3" solref=".02 1" solimp=".9 .95 .001 .5 2" group="0"
      contype="1" conaffinity="1"/></worldbody>"""


def test_default_classes_reach_neither_the_robot_nor_the_floor_that_is_added(tmp_path):
    plain = fingerprint(tmp_path / "a.xml", f"<mujoco>{EXPLICIT}</mujoco>")
    found = fingerprint(tmp_path / "a.xml", f"<mujoco>{ADVERSE}{EXPLICIT}</mujoco>")
    assert {name for name in plain if found[name] != plain[name]} == set()


@pytest.mark.parametrize("attribute", ['margin=".05"', 'priority="3"', 'contype="0"', 'gap=".01"'])
def test_contacts_that_a_floor_states_do_not_lift_or_drop_the_robot(scene_of, attribute):
    scene = scene_of(
        f'<geom name="floor" type="plane" size="5 5 .1" conaffinity="2" {attribute}/>'
        '<geom name="target" size=".1" pos="2 0 .1"/>'
    )
    with open_sim(scene, 0) as (robot, truth):
        robot.base.set_velocity(0.2, 0.0)
        robot.clock.sleep(1.5)
        moved = truth.pose_at(1.5).distance(truth.spawn)
        odometry = robot.base.odometry().T_odom_base.x
    assert moved == pytest.approx(odometry, rel=0.1)
    assert moved > 0.2


def test_a_geom_that_only_meets_other_masks_is_solid_for_the_robot(scene_of):
    scene = scene_of(
        '<geom name="target" type="box" size=".1 .5 .3" pos=".4 0 .3" contype="4" conaffinity="2"/>'
    )
    model = build_model(scene, "create2", RobotErrors.draw(IDEAL_ROBOT, np.random.default_rng(0)))
    robot = int(model.geom(PREFIX + "chassis").contype[0])
    assert robot & int(model.geom("target").conaffinity[0])
