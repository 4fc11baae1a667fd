"""Test helper: a scene with two targets in a room."""

TWO = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="5 5 0.1"/>
  <geom name="north" type="box" pos="0 2.4 1" size="3 0.05 1"/>
  <geom name="south" type="box" pos="0 -2.4 1" size="3 0.05 1"/>
  <geom name="east" type="box" pos="3 0 1" size="0.05 2.4 1"/>
  <geom name="west" type="box" pos="-2 0 1" size="0.05 2.4 1"/>
  <body name="target_a" pos="1.5 0.9 0.3"><geom type="box" size="0.2 0.3 0.3"/></body>
  <body name="target_b" pos="1.5 -0.8 0.2"><geom type="box" size="0.15 0.2 0.2"/></body>
  <site name="spawn" pos="0 0 0"/>
</worldbody></mujoco>
"""
