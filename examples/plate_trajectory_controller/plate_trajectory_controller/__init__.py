"""Example of a transport: sends motor tables to a ros2_control joint_trajectory_controller."""
