"""The real graph as processes: `session` starts the nodes, an `Observer` watches them over DDS.

Programs import the rooms themselves; importing this folder imports no ROS.
"""
