"""Actions of the launch files. These actions start the nodes of config/graph.yaml and, if
requested, a recorder."""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import yaml
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    GroupAction,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
    TimerAction,
)
from launch.event_handlers import OnProcessIO
from launch_ros.actions import Node

from plate_core import PlateError, config_path, did_you_mean, load_rig
from plate_core.files import YAML_BYTES, check_file, read_file
from plate_core.rig import unmeasured
from plate_core.tasks import load_scenario

from .graph import GraphError, RunOptions, load_graph

LEVELS = {"*": "/[^/]+", "**": "(/[^/]+)*"}
"""Regular expressions of the wildcards in the section names of parameter files."""

COMMON = {
    "method": "method of the solver: rotations or sinusoids",
    "seed": "random seed of scattered parts, image noise and the solver",
    "transport": "transport to the motors: sim, serial, or an installed one",
    "rig_file": "rig file with the measured data of the rig",
    "params_file": "file of ROS parameters, which override the values in config/nodes.yaml",
    "one_process": "run all nodes in one process, instead of one process per node",
    "autostart": "whether nodes configure and activate themselves; if false, another program must",
    "record": "record all messages into a bag (MCAP) with ros2 bag",
    "view": "show a live page at http://127.0.0.1:8080/",
    "namespace": "namespace of all nodes and topics, and of the frames in /tf",
}
SIMULATED = {
    "scenario": "parts on the plate: name in config/scenarios, or path of a .yaml file",
    "lockstep": "the simulator waits until the nodes have processed each image",
    "rate": "simulated seconds per second",
    "image_rate": "images per second of a free-running camera; 0: one image at each cycle start",
}
HARDWARE = {
    "port": "serial port of the motor controller",
    "camera": "device of the camera node (camera --list); default: another node publishes images",
    "image_topic": "topic of the camera's images",
    "info_topic": "topic of the camera's calibration",
    "recipe": "recipe of the feeder: a scenario of kind feed, name or path of a .yaml file",
}
"""Arguments of the launch files. If an argument is omitted, the value in the parameter files is
used."""

FLAGS = ("lockstep", "one_process", "autostart", "record", "view")
"""Arguments that are true or false. Python expressions of launch files write them with a capital
letter."""

CHOICES = {
    "method": ("rotations", "sinusoids"),
    "transport": ("sim", "serial"),
    **dict.fromkeys(FLAGS, ("true", "false", "True", "False")),
}

OPTIONS: Mapping[str, Callable[[str], Any]] = {
    "scenario": str, "method": str, "seed": int, "transport": str, "rig_file": str,
    "lockstep": "true".__eq__, "view": "true".__eq__, "rate": float, "image_rate": float,
    "port": str, "camera": str, "recipe": str,
}  # fmt: skip
"""Arguments of the launch files that are fields of `RunOptions`, with the functions that convert
their texts. The texts of flags are in lower case."""

REAL_TIME = ("false", "1", "1.0")
"""Texts of the simulator's parameters `rate`, `lockstep` and `simulated_time` with which time is
not simulated."""

SIMILAR = 0.8
"""Minimum similarity of a name to a known name for the assumption that the name is misspelled
(ratio of difflib)."""

PACKAGE = "plate_bringup"


def describe(hardware: bool, file: str) -> LaunchDescription:
    """Return the launch description of the launch file `file`, which is for hardware or for
    simulation."""
    # On hardware, any name of a transport is allowed, because users can install their own
    # transports.
    choices = {name: CHOICES[name] for name in CHOICES if not (hardware and name == "transport")}
    arguments = [
        DeclareLaunchArgument(
            name,
            default_value="",
            description=text,
            choices=["", *choices[name]] if name in choices else None,
        )
        for name, text in argument_descriptions(hardware).items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=partial(start, hardware, file))])


def argument_descriptions(hardware: bool) -> dict[str, str]:
    """Return the descriptions of a launch file's arguments, by name."""
    return (HARDWARE if hardware else SIMULATED) | COMMON


def check_arguments(hardware: bool, arguments: Sequence[str], file: str) -> None:
    """Check the arguments of the command line, if the command line starts this launch file
    directly.

    If another launch file includes this one, unknown arguments are not errors. Unknown arguments
    can belong to the other file.

    Parameters
    ----------
    hardware : bool
    arguments : sequence of str
        Arguments of the command line.
    file : str
        Path of the launch file.

    Raises
    ------
    GraphError
        If an argument is unknown. The message contains its name and the allowed names.
    """
    if not any(
        _is_launch_file_name(file, before, word) for before, word in pairwise(["", *arguments])
    ):
        return
    known, other = argument_descriptions(hardware), argument_descriptions(not hardware)
    for name in (word.partition(":=")[0] for word in arguments if ":=" in word):
        if name not in known:
            files = ("hardware.launch.py", "closed_loop.launch.py")
            hint = (
                f" (an argument of {files[hardware]})"
                if name in other
                else did_you_mean(name, known)
            )
            raise GraphError(f"launch argument is {name!r}{hint}, allowed: {', '.join(known)}")


def _is_launch_file_name(file: str, before: str, word: str) -> bool:
    """Return whether a word of the command line names a launch file. The word can be the path of a
    launch file, or a file's name after the name of this package."""
    if Path(word).name != Path(file).name:
        return False
    return before == PACKAGE or (Path(word).exists() and Path(word).samefile(file))


def namespace_of(pushed: str, own: str) -> str:
    """Return the namespace of the nodes, without slashes at its ends. If there is no namespace, the
    text is empty.

    Parameters
    ----------
    pushed : str
        Namespace that actions PushRosNamespace of outer launch files set.
    own : str
        Argument `namespace`. This namespace is relative to `pushed`, unless it begins with a slash.
    """
    return (own if own.startswith("/") else f"{pushed}/{own}").strip("/").replace("//", "/")


def start(hardware: bool, file: str, context: Any) -> list[Any]:
    """Return the actions that start all nodes and the recorder.

    Raises
    ------
    GraphError
        If an argument is unknown, if a number is invalid, or if the parameter file does not exist.
        Without this check, ROS would ignore a missing parameter file and start the nodes without
        its parameters.
    """
    check_arguments(hardware, sys.argv, file)
    known = argument_descriptions(hardware)
    given = {
        name: text.lower() if name in FLAGS else text
        for name, text in context.launch_configurations.items()
        if text and name in known
    }
    values = {name: _convert(name, given[name]) for name in OPTIONS if name in given}
    own_files = _own_files(given)
    pushed = context.launch_configurations.get("ros_namespace", "")
    space = namespace_of(pushed, given.get("namespace", ""))
    names = [node.name for node in load_graph()]
    parameters = [*context.launch_configurations.get("global_params", []), *own_files]
    found = partial(find_values, parameters, space)
    rigs = [given["rig_file"]] if "rig_file" in given else found(names, "rig_file")
    if "scenario" in given and not rigs:
        rigs = [load_scenario(given["scenario"]).rig]
        values["rig_file"] = rigs[0]
    if space:  # if two plates run, each needs a separate simulated device
        values["link"] = RunOptions.link + "_" + space.replace("/", "_")
    if not hardware:
        keys = [key for key in ("rate", "lockstep", "simulated_time") if key not in given]
        texts = [text for key in keys for text in found(["simulator"], key)]
        values["simulated_time"] = any(text.lower() not in REAL_TIME for text in texts)
    warnings = misspelled_arguments(hardware, context.launch_configurations, Path(file).name)
    warnings += [text for path in own_files for text in unused_sections(path, space, names)]
    options = RunOptions(
        **{"transport": "serial" if hardware else "sim", "hardware": hardware} | values
    )
    clock: list[dict[str, bool]] = []
    follows = "true" in (text.lower() for text in found(names, "use_sim_time"))
    if follows and not (hardware or options.is_simulated_time):
        clock = [{"use_sim_time": False}]
        warnings.append("use_sim_time is ignored, because the simulation runs in real time")
    waiting = [{"autostart": False}] if given.get("autostart") == "false" else []
    defaults = default_files(hardware, space, [node.name for node in options.nodes(load_graph())])
    actions: list[Any] = [OpaqueFunction(function=partial(_set_parameter_files, defaults))]
    actions += [LogInfo(msg=f"warning: {text}") for text in warnings]
    for rig in (rigs or [""]) if hardware else ():
        facts = unmeasured(load_rig(rig))
        actions += [LogInfo(msg=f"this rig is not fully measured. {text}") for text in facts]
    actions += _start_programs(options, given, space, own_files, [*waiting, *clock])
    if given.get("record") == "true":
        actions += _start_recorder(space)
    return [GroupAction(actions)]


def _own_files(given: Mapping[str, str]) -> list[str]:
    """Return the parameter file of the argument `params_file`, or an empty list.

    Raises
    ------
    GraphError
        If the file does not exist or cannot be read.
    """
    if "params_file" not in given:
        return []
    try:
        check_file(Path(given["params_file"]), YAML_BYTES)
    except PlateError as error:
        raise GraphError(f"params_file {error}") from None
    return [given["params_file"]]


def _start_programs(
    options: RunOptions,
    given: Mapping[str, str],
    space: str,
    own_files: Sequence[str],
    last_parameters: Sequence[Mapping[str, bool]],
) -> list[Any]:
    """Return the actions that start the programs of all nodes.

    The parameters of a node are those of the files `own_files`, then those of its program, then
    `last_parameters`. Later values replace earlier ones.
    """
    topics = {"image_raw": given.get("image_topic"), "camera_info": given.get("info_topic")}
    views = {node.name for node in load_graph() if node.view}
    actions: list[Any] = []
    for name, program in programs(options, given, space).items():
        last_line = [""]
        process = Node(
            namespace=given.get("namespace", ""),
            remappings=[(topic, other) for topic, other in topics.items() if other],
            output="screen",
            on_exit=None if name in views else partial(_shut_down, name, last_line),
            **program | {"parameters": [*own_files, program["parameters"], *last_parameters]},
        )
        actions += [_listen_to(process, last_line), process]
    return actions


def _start_recorder(space: str) -> list[Any]:
    """Return the actions that start the recorder of all topics."""
    last_line = [""]
    recorder = ExecuteProcess(
        cmd=["ros2", "bag", "record", "--storage", "mcap", "--all", *bag_name(space)],
        output="screen",
        on_exit=partial(_report_end_of_recorder, last_line),
    )
    return [_listen_to(recorder, last_line), recorder]


def _convert(name: str, text: str) -> Any:
    """Return the value of an argument.

    Raises
    ------
    GraphError
        If the argument is a number, and the text is not.
    """
    try:
        return OPTIONS[name](text)
    except ValueError:
        kind = "an integer" if OPTIONS[name] is int else "a number"
        raise GraphError(f"launch argument {name} is {text!r}, allowed: {kind}") from None


def misspelled_arguments(hardware: bool, given: Iterable[str], file: str) -> list[str]:
    """Return warnings about names of launch configurations that are similar to an argument.

    If another launch file includes this one, ROS passes all names of the other file, too. Therefore
    an unknown name is no error. Names such as `ros_namespace` belong to ROS.

    Parameters
    ----------
    hardware : bool
    given : iterable of str
        Names of all launch configurations.
    file : str
        Name of the launch file.
    """
    known, other = argument_descriptions(hardware), argument_descriptions(not hardware)
    near = {
        name: difflib.get_close_matches(name, known, n=1, cutoff=SIMILAR)
        for name in given
        if name not in known and name not in other and not name.startswith("ros_")
    }
    return [
        f"{file} has no argument {name!r} and ignores it (did you mean {words[0]}?)"
        for name, words in near.items()
        if words
    ]


def unused_sections(path: str, space: str, names: Sequence[str]) -> list[str]:
    """Return warnings about the sections of a parameter file that are probably for the nodes, but
    match none of them.

    Such a section has no namespace although the nodes have one, or a misspelled name. Sections of
    other namespaces can be for other plates, and sections with other names for other nodes.

    Parameters
    ----------
    path : str
        Parameter file. The nodes report an unreadable file.
    space : str
        Namespace of the nodes, without slashes at its ends.
    names : sequence of str
        Names of the nodes.
    """
    warnings = []
    for section, _ in _read_sections(path):
        name = section.removeprefix("/")
        if name in names and space:
            warnings.append(
                f"params_file {path}: the section {section} does not match the node "
                f"/{space}/{name}, allowed: /**/{name} or /{space}/{name}"
            )
        last = section.rpartition("/")[2]
        near = difflib.get_close_matches(last, names, n=1, cutoff=SIMILAR)
        if near and last not in names:
            warnings.append(
                f"params_file {path}: no node has the name {last!r} of the section {section} "
                f"(did you mean {near[0]}?)"
            )
    return warnings


def bag_name(space: str) -> list[str]:
    """Return the options of `ros2 bag record` for the name of the bag. If there is a namespace, the
    name contains it, because recorders that start in the same second would use the same name.
    Without a namespace, ROS selects the name."""
    if not space:
        return []
    return ["--output", f"rosbag2_{datetime.now():%Y_%m_%d-%H_%M_%S}_{space.replace('/', '_')}"]


def find_values(parameters: Sequence[Any], space: str, names: Sequence[str], key: str) -> list[str]:
    """Return the different values of one parameter that ROS parameters set for some nodes, as
    texts.

    Parameters
    ----------
    parameters : sequence
        Parameters in the form of launch_ros: paths of parameter files, and pairs of name and value.
        Unreadable files are ignored here, because the nodes report these files.
    space : str
        Namespace of the nodes, without slashes at its ends.
    names : sequence of str
        Names of the nodes.
    key : str
        Name of the parameter. Empty values are ignored.
    """
    paths, found = [f"/{space}/{name}".replace("//", "/") for name in names], []
    for file in parameters:
        if isinstance(file, tuple):
            found += [str(file[1])] if file[0] == key else []
            continue
        found += [
            str(values[key])
            for section, values in _read_sections(str(file))
            if values.get(key)
            and any(re.fullmatch(_section_pattern(section), path) for path in paths)
        ]
    return list(dict.fromkeys(found))


def _read_sections(path: str) -> list[tuple[str, dict[Any, Any]]]:
    """Return the sections of a parameter file as `_find_sections` yields them. If the file is
    unreadable, the list is empty."""
    try:
        data = _Loader(read_file(path, YAML_BYTES)).get_single_data()
        return list(_find_sections(data))
    # PyYAML raises an OverflowError for an escape sequence beyond the range of Unicode.
    except (PlateError, yaml.YAMLError, OverflowError, RecursionError):
        return []


def _section_pattern(section: str) -> str:
    """Return the regular expression that the full names of a section's nodes match. In a section,
    `*` stands for one level of a node's name, and `**` for any number of levels."""
    levels = section.removeprefix("/").split("/")
    return "".join(LEVELS.get(level, "/" + re.escape(level)) for level in levels)


class _Loader(yaml.BaseLoader):
    """Loader of parameter files that reads all scalars as text, because rcl accepts values that
    PyYAML refuses, such as an impossible date. The loader refuses YAML aliases, as rcl does. With
    nested aliases, a small file could expand to an enormous number of sections."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("the file contains an alias (*NAME), allowed: none")
        return super().compose_node(parent, index)


def _find_sections(data: Any, above: str = "") -> Iterator[tuple[str, dict[Any, Any]]]:
    """Yield each section of a parameter file: its name with a slash before each level, and its
    parameters."""
    for key, value in data.items() if isinstance(data, dict) else ():
        if key == "ros__parameters" and isinstance(value, dict):
            yield above, value
        else:
            patterns = "".join(f"/{level}" for level in str(key).split("/") if level)
            yield from _find_sections(value, above + patterns)


def default_files(hardware: bool, space: str, names: Sequence[str]) -> list[str]:
    """Return the files with the default parameters of the nodes. If the nodes have a namespace, one
    of the files sets `frame_prefix`."""
    files = [str(config_path("nodes.yaml"))]
    if hardware:
        files.append(str(config_path("hardware.yaml")))
    if space:
        frame_prefix = {
            f"/**/{name}": {"ros__parameters": {"frame_prefix": f"{space}/"}} for name in names
        }
        files.append(_write_temporary_file(yaml.safe_dump(frame_prefix)))
    return files


def _set_parameter_files(defaults: Sequence[str], context: Any) -> None:
    """Place the default parameter files before all other parameters, and write the parameters of
    outer actions SetParameter into files.

    ROS merges all files by the names of their sections. If two sections match a node, ROS compares
    the places at which their names first occur. The section with the later place has priority.
    Therefore `/**/solver` in the default files must occur before a section such as `/left/solver`
    in a user's file. launch_ros passes the parameters of outer actions, such as
    SetParametersFromFile, before the parameters of the node.

    launch_ros passes a parameter of SetParameter as an option `-p`. A node refuses such an option
    if it does not have the parameter. In the section `/**` of a file, the parameter has the same
    priority, and can be for other nodes.
    """
    outer = [
        _write_temporary_file(yaml.safe_dump({"/**": {"ros__parameters": dict([item])}}))
        if isinstance(item, tuple)
        else item
        for item in context.launch_configurations.get("global_params", [])
    ]
    context.launch_configurations["global_params"] = [*defaults, *outer]


def _write_temporary_file(text: str) -> str:
    with NamedTemporaryFile("w", suffix=".yaml", delete=False, encoding="utf-8") as file:
        file.write(text)
    return file.name


def programs(
    options: RunOptions, given: Mapping[str, str], space: str
) -> dict[str, dict[str, Any]]:
    """Return the programs to start, by name. Each value consists of the package, the executable,
    and the parameters that override the parameter files."""
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
    file = _write_temporary_file(options.parameter_file(nodes, given, space))
    program = {"package": "plate_bringup", "executable": "one_process"}
    names = [node.name for node in nodes]
    return {"one_process": program | {"arguments": names, "parameters": file}}


def _listen_to(process: Any, last_line: list[str]) -> Any:
    """Return the action that stores the last line of a process in `last_line`. Nodes write to
    stdout if the variable RCUTILS_LOGGING_USE_STDOUT is set."""
    store = partial(_record_last_line, last_line)
    listen = OnProcessIO(target_action=process, on_stdout=store, on_stderr=store)
    return RegisterEventHandler(listen)


def _record_last_line(last_line: list[str], event: Any) -> None:
    lines = event.text.decode(errors="replace").strip().splitlines()
    last_line[:] = lines[-1:] or last_line


def _shut_down(name: str, last_line: list[str], event: Any, context: Any) -> list[Any] | None:
    """Shut down all nodes because a node has ended, and log the reason. If the node has failed,
    `ros2 launch` also fails, so that a test or a service manager notices it."""
    if context.is_shutdown:
        return None
    why = f"{name} ended with exit code {event.returncode}: {last_line[0]}"
    if event.returncode:
        # launch reports an exception, shuts down, and returns 1. The timer delays the exception
        # until all other handlers of this event have been called.
        fail = OpaqueFunction(function=partial(_raise_failure, why))
        return [TimerAction(period=0.0, actions=[fail])]
    return [LogInfo(msg=why), Shutdown(reason=why)]


def _raise_failure(why: str, context: Any) -> None:
    if not context.is_shutdown:
        raise GraphError(why)


def _report_end_of_recorder(last_line: list[str], event: Any, context: Any) -> list[Any] | None:
    """Log that the recorder has ended. The nodes continue."""
    if context.is_shutdown:
        return None
    why = f"the recorder ended with exit code {event.returncode}: {last_line[0]}"
    return [LogInfo(msg=f"warning: no messages are recorded any more: {why}")]
