"""The only place outside the nodes that imports ROS."""
