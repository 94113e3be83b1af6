"""The program `plate`: tasks, stops, states and parameters of a running graph. The program `ros2`
need not be installed.

Modules with a long import time are imported only in the functions that need these modules.
Therefore no import delays a stop.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from types import FrameType

SERVICES = {
    "stop": "cancel the running task, whoever sent it",
    "enable": "clear the stop, switch the motors on and move the plate home",
    "disable": "brake, then switch the motors off; this is no emergency stop",
    "emergency_stop": "brake, then switch the motors off (stop category 1)",
    "cut_power": "switch the motors off at once (stop category 0)",
    "home": "forget the home position; the next enable searches for it",
    "calibrate": "measure the plate's dynamics and write them to calibration_file",
    "resume_feeding": "let the feeder continue after a stop",
    "call": "SERVICE: call any service without arguments, such as detector/learn_plate",
}
OTHERS = {
    "goal": "SCENARIO: run the task of a scenario (name or .yaml file); Ctrl-C cancels it",
    "cancel": "cancel all goals",
    "friction": "push the parts slightly, measure their friction and write it to the rig file",
    "state": "print driver_status, task_status, and the diagnostics of each node",
    "params": "[NODE]: list parameters with their values and meanings",
    "get": "NODE NAME: print a parameter",
    "set": "NODE NAME VALUE: change a parameter of a running node",
}


def main() -> None:
    """Run the command line. Exit code 0: done. 1: failed. 2: arguments or files are wrong."""
    signal.signal(signal.SIGINT, _interrupted)  # handle signals during imports
    from plate_core import PlateError, ScenarioError, ends

    from .messages import defer_signals
    from .ros.services import Services, end_ros, start_ros

    args, commands = _arguments(), Services
    if args.command in OTHERS:
        from .ros.graph import Graph

        commands = Graph
    defer_signals()
    code, graph = 1, None
    try:
        start_ros(args.namespace)
        graph = commands(args.namespace)
        print(graph.run(args), flush=True)
        code = 0
    except PlateError as error:
        print(f"plate: {error}", file=sys.stderr)
        if isinstance(error, ScenarioError):
            code = 2
    except KeyboardInterrupt as interrupt:
        code = 128 + int(interrupt.args[0])
    # the program that reads the output has ended, for example in `plate state | head`
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 128 + signal.SIGPIPE
    finally:
        with ends(code):
            end_ros(graph)
    sys.exit(code)


def _interrupted(number: int, frame: FrameType | None) -> None:
    """Exit at once. An exception is not raised here, because a running import might convert it to
    another exception."""
    os.write(sys.stderr.fileno(), b"plate: interrupted\n")
    os._exit(128 + number)


def _arguments() -> argparse.Namespace:
    lines = "\n".join(
        f"  {name:15}{description}" for name, description in (SERVICES | OTHERS).items()
    )
    parser = argparse.ArgumentParser(
        prog="plate", usage="plate COMMAND [--namespace NAME]",
        description="Control the plate's nodes, which run in the ROS domain of "
        f"ROS_DOMAIN_ID:\n{lines}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    commands = parser.add_subparsers(dest="command", required=True, help=argparse.SUPPRESS)
    for name, description in (SERVICES | OTHERS).items():
        command = commands.add_parser(name, description=description)
        # the node is optional here, because the error text for a missing node lists all nodes
        if name in ("get", "set", "params"):
            command.add_argument("node", nargs="?", metavar="NODE")
        if name in ("get", "set"):
            command.add_argument("name", nargs="?", metavar="NAME")
        if name == "call":
            command.add_argument("service", metavar="SERVICE")
        if name == "friction":
            command.add_argument(
                "--write", action="store_true", help="write the result without confirmation"
            )
        if name == "goal":
            command.add_argument("scenario", metavar="SCENARIO")
        if name == "set":
            command.add_argument("value", nargs="?", metavar="VALUE")
        command.add_argument("--namespace", default="", help="namespace of the nodes")
    arguments = sys.argv[1:]
    if arguments and arguments[0] not in (*SERVICES, *OTHERS, "-h", "--help"):
        from plate_core import did_you_mean

        known = (*SERVICES, *OTHERS)
        hint = did_you_mean(arguments[0], known)
        parser.exit(2, f"plate: command is {arguments[0]!r}{hint}, allowed: {', '.join(known)}\n")
    return parser.parse_args()
