"""Launch file of the closed loop on hardware. The launch file starts the nodes of config/graph.yaml
without the simulator.

ros2 launch plate_bringup hardware.launch.py rig_file:=my_rig.yaml port:=/dev/ttyUSB0 \\
    camera:=/dev/v4l/by-id/NAME

ros2 service call /enable std_srvs/srv/SetBool "{data: true}"    # after a check of the rig
ros2 run plate_client plate goal sort_10

Without camera:=..., another node must publish the images (image_topic:=..., info_topic:=...). The
camera may be free-running, or the motor controller may trigger it (trigger_phase in the rig file).
"""

from plate_bringup.actions import describe


def generate_launch_description():
    """Return the launch description of the hardware."""
    return describe(hardware=True, file=__file__)
