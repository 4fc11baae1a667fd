"""Where the robot starts in a scene that states no start, and what hides its target."""

from itertools import product

import numpy as np
import pytest

from scan3d_twin.core.errors import SceneError
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene


@pytest.mark.parametrize(("width", "distance"), [(0.03, 0.8), (0.12, 1.15), (0.6, 1.5)])
def test_the_chosen_start_is_nearer_to_a_small_target(scene_of, width, distance):
    """At 1.5 m the lines of a panorama are 5 cm apart, and may all miss it."""
    target = f'<geom name="target" type="box" size=".3 {width / 2} .1" pos="0 0 .1"/>'
    spawn = scene_of(target, spawn="").spawn
    gap = np.hypot(max(0, abs(spawn.x) - 0.3), max(0, abs(spawn.y) - width / 2))
    assert gap == pytest.approx(distance, abs=0.1)


def test_the_chosen_start_keeps_off_walls_things_and_the_far_side_of_planes(tmp_path):
    path = tmp_path / "room.xml"
    path.write_text("""<mujoco><worldbody>
      <geom name="wall" type="plane" size="0 0 .1" pos="-1 0 0" zaxis="1 0 0"/>
      <geom name="shelf" type="plane" size="1 .2 .1" pos="0 1.6 .2"/>
      <geom name="thin" type="box" size=".005 1 .3" pos="1.2 0 .3"/>
      <geom name="vase" type="cylinder" size=".1 .2" pos="0 0 .2"/>
    </worldbody></mujoco>""")
    scene = load_scene(str(path), target="vase")
    assert scene.spawn.x > -1 + 0.265
    assert abs(scene.spawn.x - 1.2) > 0.265 or abs(scene.spawn.y) > 1.265
    with open_sim(scene) as (robot, _):
        assert robot.base.hazards().active() == ()


LEGS = "".join(
    f'<geom type="cylinder" size=".01 .25" pos="{x} {y} .25"/>'
    for x in (-1.6, -1.4)
    for y in (-0.1, 0.1)
)
TABLE = '<geom name="top" type="box" size=".4 .4 .02" pos="-1.5 0 .5"/>' + LEGS
HULL = """<asset><mesh name="u" vertex="-2 -.8 0 -2 .8 0 -1 -.8 0 -1 .8 0 -2 -.8 1 -2 .8 1"
  face="0 1 4 1 5 4 0 4 2 1 3 5"/></asset>"""


@pytest.mark.parametrize(
    "thing",
    [
        TABLE,
        TABLE.replace("<geom", '<geom contype="0" conaffinity="0"'),
        '<geom name="hull" type="mesh" mesh="u"/>',
    ],
    ids=["poles", "pictures of poles", "the hull of a mesh"],
)
def test_the_chosen_start_keeps_off_what_rays_of_a_grid_miss(tmp_path, thing):
    """Poles of 2 cm between cells of 10 cm, at the place that is best without them."""
    path = tmp_path / "scene.xml"
    path.write_text(
        f"<mujoco>{HULL if 'hull' in thing else ''}<worldbody>"
        f'<geom name="vase" type="cylinder" size=".2 .3" pos="0 0 .3"/>{thing}</worldbody></mujoco>'
    )
    scene = load_scene(str(path), target="vase")
    place = np.array([scene.spawn.x, scene.spawn.y])
    assert np.linalg.norm(place) < 2.2
    for x, y in product((-1.6, -1.4), (-0.1, 0.1)):
        assert "hull" in thing or np.hypot(*(place - (x, y))) > 0.265
    with open_sim(scene) as (robot, _):
        assert robot.base.hazards().active() == ()


ROOM = "".join(
    f'<geom name="wall {x} {y}" type="box" size="{a} {b} .6" pos="{x} {y} .6"/>'
    for x, y, a, b in (
        (1.5, 0, 0.05, 1.5),
        (-1.5, 0, 0.05, 1.5),
        (0, 1.5, 1.5, 0.05),
        (0, -1.5, 1.5, 0.05),
    )
)


def test_the_chosen_start_is_in_the_room_that_shows_the_target(scene_of):
    """Outside there is more floor, and the top of the target is seen above the walls."""
    spawn = scene_of(
        ROOM + '<geom name="target" type="box" size=".1 .5 .9" pos="1.3 0 .9"/>', spawn=""
    ).spawn
    assert max(abs(spawn.x), abs(spawn.y)) < 1.2


@pytest.mark.parametrize("height", [1.9, 9.0])
def test_a_lamp_is_looked_at_from_where_it_is_within_the_window_of_a_run(scene_of, height):
    lamp = f'<geom name="target" type="cylinder" size=".2 .1" pos="0 0 {height}"/>'
    if height > 4:
        with pytest.raises(SceneError, match=r"only what is within 37\.5 deg of the horizontal"):
            scene_of(lamp, spawn="")
        return
    spawn = scene_of(lamp, spawn="").spawn
    assert np.arctan2(height - 0.3, np.hypot(spawn.x, spawn.y)) < np.radians(37.5)


@pytest.mark.parametrize("size", [(1.2, 1.2, 0.3), (0.2, 0.2, 0.3)])
def test_a_panorama_knows_a_target_by_what_it_shows(scene_of, size):
    """The middle of a large thing is more than half a metre behind its front."""
    a, b, c = size
    cone = f'<geom name="target" type="box" size="{a} {b} {c}" pos="3 0 .3"/>'
    with open_sim(scene_of(cone)) as (_, truth):
        x, y = truth.locate_shown("target")
        assert x == pytest.approx(3 - a, abs=0.05)
        assert y == pytest.approx(0, abs=0.05)


def test_a_target_behind_glass_is_seen(scene_of):
    panes = ROOM.replace("<geom", '<geom rgba="1 1 1 .2"').replace("1.5", ".5")
    scene = scene_of(
        panes + '<geom name="target" type="box" size=".1 .1 .3" pos="0 0 .3"/>', spawn=""
    )
    assert np.hypot(scene.spawn.x, scene.spawn.y) > 0.765


@pytest.mark.parametrize(
    ("cause", "body"),
    [
        ("has room for the robot;", ROOM.replace("1.5", ".5")),
        (
            "sees it: shelf hides it from the lidar at a height of 0.3 m;",
            '<body name="shelf" pos="0 0 1"><geom type="box" size=".9 .9 .02"/></body>',
        ),
    ],
)
def test_a_target_that_no_start_sees_is_refused_with_the_cause(scene_of, cause, body):
    high = "1.05" if "shelf" in body else ".1"
    target = f'<geom name="target" type="box" size=".05 .05 .03" pos="0 0 {high}"/>'
    fence = "" if "shelf" in body else ROOM.replace("1.5", "2.6").replace("0.05", "2.0")
    with pytest.raises(SceneError, match=cause):
        scene_of(body + target + fence, spawn="")


@pytest.mark.parametrize(("place", "notes"), [("1.6 0 .3", 1), ("1.6 1 .3", 0)])
def test_what_hides_a_named_target_from_a_stated_start_is_said(tmp_path, place, notes):
    path = tmp_path / "scene.xml"
    path.write_text(
        '<mujoco><worldbody><site name="spawn"/><geom name="crate" type="box" size=".2 .3 .4" '
        'pos="1 0 .4"/>'
        f'<body name="vase" pos="{place}"><geom type="cylinder" size=".1 .2"/></body>'
        "</worldbody></mujoco>"
    )
    notes_found = load_scene(str(path), target="vase").notes
    assert len(notes_found) == notes
    assert all("vase is not seen from the start: crate hides it" in note for note in notes_found)
