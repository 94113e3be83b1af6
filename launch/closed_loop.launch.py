"""The closed loop in simulation: the nodes of config/graph.yaml.

ros2 launch plate_core closed_loop.launch.py scenario:=sort_10 method:=sinusoids
ros2 launch plate_core closed_loop.launch.py transport:=serial   # over a simulated motor controller
ros2 service call /enable std_srvs/srv/SetBool "{data: true}"    # with transport:=serial only
ros2 service call /start std_srvs/srv/Trigger
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch_ros.actions import Node

from plate_core.graph import RunOptions, load_graph
from plate_core.rig import config_path

ARGUMENTS = {
    "scenario": ("sort_10", "Name in config/scenarios, or path of a .yaml file"),
    "method": ("sinusoids", "Method of the solver: rotations or sinusoids"),
    "seed": ("0", "Seed of scattered parts, image noise and the solver"),
    "transport": ("sim", "What moves the plate: sim or serial"),
    "lockstep": ("false", "true: the simulator waits for every answer"),
    "rate": ("1.0", "Simulated seconds per second"),
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
        lockstep=given["lockstep"].lower() == "true",
        rate=float(given["rate"]),
        rig_file=given["rig_file"],
    )
    nodes = [
        Node(
            package=node.package,
            executable=node.executable,
            name=node.name,
            namespace=given["namespace"],
            parameters=[given["params_file"], options.parameters(node)],
            output="screen",
            # Until the port is there
            respawn=node.name == "driver" and options.transport == "serial",
            respawn_delay=1.0,
        )
        for node in options.nodes(load_graph())
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
