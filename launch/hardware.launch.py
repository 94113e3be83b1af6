"""The closed loop on hardware: the nodes of config/graph.yaml without the simulator.

ros2 launch plate_core hardware.launch.py port:=/dev/ttyUSB0 image_topic:=/camera/image_raw

ros2 service call /enable std_srvs/srv/SetBool "{data: true}"    # when you have looked at the rig
ros2 service call /start std_srvs/srv/Trigger

The camera's driver is started separately; it publishes image and camera_info, triggered at the
start of each plate cycle.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch_ros.actions import Node

from plate_core.graph import RunOptions, load_graph
from plate_core.rig import config_path

ARGUMENTS = {
    "scenario": ("sort_10", "Name in config/scenarios, or path of a .yaml file"),
    "method": ("sinusoids", "Method of the solver: rotations or sinusoids"),
    "seed": ("0", "Seed of the solver"),
    "transport": ("serial", "What moves the plate"),
    "port": ("/dev/ttyUSB0", "Serial port of the motor controller"),
    "image_topic": ("image_raw", "The camera's image"),
    "info_topic": ("camera_info", "The camera's calibration"),
    "rig_file": ("", "Rig file; empty: config/rig.yaml"),
    "params_file": (str(config_path("nodes.yaml")), "ROS parameters of the nodes"),
    "record": ("false", "true: all messages into a bag (MCAP), by ros2 bag"),
    "namespace": ("", "Namespace of all nodes and topics"),
}


def start_nodes(context):
    """Return one action per node, and the recorder's if it is wanted."""
    given = context.launch_configurations
    options = RunOptions(
        scenario=given["scenario"],
        method=given["method"],
        seed=int(given["seed"]),
        transport=given["transport"],
        port=given["port"],
        rig_file=given["rig_file"],
    )
    nodes = [
        Node(
            package=node.package,
            executable=node.executable,
            name=node.name,
            namespace=given["namespace"],
            parameters=[given["params_file"], options.parameters(node)],
            remappings=[
                ("image_raw", given["image_topic"]),
                ("camera_info", given["info_topic"]),
            ],
            output="screen",
        )
        for node in options.nodes(load_graph())
        if node.on_hardware
    ]
    if given["record"].lower() == "true":
        record = ["ros2", "bag", "record", "--storage", "mcap", "--all"]
        nodes.append(ExecuteProcess(cmd=record, output="screen"))
    return nodes


def generate_launch_description():
    """Return what `ros2 launch` runs."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=start_nodes)])
