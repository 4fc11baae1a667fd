"""Navigation: costmap and paths, motion control, odometry and wheel kinematics."""
