"""Runs the real graph as processes: `session` starts the nodes, and an `Observer` watches them.

Programs import the modules of this package. The package itself does not import ROS.
"""
