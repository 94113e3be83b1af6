"""Launch file of the closed loop in simulation. The launch file starts the nodes of
config/graph.yaml.

ros2 launch plate_bringup closed_loop.launch.py scenario:=sort_10 method:=sinusoids
ros2 launch plate_bringup closed_loop.launch.py transport:=serial  # a simulated motor controller
ros2 service call /enable std_srvs/srv/SetBool "{data: true}"    # with transport:=serial only
ros2 run plate_client plate goal sort_10
"""

from plate_bringup.actions import describe


def generate_launch_description():
    """Return the launch description of the simulation."""
    return describe(hardware=False, file=__file__)
