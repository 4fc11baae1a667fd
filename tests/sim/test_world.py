import mujoco
import numpy as np
import pytest

from scan3d_twin.sim.config import RobotErrorConfig
from scan3d_twin.sim.trace import PoseTrace
from scan3d_twin.sim.world import PREFIX, TIMESTEP, RobotErrors, robot_spec


def test_the_twins_options_survive_the_scenes_own(scene_of, make_world):
    head = (
        '<option timestep="0.01" integrator="Euler" cone="pyramidal" iterations="3" impratio="1"/>'
    )
    option = make_world(
        scene_of('<geom name="target" size=".1" pos="9 0 0"/>', head=head)
    ).model.opt
    assert option.timestep == TIMESTEP == 0.002
    assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert option.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert option.impratio == 10
    assert option.iterations >= 10


def test_contacts_are_as_stiff_as_tuned_whatever_the_floor_says(scene_of, make_world):
    floor = '<geom name="floor" type="plane" size="9 9 .1" solref=".1 1" friction="2"/>'
    world = make_world(scene_of('<geom name="target" size=".1" pos="9 0 0"/>' + floor))
    tyres = [c for c in world.data.contact if "tyre" in world.model.geom(c.geom2).name]
    assert len(tyres) == 2
    for contact in tyres:
        assert contact.solref == pytest.approx([0.005, 1])
        assert contact.friction[0] == pytest.approx(0.7)


def test_the_robot_stands_on_three_points_level(bare, make_world):
    world = make_world(bare)
    names = {
        world.model.geom(contact.geom2).name.removeprefix(PREFIX) for contact in world.data.contact
    }
    assert names == {"left_tyre", "right_tyre", "caster_wheel"}
    assert world.data.body(PREFIX + "base").xmat[8] > np.cos(np.radians(0.1))
    assert np.abs(world.data.qvel).max() < 1e-3


def test_the_lidar_is_where_the_mount_says(bare, make_world):
    site = make_world(bare).data.site(PREFIX + "lidar")
    assert site.xpos == pytest.approx([0.05, 0.0, 0.30], abs=0.5e-3)
    assert site.xmat.reshape(3, 3) == pytest.approx(np.eye(3), abs=2e-3)


def test_mass_and_caster_load(bare, make_world):
    world = make_world(bare)
    base = world.model.body(PREFIX + "base").id
    mass = world.model.body_subtreemass[base]
    assert 3.4 < mass < 4.2
    assert 0.028 < world.data.subtree_com[base][0] < 0.035
    force = np.zeros(6)
    for index, contact in enumerate(world.data.contact):
        if world.model.geom(contact.geom2).name.endswith("caster_wheel"):
            mujoco.mj_contactForce(world.model, world.data, index, force)
    assert 0.20 < force[0] / (mass * 9.81) < 0.30


def test_the_robot_is_as_large_as_its_data_sheet():
    model = robot_spec("create2").compile()
    assert model.geom("chassis").size[0] == 0.165
    assert model.geom("left_tyre").size[0] == 0.036
    gap = model.body("left_mount").pos - model.body("right_mount").pos
    assert gap == pytest.approx([0.0, 0.235, 0.0])
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    tops = data.geom_xpos[:, 2] + model.geom_aabb[:, 5]
    assert tops.max() == pytest.approx(0.33, abs=0.03)


def test_errors_reach_the_model(bare, make_world):
    config = RobotErrorConfig(0.02, 0.03, 0.6, 0.6, 0.04)
    errors = RobotErrors.draw(config, np.random.default_rng(5))
    model = make_world(bare, config, seed=5).model
    for side, index, sign in (("left", 0, 1), ("right", 1, -1)):
        radius = 0.036 * (1 + errors.wheel_radius[index])
        assert model.geom(f"{PREFIX}{side}_tyre").size[[0, 2]] == pytest.approx([radius, radius])
        offset = sign * 0.1175 * (1 + errors.wheel_base)
        assert model.body(f"{PREFIX}{side}_mount").pos[1] == pytest.approx(offset)
        motor = model.actuator(f"{PREFIX}{side}_cogging")
        assert motor.biasprm[0] == 0.04
        assert motor.biasprm[2] == pytest.approx(errors.cogging_phase[index])
    assert len({float(e) for e in (*errors.wheel_radius, errors.wheel_base)}) == 3


def test_poses_are_those_of_their_stamp_not_of_a_step_later(bare, make_world):
    world = make_world(bare)
    drives = [world.model.actuator(f"{PREFIX}{side}_drive").id for side in ("left", "right")]
    world.data.ctrl[drives] = 5.0
    world.advance(500)
    stamp = world.time
    qpos = np.array(world.data.qpos)
    world.advance(5)
    data = mujoco.MjData(world.model)
    data.qpos[:] = qpos
    mujoco.mj_forward(world.model, data)
    positions, rotations = world.lidar_poses(np.array([stamp]))
    assert positions[0] == pytest.approx(data.site(PREFIX + "lidar").xpos, abs=1e-12)
    assert rotations[0].ravel() == pytest.approx(data.site(PREFIX + "lidar").xmat, abs=1e-12)
    assert PoseTrace(world).base_poses(np.array([stamp]))[0, 0] == pytest.approx(
        data.body(PREFIX + "base").xpos[0], abs=1e-12
    )


def test_poses_between_steps_are_interpolated(bare, make_world):
    world = make_world(bare)
    world.data.ctrl[world.model.actuator(PREFIX + "left_drive").id] = 5.0
    world.advance(100)
    trace = PoseTrace(world)
    a, middle, b = trace.base_poses(np.array([0.1, 0.1 + TIMESTEP / 2, 0.1 + TIMESTEP]))
    assert middle == pytest.approx((a + b) / 2, abs=1e-9)
    assert b[2] != a[2]


def test_the_base_trace_keeps_the_whole_run(bare, make_world):
    world = make_world(bare)
    trace = PoseTrace(world)
    world.data.ctrl[world.model.actuator(PREFIX + "left_drive").id] = 5.0
    poses = []
    for _ in range(7):
        poses.append((world.time, trace.base_poses(np.array([world.time]))[0].tolist()))
        world.advance(400)
    times = np.array([time for time, _ in poses])
    assert trace.base_poses(times).tolist() == [pose for _, pose in poses]
    assert len({pose[2] for _, pose in poses}) == 7


def test_moving_objects_come_first_in_qpos(scene_of, make_world):
    ball = '<body name="ball" pos="2 0 1"><freejoint/><geom size=".1"/></body>'
    world = make_world(scene_of(ball + '<geom name="target" size=".1" pos="9 0 0"/>'))
    qpos = world.scene_qpos()
    assert qpos.shape == (7,)
    assert qpos[:3] == pytest.approx([2, 0, 0.1], abs=0.01)
