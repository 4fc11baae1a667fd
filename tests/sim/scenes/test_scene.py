import mujoco
import numpy as np
import pytest

from scan3d_twin.core.errors import ConfigError, SceneError, UnknownNameError
from scan3d_twin.core.types import Pose2
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene, scene_names
from scan3d_twin.sim.scenes.surface_samples import bounding_points


def bounds(scene, name):
    """Low and high corner of a geom in the map frame."""
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    geom = data.geom(name)
    points = bounding_points(scene.model, geom.id) @ geom.xmat.reshape(3, 3).T + geom.xpos
    return points.min(axis=0), points.max(axis=0)


def test_the_scenes_that_come_with_the_package():
    assert {"three_boxes", "sine_box", "plain_wall", "shiny_cylinder"} <= set(scene_names())


@pytest.mark.parametrize("name", scene_names())
def test_every_scene_opens_without_contact_or_hazard(name):
    with open_sim(name, 0) as (robot, truth):
        robot.clock.sleep(0.1)
        assert robot.base.hazards().active() == ()
        assert truth.pose_at(0.0).distance(truth.spawn) < 0.001
        assert load_scene(name).description


def test_three_boxes_as_specified():
    scene = load_scene("three_boxes")
    expected = {  # front x, left y, right y, depth, height
        "target_left": (0.60, 1.15, 0.35, 0.40, 0.60),
        "target_middle": (0.75, 0.25, -0.15, 0.30, 0.40),
        "target_right": (0.65, -0.25, -1.15, 0.50, 0.70),
    }
    assert set(scene.targets) == set(expected)
    for name, (front, left, right, depth, height) in expected.items():
        low, high = bounds(scene, name)
        assert low == pytest.approx([front, right, 0.0])
        assert high == pytest.approx([front + depth, left, height])
    assert scene.tour == "front"
    assert scene.standoff == 1.0
    assert scene.spawn == Pose2(-0.9, 0.0, 0.0)
    assert scene.front is not None
    assert scene.front.rotate(np.array([1.0, 0.0])) == pytest.approx([-1.0, 0.0], abs=1e-9)


def test_the_room_is_5_by_4_metres_inside():
    scene = load_scene("three_boxes")
    assert bounds(scene, "wall_front")[0][0] == pytest.approx(2.5)
    assert bounds(scene, "wall_back")[1][0] == pytest.approx(-2.5)
    assert bounds(scene, "wall_left")[0][1] == pytest.approx(2.0)
    assert bounds(scene, "wall_right")[1][1] == pytest.approx(-2.0)


def test_sine_box_as_specified():
    scene = load_scene("sine_box")
    low, high = bounds(scene, "target_sine_box")
    assert low == pytest.approx([-0.17, -0.20, 0.0], abs=2e-4)
    assert high == pytest.approx([0.15, 0.20, 0.50], abs=2e-4)
    assert scene.tour == "full"


def test_plain_wall_has_nothing_else_within_reach():
    scene = load_scene("plain_wall")
    low, high = bounds(scene, "target_wall")
    assert high[1] - low[1] == pytest.approx(10.0)
    assert low[0] == pytest.approx(1.3)
    assert scene.model.ngeom == 2


def test_shiny_cylinder_as_specified():
    scene = load_scene("shiny_cylinder")
    geom = scene.model.geom("target_cylinder")
    assert geom.size[:2] == pytest.approx([0.15, 0.30])
    material = geom.matid[0]
    assert scene.model.mat_metallic[material] == 1
    assert scene.model.mat_roughness[material] == pytest.approx(0.1)


def test_an_unknown_name_lists_the_valid_ones():
    with pytest.raises(UnknownNameError, match=r"no_such.*plain_wall.*three_boxes"):
        load_scene("no_such")


@pytest.mark.parametrize("name", ["gone.xml", "gone.stl"])
def test_a_missing_file_is_named(name):
    with pytest.raises(SceneError, match=rf"no file {name}"):
        load_scene(name)


def test_broken_xml_is_one_line_with_the_file_name(tmp_path):
    path = tmp_path / "broken.xml"
    path.write_text("<mujoco><worldbody><geom></mujoco>")
    with pytest.raises(SceneError, match=r"broken\.xml") as caught:
        load_scene(str(path))
    assert "\n" not in str(caught.value)


def test_a_model_that_does_not_compile_is_a_scene_error(scene_of):
    with pytest.raises(SceneError, match=r"scene\.xml") as caught:
        scene_of('<geom name="target" type="box" size="0 0 0"/>')
    assert "\n" not in str(caught.value)


def test_a_scene_without_a_target_says_how_to_name_one(scene_of):
    with pytest.raises(SceneError, match=r"no target.*target\.\.\."):
        scene_of('<geom name="box" type="box" size="1 1 1"/>')


def test_a_scene_that_has_neither_a_spawn_nor_room_for_one_says_so(scene_of):
    crowd = "".join(
        f'<geom type="box" size=".05 9 .5" pos="{x:g} 0 .5"/>' for x in np.arange(-4, 4.1, 0.4)
    )
    with pytest.raises(SceneError, match="spawn"):
        scene_of('<geom name="target" size=".1" pos="0 0 1.2"/>' + crowd, spawn="")


def test_a_front_tour_needs_a_front(scene_of):
    head = '<custom><text name="scan3d.tour" data="front"/></custom>'
    with pytest.raises(SceneError, match="site 'front'"):
        scene_of('<geom name="target" size=".1"/>', head=head)


def test_an_unknown_tour_is_refused(scene_of):
    head = '<custom><text name="scan3d.tour" data="back"/></custom>'
    with pytest.raises(SceneError, match="front or full, got 'back'"):
        scene_of('<geom name="target" size=".1"/>', head=head)


def test_a_standoff_must_be_positive(scene_of):
    head = '<custom><numeric name="scan3d.standoff" data="-1"/></custom>'
    with pytest.raises(SceneError, match="standoff must be > 0"):
        scene_of('<geom name="target" size=".1"/>', head=head)


def test_a_plane_cannot_be_a_target(scene_of):
    with pytest.raises(SceneError, match="target_floor"):
        scene_of('<geom name="target_floor" type="plane" size="1 1 .1"/>')


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan")])
def test_a_mesh_scale_must_be_positive(scale):
    with pytest.raises(ConfigError, match="mesh scale"):
        load_scene("three_boxes", scale)


def test_a_target_body_stands_for_its_geoms_even_unnamed(scene_of):
    scene = scene_of(
        '<body name="target_chair"><geom size=".1"/><geom name="leg" size=".1"/></body>'
    )
    assert scene.targets == {"target_chair": ("target_chair/0", "leg")}
    assert scene.target_geoms == ("target_chair/0", "leg")


def test_a_tuple_names_the_target(scene_of):
    head = '<custom><tuple name="target"><element objtype="geom" objname="vase"/></tuple></custom>'
    scene = scene_of(
        '<geom name="vase" size=".1"/><geom name="target_decoy" size=".1"/>', head=head
    )
    assert scene.targets == {"vase": ("vase",)}


def test_a_tuple_that_names_nothing_is_refused(scene_of):
    head = '<custom><tuple name="target"><element objtype="geom" objname="gone"/></tuple></custom>'
    with pytest.raises(SceneError, match="'gone'"):
        scene_of('<geom name="vase" size=".1"/>', head=head)


@pytest.mark.parametrize(
    ("floor", "count"), [("", 2), ('<geom name="floor_box" type="box" size="9 9 .1"/>', 2)]
)
def test_a_floor_is_added_only_where_there_is_none(scene_of, floor, count):
    assert scene_of(f'<geom name="target" size=".1"/>{floor}').model.ngeom == count


def test_the_spawn_may_be_turned(scene_of):
    spawn = '<site name="spawn" pos="1 2 0" euler="0 0 90"/>'
    scene = scene_of('<geom name="target" size=".1" pos="1 5 .1"/>', spawn=spawn)
    with open_sim(scene, 0) as (robot, truth):
        assert scene.spawn.yaw == pytest.approx(np.pi / 2)
        assert truth.pose_at(0.0).yaw == pytest.approx(np.pi / 2, abs=1e-3)
        assert truth.locate("target") == pytest.approx((3.0, 0.0), abs=5e-3)
        line = robot.lidar.read_line(1.0)
        assert np.nanmin(line.ranges) > 0.15
