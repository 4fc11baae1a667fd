"""MJCF files that know nothing of the twin: joints, floors, targets and starts."""

import numpy as np
import pytest

from scan3d_twin.core.errors import SceneError, UnknownNameError
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.kinematic import KinematicWorld
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

ROBOT = """<mujoco model="arm">
  <compiler angle="radian" meshdir="assets" autolimits="true"/>
  <default>
    <default class="visual"><geom contype="0" conaffinity="0" group="2"/></default>
    <default class="collision"><geom contype="1" conaffinity="0" group="3"/></default>
    <default class="arm"><joint axis="0 1 0" range="-2 2" damping="1"/></default>
  </default>
  <asset><mesh name="pyramid" file="pyramid.obj"/></asset>
  <worldbody>
    <body name="base" childclass="arm">
      <geom class="visual" type="mesh" mesh="pyramid"/>
      <geom class="collision" type="box" size=".1 .1 .1" pos="0 0 .1"/>
      <frame pos="0 0 .2" euler="0 0 1.5707963">
        <body name="upper" euler="0 0 .3">
          <joint name="shoulder"/>
          <geom class="collision" type="capsule" fromto="0 0 0 0 0 .4" size=".04"/>
          <body name="lower" pos="0 0 .4">
            <joint name="elbow"/>
            <inertial pos="0 0 .1" mass="1" diaginertia=".01 .01 .001"/>
            <geom name="tip" class="collision" type="capsule" fromto="0 0 0 0 0 .3" size=".03"/>
          </body>
        </body>
      </frame>
    </body>
    <body name="marker" mocap="true" pos="2 2 1">
      <geom name="mark" size=".05" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="both"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="1"/></fixed>
  </tendon>
  <equality><joint joint1="shoulder" joint2="elbow"/></equality>
  <actuator>
    <position joint="shoulder" kp="10"/><general tendon="both"/>
    <muscle joint="elbow" lengthrange="0 1"/>
  </actuator>
  <sensor><jointpos joint="shoulder"/><touch site="spawn_of_nothing"/></sensor>
  <worldbody><site name="spawn_of_nothing"/></worldbody>
  <keyframe>
    <key name="bent" qpos="1.2 -.7" ctrl="0 0 0" mpos="2 -2 1"/>
  </keyframe>
</mujoco>"""
PYRAMID = """v -.1 -.1 0\nv .1 -.1 0\nv .1 .1 0\nv -.1 .1 0\nv 0 0 .2
f 1 3 2\nf 1 4 3\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n"""
SCENE = """<mujoco>
  <include file="robot/arm.xml"/>
  <option timestep="0.005" integrator="RK4"/>
  <asset>
    <texture name="grid" type="2d" builtin="checker" width="64" height="64"/>
    <material name="grid" texture="grid" texrepeat="4 4"/>
  </asset>
  <worldbody><geom name="ground" type="plane" size="0 0 .05" material="grid"/></worldbody>
</mujoco>"""


@pytest.fixture
def arm(tmp_path):
    """A robot arm after the manner of MuJoCo Menagerie: an include, assets in another folder."""
    (tmp_path / "robot").mkdir()
    (tmp_path / "assets").mkdir()
    (tmp_path / "robot" / "arm.xml").write_text(ROBOT)
    (tmp_path / "assets" / "pyramid.obj").write_text(PYRAMID)
    (tmp_path / "scene.xml").write_text(SCENE)
    return str(tmp_path / "scene.xml")


def place(scene, kind, name):
    """Return where a body or geom of ``scene`` stands (3,) [m], and how it is turned (9,)."""
    import mujoco

    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    view = getattr(data, kind)(name)
    return view.xpos, view.xmat


def posed(path, keyframe):
    """Return where MuJoCo itself has the tip of the arm."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    if keyframe:
        mujoco.mj_resetDataKeyframe(model, data, model.key(keyframe).id)
    mujoco.mj_forward(model, data)
    return data.geom("tip").xpos, data.geom("tip").xmat, data.body("marker").xpos


@pytest.mark.parametrize("keyframe", ["", "bent"])
def test_joints_are_frozen_where_kinematics_has_them(arm, keyframe):
    scene = load_scene(arm, target="lower", keyframe=keyframe)
    tip, turn, marker = posed(arm, keyframe)
    assert scene.model.nq == scene.model.nu == scene.model.nsensor == 0
    found = place(scene, "geom", "tip")
    assert found[0] == pytest.approx(tip, abs=1e-9)
    assert found[1] == pytest.approx(turn, abs=1e-9)
    assert place(scene, "geom", "mark")[0] == pytest.approx(marker, abs=1e-9)


def test_any_body_or_geom_is_a_target(arm):
    whole, part = load_scene(arm, target="base"), load_scene(arm, target="tip")
    assert len(whole.targets["base"]) == 3
    assert part.targets == {"tip": ("tip",)}
    with pytest.raises(UnknownNameError, match=r"no target 'bas'.*base"):
        load_scene(arm, target="bas")
    with pytest.raises(UnknownNameError, match=r"no keyframe 'home'; known: bent"):
        load_scene(arm, target="base", keyframe="home")
    with pytest.raises(SceneError, match=r"--target BODY.*base"):
        load_scene(arm)


def test_a_start_is_chosen_on_free_floor_in_sight_of_the_target(arm):
    scene = load_scene(arm, target="base")
    gap = np.hypot(scene.spawn.x, scene.spawn.y)
    assert 1.2 < gap < 2.0
    with open_sim(scene) as (robot, truth):
        x, y = truth.locate("base")
        assert abs(np.arctan2(y, x)) < 0.1
        robot.base.set_velocity(0.2, 0.0)
        robot.clock.sleep(2.0)
        assert truth.pose_at(2.0).distance(truth.spawn) > 0.3
        assert robot.base.hazards().active() == ()


@pytest.mark.parametrize("height", [-0.9, 0.35])
def test_a_raised_or_lowered_floor_is_at_0_in_the_map(scene_of, height):
    scene = scene_of(
        f'<geom name="floor" type="plane" size="5 5 .05" pos="0 0 {height}"/>'
        f'<geom name="target" type="box" size=".1 .1 .2" pos="1 0 {height + 0.2}"/>',
        spawn=f'<site name="spawn" pos="0 0 {height}"/>',
    )
    assert place(scene, "geom", "floor")[0] == pytest.approx([0, 0, 0])
    assert place(scene, "geom", "target")[0] == pytest.approx([1, 0, 0.2])
    with open_sim(scene) as (robot, _):
        robot.base.set_velocity(0.2, 0.0)
        robot.clock.sleep(1.0)
        assert robot.base.hazards().active() == ()


def test_a_target_that_is_sunk_into_the_floor_stands_on_it(scene_of):
    """The reference pose of many robots has their legs below the ground."""
    floor = '<geom name="ground" type="plane" size="0 0 1"/>'
    scene = scene_of(floor + '<geom name="target" type="box" size=".2 .2 1"/>', spawn="")
    assert place(scene, "geom", "ground")[0] == pytest.approx([0, 0, 0])
    assert scene.model.ngeom == 2


def test_a_wall_of_type_plane_is_no_floor_and_ends_where_it_is_drawn(scene_of):
    wall = '<geom name="wall" type="plane" size="3 1 .1" pos="2 0 1" zaxis="-1 0 0"/>'
    scene = scene_of(wall + '<geom name="target" size=".1" pos="1 0 .1"/>')
    assert scene.model.geom("floor").type == 0
    behind = scene_of(
        wall + '<geom name="target" size=".1" pos="4 3 .1"/>',
        spawn='<site name="spawn" pos="3 3 0"/>',
    )
    with open_sim(behind) as (robot, _):
        assert robot.base.hazards().active() == ()


def test_a_floor_drawn_too_small_carries_the_robot_and_its_cliff_sensors(scene_of):
    scene = scene_of(
        '<geom name="floor" type="plane" size="1 1 .05"/>'
        '<geom name="target" size=".1" pos=".5 0 .1"/>',
        spawn='<site name="spawn" pos="-1.5 0 0"/>',
    )
    with open_sim(scene) as (robot, _):
        robot.base.set_velocity(-0.2, 0.0)
        robot.clock.sleep(1.0)
        assert robot.base.hazards().active() == ()


@pytest.mark.parametrize(
    ("body", "cause"),
    [
        ('<geom name="cupboard" type="box" size=".3 .3 .5" pos=".1 0 .5"/>', "inside cupboard"),
        ('<geom name="mirror" type="plane" size="0 0 .1" pos="1 0 0" zaxis="1 0 0"/>', "mirror"),
        (
            '<body name="shelf"><body><geom type="box" size=".3 .3 .1" pos="0 0 .25"/></body>'
            "</body>",
            "inside shelf",
        ),
        (
            '<geom name="plate" type="box" size=".1 .1 .05" pos="0 0 -.05"/>'
            '<geom name="low" type="plane" size="9 9 1" pos="0 0 -1"/>',
            "no solid floor",
        ),
        (
            '<geom name="quay" type="box" size="1 1 .05" pos="-.86 0 -.05"/>'
            '<geom name="low" type="plane" size="9 9 1" pos="0 0 -1"/>',
            "edge of the floor.*cliff",
        ),
        ('<geom name="ramp" type="box" size="1 1 .1" pos="0 0 -.1" euler="0 10 0"/>', "ramp"),
    ],
)
def test_a_robot_that_does_not_stand_is_refused_with_the_cause(scene_of, body, cause):
    scene = scene_of('<geom name="target" size=".1" pos="3 0 .1"/>' + body)
    with pytest.raises(SceneError, match=cause) as caught, open_sim(scene):
        pass
    assert "\n" not in str(caught.value)


CLOTH = """<flexcomp name="cloth" type="grid" count="5 5 1" spacing=".2 .2 .2" dim="2"
  pos=".8 0 .5" euler="0 90 0" radius=".01" mass="1">
  <edge equality="true"/><pin id="0 4"/></flexcomp>"""
ROPE = """<flexcomp name="rope" type="grid" count="5 1 1" spacing=".2 .2 .2" dim="1"
  pos=".8 0 .3" euler="0 0 90" radius=".02" mass="1"><edge equality="true"/></flexcomp>"""
JELLY = """<flexcomp name="jelly" type="grid" count="3 3 3" spacing=".2 .2 .2" dim="3"
  pos=".8 0 .3" radius=".01" mass="1"><edge equality="true"/></flexcomp>"""


@pytest.mark.parametrize(
    ("flex", "distance"), [(CLOTH, 0.8), (ROPE, 0.78), (JELLY, 0.6)], ids=["cloth", "rope", "jelly"]
)
def test_the_lidar_sees_a_flex(scene_of, flex, distance):
    scene = scene_of(flex + '<geom name="target" type="box" size=".2 .25 .25" pos="1.7 0 .25"/>')
    with open_sim(scene) as (_, truth):
        hit = truth.first_hits(np.array([[0.0, 0.01, 0.3]]), np.array([[1.0, 0.0, 0.0]]))
    assert hit == pytest.approx(distance, abs=2e-3)


def test_a_loose_thing_falls_and_kinematic_environments_see_it(scene_of):
    ball = '<body name="ball" pos="2 0 1"><freejoint/><geom size=".1"/></body>'
    scene = scene_of(ball + '<geom name="target" size=".1" pos="4 0 .1"/>')
    with open_sim(scene) as (_, truth):
        rays = np.array([[0.0, 0.0, 0.1]]), np.array([[1.0, 0.0, 0.0]])
        assert truth.first_hits(*rays) == pytest.approx(1.9, abs=0.01)
    assert KinematicWorld(scene.spawn, scene.model.qpos0).scene_qpos().shape == (7,)


BOX = '<body name="box" pos="0 0 .3"><geom type="box" size=".2 .2 .3"/></body>'
HILL = """<asset>
  <hfield name="h" nrow="3" ncol="3" size=".5 .5 .3 .1" elevation="0 0 0 0 1 0 0 0 0"/>
</asset>"""
TORUS = """<extension><plugin plugin="mujoco.sdf.torus"><instance name="t"/></plugin></extension>
<asset><mesh name="torus"><plugin instance="t"/></mesh></asset>"""
RING = """<body name="ring" pos="2 1 .5">
  <geom type="sdf" mesh="torus"><plugin instance="t"/></geom>
</body>"""
MANNERS = {
    "terrain": (HILL, f'<geom type="hfield" hfield="h"/>{BOX.replace("0 0", ".9 0")}', "box"),
    "hill": (HILL, f'<geom type="hfield" hfield="h" pos="2 2 0"/>{BOX}', "box"),
    "replicate": (
        "",
        '<replicate count="5" euler="0 0 72"><geom type="box" size=".05 .05 .4" pos=".3 0 .4"/>'
        '</replicate><body name="seat" pos="0 0 .8"><geom type="cylinder" size=".4 .02"/></body>',
        "seat",
    ),
    "held by a mocap body": (
        '<equality><weld body1="hand" body2="cup"/></equality>',
        '<body name="hand" mocap="true" pos="0 0 1"><geom size=".05"/></body>'
        '<body name="cup" pos="0 0 .9"><freejoint/><geom size=".1"/></body>',
        "cup",
    ),
    "a loose target": ("", BOX.replace("<geom", "<freejoint/><geom"), "box"),
    "a loose picture": (
        "",
        BOX.replace("<geom", '<freejoint/><geom contype="0" conaffinity="0"'),
        "box",
    ),
    "names of ours": (
        "",
        '<geom name="floor" type="plane" size="3 3 1"/>'
        '<geom name="uneven_floor" type="box" size=".1 .1 .1" pos="2 2 .1"/>'
        '<body name="base" pos="0 0 .3"><geom name="lidar" type="box" size=".2 .2 .3"/></body>',
        "base",
    ),
    "a room with a ceiling": (
        "",
        '<geom type="box" size="3 3 .1" pos="0 0 -.1"/>'
        '<geom type="plane" size="3 3 .1" pos="0 0 2.4" euler="180 0 0"/>'
        '<geom type="box" size=".1 3 1" pos="1.4 0 1"/><geom type="box" size="3 .1 1" pos="0 2 1"/>'
        '<body name="table" pos="0 0 .7"><geom type="box" size=".5 .3 .02"/></body>',
        "table",
    ),
    "a floor without contacts": (
        "",
        f'<geom name="floor" type="plane" size="3 3 1" contype="0" conaffinity="0"/>{BOX}',
        "box",
    ),
    "an invisible floor": ("", f'<geom type="plane" size="3 3 1" rgba="0 0 0 0"/>{BOX}', "box"),
}


@pytest.mark.parametrize("world", ["typical", "harsh"])
@pytest.mark.parametrize(("head", "body", "target"), MANNERS.values(), ids=MANNERS)
def test_files_of_many_manners_open_and_drive(tmp_path, head, body, target, world):
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco>{head}<worldbody>{body}</worldbody></mujoco>")
    scene = load_scene(str(path), target=target)
    with open_sim(scene, 0, TwinConfig.of(world)) as (robot, truth):
        robot.base.set_velocity(0.1, 0.0)
        robot.clock.sleep(1.0)
        assert truth.pose_at(1.0).distance(truth.spawn) == pytest.approx(0.09, abs=0.01)
        assert robot.base.hazards().active() == ()
        assert len(truth.surface(0.05)[0])


@pytest.mark.parametrize(
    ("head", "body", "target", "cause"),
    [
        (
            HILL,
            '<geom name="hill" type="hfield" hfield="h"/>',
            "hill",
            "'hill'.*not of type hfield",
        ),
        (TORUS, RING, "ring", "'ring/0'.*not of type sdf"),
        ("", '<body name="empty"/>' + BOX, "empty", "'empty' has no geom"),
        ("", '<body name="empty"/>', "box", "holds nothing with a name"),
        ("", f'<frame scale="2 2 2"><body name="b"><joint/>{BOX}</body></frame>', "b", "scale"),
    ],
)
def test_what_cannot_be_a_target_is_refused_by_name(tmp_path, head, body, target, cause):
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco>{head}<worldbody>{body}</worldbody></mujoco>")
    with pytest.raises(SceneError, match=cause):
        load_scene(str(path), target=target)
