"""Motor tables to a ros2_control joint_trajectory_controller: an example of a transport."""
