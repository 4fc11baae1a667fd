"""How the robot gets about: costmap and paths, motion control, odometry and wheel kinematics."""
