"""The closed loop on hardware: the nodes of config/graph.yaml without the simulator.

ros2 launch plate_bringup hardware.launch.py port:=/dev/ttyUSB0 image_topic:=/camera/image_raw

ros2 service call /enable std_srvs/srv/SetBool "{data: true}"    # when you have looked at the rig
ros2 run plate_client plate goal sort_10

The camera's driver is started separately; it publishes image and camera_info. The camera may run
free, or be triggered by the motor controller (camera: trigger_phase of the rig file).
"""

from plate_bringup.actions import describe


def generate_launch_description():
    """Return what `ros2 launch` runs."""
    return describe(hardware=True, file=__file__)
