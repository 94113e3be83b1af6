"""What the launch files start: the nodes of config/graph.yaml, and a recorder if it is wanted."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessIO
from launch_ros.actions import Node

from plate_core import PlateError, config_path, did_you_mean
from plate_core.files import YAML_BYTES, check_file
from plate_core.tasks import load_scenario

from .graph import GraphError, RunOptions, load_graph

COMMON = {
    "method": "of the solver",
    "seed": "of scattered parts, image noise and the solver",
    "transport": "what moves the plate",
    "rig_file": "measured facts of the rig",
    "params_file": "ROS parameters of the nodes, over those of config/nodes.yaml",
    "one_process": "all nodes in one process, not each in its own",
    "autostart": "false: somebody else configures and activates the nodes",
    "record": "all messages into a bag (MCAP), by ros2 bag",
    "view": "a live page, at http://127.0.0.1:8080/",
    "namespace": "of all nodes and topics, and of the frames in /tf",
}
SIMULATED = {
    "scenario": "parts on the plate: name in config/scenarios, or path of a .yaml file",
    "lockstep": "the simulator waits for every answer",
    "rate": "simulated seconds per second",
    "image_rate": "images a second of a camera that runs free; 0: one at the start of each cycle",
}
HARDWARE = {
    "port": "serial port of the motor controller",
    "image_topic": "the camera's image",
    "info_topic": "the camera's calibration",
    "recipe": "with the feeder: a scenario of kind feed, name or path of a .yaml file",
}
"""Arguments of the launch files. What is left out is as the files of parameters have it."""

CHOICES = {
    "method": ("rotations", "sinusoids"),
    "transport": ("sim", "serial"),
    **dict.fromkeys(("lockstep", "one_process", "autostart", "record", "view"), ("true", "false")),
}

OPTIONS: Mapping[str, Callable[[str], Any]] = {
    "scenario": str, "method": str, "seed": int, "transport": str, "rig_file": str,
    "lockstep": "true".__eq__, "view": "true".__eq__, "rate": float, "image_rate": float,
    "port": str, "recipe": str,
}  # fmt: skip
"""Arguments that are options of a run, and how they are read."""

MISTYPED = 0.8
"""Likeness from which on a name counts as one of ours, mistyped: a launch file that includes ours
may well have a `config_file`, as like `rig_file` as 0.74."""


def describe(hardware: bool) -> LaunchDescription:
    """Return what `ros2 launch` runs: the loop in simulation, or on hardware."""
    # On hardware there may be transports that are not ours.
    choices = {name: CHOICES[name] for name in CHOICES if not (hardware and name == "transport")}
    arguments = [
        DeclareLaunchArgument(
            name,
            default_value="",
            description=text,
            choices=["", *choices[name]] if name in choices else None,
        )
        for name, text in arguments_of(hardware).items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=partial(start, hardware))])


def arguments_of(hardware: bool) -> dict[str, str]:
    """Return the arguments of a launch file, name to meaning."""
    return (HARDWARE if hardware else SIMULATED) | COMMON


def check_names(hardware: bool, names: Iterable[str], words: Sequence[str]) -> None:
    """Refuse arguments that are not ours.

    A launch file that includes ours hands on its own arguments too. So unless ours is the one that
    the command line names, only those are refused that are like one of ours, or of the other file.

    Parameters
    ----------
    hardware : bool
    names : iterable of str
        Of all arguments.
    words : sequence of str
        Of the command line.

    Raises
    ------
    GraphError
        Naming the argument, and those that there are.
    """
    known, other = arguments_of(hardware), arguments_of(not hardware)
    files = ("hardware.launch.py", "closed_loop.launch.py")
    ours = any(Path(word).name == files[not hardware] for word in words)
    typed = {word.partition(":=")[0] for word in words if ":=" in word} if ours else set()
    for name in names:
        if name in known:
            continue
        hint = did_you_mean(name, known, MISTYPED)
        if name in other:
            hint = f", of {files[hardware]}"
        if hint or name in typed:
            raise GraphError(f"launch argument is {name!r}{hint}, allowed: {', '.join(known)}")


def start(hardware: bool, context: Any) -> list[Any]:
    """Return the actions that start every node, and the recorder.

    Raises
    ------
    GraphError
        If an argument is mistyped, or there is no such file of parameters: ROS would go on without
        it.
    """
    check_names(hardware, context.launch_configurations, sys.argv)
    known = arguments_of(hardware)
    given = {n: text for n, text in context.launch_configurations.items() if text and n in known}
    values = {name: read(given[name]) for name, read in OPTIONS.items() if name in given}
    if "scenario" in given and not {"rig_file", "params_file"} & given.keys():
        values["rig_file"] = load_scenario(given["scenario"]).rig
    apart: list[dict[str, Any]] = []
    if "namespace" in given:  # two plates have two simulated devices, and frames of their own
        own = given["namespace"].strip("/")
        values["link"] = RunOptions.link + "_" + own.replace("/", "_")
        apart = [{"frame_prefix": f"{own}/"}]
    options = RunOptions(
        **{"transport": "serial" if hardware else "sim", "hardware": hardware} | values
    )
    files = [config_path("nodes.yaml"), *([config_path("hardware.yaml")] if hardware else [])]
    if "params_file" in given:
        files.append(Path(given["params_file"]))
        try:
            check_file(files[-1], YAML_BYTES)
        except PlateError as error:
            raise GraphError(f"params_file {error}") from None
    topics = {"image_raw": given.get("image_topic"), "camera_info": given.get("info_topic")}
    waiting = [{"autostart": False}] if given.get("autostart") == "false" else []
    actions: list[Any] = []
    views = {node.name for node in load_graph() if node.view}
    for name, program in programs(options, given).items():
        last_words = [""]
        process = Node(
            namespace=given.get("namespace", ""),
            remappings=[(topic, other) for topic, other in topics.items() if other],
            output="screen",
            on_exit=None if name in views else partial(_end, name, last_words),
            **program | {"parameters": [*apart, *map(str, files), program["parameters"], *waiting]},
        )
        listen = OnProcessIO(target_action=process, on_stderr=partial(_remember, last_words))
        actions.append(RegisterEventHandler(listen))
        actions.append(process)
    if given.get("record") == "true":
        record = ["ros2", "bag", "record", "--storage", "mcap", "--all"]
        actions.append(ExecuteProcess(cmd=record, output="screen"))
    return actions


def programs(options: RunOptions, given: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Return what is started, by name: package, executable, parameters over those of the files."""
    nodes = options.nodes(load_graph())
    if given.get("one_process") != "true":
        return {
            node.name: {
                "package": node.package,
                "executable": node.executable,
                "name": node.name,
                "parameters": options.parameters(node, given),
            }
            for node in nodes
        }
    with NamedTemporaryFile("w", suffix=".yaml", delete=False, encoding="utf-8") as file:
        file.write(options.parameter_file(nodes, given))
    program = {"package": "plate_bringup", "executable": "one_process"}
    names = [node.name for node in nodes]
    return {"one_process": program | {"arguments": names, "parameters": file.name}}


def _remember(last_words: list[str], event: Any) -> None:
    lines = event.text.decode(errors="replace").strip().splitlines()
    last_words[:] = lines[-1:] or last_words


def _end(name: str, last_words: list[str], event: Any, context: Any) -> list[Any] | None:
    """Take everything down with a node that has ended, and say why."""
    if context.is_shutdown:
        return None
    why = f"{name} ended with exit code {event.returncode}: {last_words[0]}"
    return [LogInfo(msg=why), Shutdown(reason=why)]
