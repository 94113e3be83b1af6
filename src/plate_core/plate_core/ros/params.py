"""ROS parameters of a node, defined by a frozen dataclass.

`parameter` creates a field, which defines the default, type, range and description of one
parameter. `declare` declares the parameters of a node and returns their values. `follow` checks and
applies later changes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import yaml
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..errors import PlateError, did_you_mean

Options = TypeVar("Options")

OF_RCLPY = ("qos_overrides.", "use_sim_time", "start_type_description_service")
"""Prefixes of the names of parameters that rclpy declares. rclpy declares some of these parameters
only after the node's constructor has ended."""


@dataclass(frozen=True)
class Spec:
    """Allowed values of one parameter, and when it is allowed to change.

    A live parameter can be changed at any time. A fixed parameter never changes while the process
    runs. All other parameters can be changed while the node is not active. If the node has no
    lifecycle, they can never be changed. For parameters with a `group`, the help text lists only
    their names, after the name of the group.
    """

    description: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] | None = None
    live: bool = False
    fixed: bool = False
    group: str = ""

    @property
    def allowed(self) -> str:
        """Description of the allowed values. Empty if all values of the correct type are
        allowed."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.low is not None and self.high is not None:
            return f"{self.low} to {self.high}"
        return ""

    def problem(self, name: str, value: Any) -> str | None:
        """Return the reason why a value is refused, or None if it is allowed."""
        if self.choices is not None and value not in self.choices:
            return f"parameter {name} is {value!r}, allowed: one of {', '.join(self.choices)}"
        numeric = isinstance(value, int | float) and not isinstance(value, bool)
        if not numeric or self.low is None or self.high is None or self.low <= value <= self.high:
            return None
        return f"parameter {name} is {value}, allowed: {self.low} to {self.high}"


def parameter(
    default: Any,
    description: str,
    low: float | None = None,
    high: float | None = None,
    choices: Sequence[str] | None = None,
    live: bool = False,
    fixed: bool = False,
    group: str = "",
) -> Any:
    """Return a dataclass field that declares a parameter."""
    spec = Spec(description, low, high, tuple(choices) if choices else None, live, fixed, group)
    return field(default=default, metadata={"spec": spec})


def declare(node: Node, kind: type[Options]) -> Options:
    """Declare the fields of `kind` as parameters of `node`, and return the values of the
    parameters.

    Parameters that must not change are declared as read-only, so ROS refuses any change.

    Raises
    ------
    PlateError
        If a value given at start has the wrong type or is out of range, or if the node has no
        parameter of this name. The message states the parameter, its value and the allowed values.
    """
    # rclpy has no public attribute for the parameter overrides
    values, given = {}, node._parameter_overrides
    for item in fields(kind):  # type: ignore[arg-type]  # mypy has no bound for "a dataclass"
        spec: Spec = item.metadata["spec"]
        assert item.default is not MISSING
        value = given[item.name].value if item.name in given else item.default
        values[item.name] = value = _check_value(item.name, value, item.default, spec)
        descriptor = _make_descriptor(item.default, spec, isinstance(node, LifecycleNode))
        node.declare_parameter(item.name, value, descriptor, ignore_override=True)
    _refuse_unknown(node, tuple(values), getattr(kind, "MOVED", {}))
    node.add_pre_set_parameters_callback(lambda new: [_widen_to_float(node, item) for item in new])
    return kind(**values)


def _refuse_unknown(node: Node, known: Sequence[str], moved: Mapping[str, str]) -> None:
    """Refuse parameters that were given at start but are not declared.

    Such a parameter is misspelled or belongs to an earlier version. For parameters of earlier
    versions, `moved` maps the name to the description of the replacement. If such a parameter
    occurs only in a wildcard section of a parameter file, it may be for other nodes. The parameter
    is then not refused, and only a warning is logged.
    """
    names = [
        name
        for name in node._parameter_overrides
        if not node.has_parameter(name) and not name.startswith(OF_RCLPY)
    ]
    others = wildcard_parameters(sys.argv, node.get_name()) if names else set()
    for name in names:
        if name not in others and name in moved:
            raise PlateError(f"parameter {name} of {node.get_name()} was removed: {moved[name]}")
        if name not in others:
            raise PlateError(_unknown_text(node, name, known))
    if names:
        node.get_logger().warning(
            f"{node.get_name()} ignores parameters that are set for all nodes but unknown to it: "
            f"{', '.join(names)}"
        )


def _unknown_text(node: Node, name: str, known: Sequence[str]) -> str:
    return (
        f"parameter {name} is unknown to {node.get_name()}{did_you_mean(name, known)}, "
        f"allowed: {', '.join(known)}"
    )


def wildcard_parameters(arguments: Sequence[str], node: str) -> set[str]:
    """Return the parameters that are given only in wildcard sections, such as `/**`.

    Parameters
    ----------
    arguments : sequence of str
        Command line of the node.
    node : str
        Name of the node. A section `/**/NAME` is not a wildcard section for the node NAME, because
        it contains the node's name.
    """
    by_wildcard: set[str] = set()
    by_name: set[str] = set()
    for word, value in pairwise(arguments):
        if word in ("-p", "--param"):
            by_name.add(value.partition(":=")[0].rpartition(":")[2])
        elif word == "--params-file":
            # Read all scalars as text, because rcl accepts values that PyYAML refuses, such as an
            # impossible date.
            read = yaml.BaseLoader(Path(value).read_text(encoding="utf-8")).get_single_data()
            for section, name in _list_parameters(read, ""):
                last = section.rpartition("/")[2]
                if last == node:
                    by_name.add(name)
                elif "*" in last:
                    by_wildcard.add(name)
    return by_wildcard - by_name


def _list_parameters(read: Any, section: str) -> Iterator[tuple[str, str]]:
    """Yield the section and the name of each parameter in a file. Sections and parameter names may
    be nested in the file."""
    for key, value in read.items() if isinstance(read, dict) else ():
        if key == "ros__parameters":
            yield from ((section, name) for name in _flatten_names(value, ""))
        else:
            yield from _list_parameters(value, f"{section}/{key}")


def _flatten_names(read: Any, name: str) -> Iterator[str]:
    if not isinstance(read, dict):
        yield name
        return
    for key, value in read.items():
        yield from _flatten_names(value, f"{name}.{key}" if name else str(key))


def set_parameters(
    node: Node,
    parameters: Sequence[Parameter],
    change: Callable[[list[Parameter]], SetParametersResult],
) -> SetParametersResult:
    """Set parameters with the function `change`. A node calls `set_parameters` in its method
    `set_parameters_atomically`.

    If `change` refuses the parameters, it is called again without the parameters that already
    have the requested value. An unknown parameter is refused with a message that states its name.
    """
    new = []
    for item in parameters:
        if not node.has_parameter(item.name):
            known = node.get_parameters_by_prefix("")
            own_names = [name for name in known if not name.startswith(OF_RCLPY)]
            reason = _unknown_text(node, item.name, own_names)
            return SetParametersResult(successful=False, reason=reason)
        requested, present = _widen_to_float(node, item), node.get_parameter(item.name)
        if (requested.type_, requested.value) != (present.type_, present.value):
            new.append(item)
    result = change(list(parameters))
    if result.successful or len(new) == len(parameters):
        return result
    return change(new) if new else SetParametersResult(successful=True)


def follow(
    node: Node,
    options: Options,
    changed: Callable[[Options], None],
    problem: Callable[[str, Spec], str] = lambda name, spec: "",
) -> Callable[[list[Parameter]], SetParametersResult]:
    """Call `changed` with the new options each time a parameter is set.

    A change is refused if a value is not allowed, if `problem` returns a reason, or if `changed`
    raises a `PlateError`. Return the callback that this function has registered at the node.
    """
    current = [options]
    specs = {item.name: item for item in fields(options)}  # type: ignore[arg-type]

    def on_set(parameters: list[Parameter]) -> SetParametersResult:
        new: dict[str, Any] = {}
        for item in parameters:
            known = specs.get(item.name)
            if known is None:
                continue
            spec: Spec = known.metadata["spec"]
            try:
                new[item.name] = _check_value(item.name, item.value, known.default, spec)
                why = problem(item.name, spec)
            except PlateError as error:
                why = str(error)
            if why:
                return SetParametersResult(successful=False, reason=why)
        if new:
            requested = replace(current[0], **new)  # type: ignore[type-var]
            try:
                changed(requested)
            except PlateError as error:
                return SetParametersResult(successful=False, reason=str(error))
            current[0] = requested
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)
    return on_set


def _widen_to_float(node: Node, item: Parameter) -> Parameter:
    """Convert a whole number to a float if the parameter is declared as a float."""
    is_integer = item.type_ is Parameter.Type.INTEGER
    if is_integer and node.get_parameter_or(item.name).type_ is Parameter.Type.DOUBLE:
        return Parameter(item.name, value=float(item.value))
    return item


def _check_value(name: str, value: Any, default: Any, spec: Spec) -> Any:
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not type(default):
        raise PlateError(
            f"parameter {name} is {value!r}, allowed: a value of type {type(default).__name__}"
        )
    problem = spec.problem(name, value)
    if problem:
        raise PlateError(problem)
    return value


def _make_descriptor(default: Any, spec: Spec, managed: bool) -> ParameterDescriptor:
    changes = spec.live or (managed and not spec.fixed)
    descriptor = ParameterDescriptor(description=spec.description, read_only=not changes)
    descriptor.additional_constraints = spec.allowed
    if spec.low is not None and spec.high is not None:
        if isinstance(default, float):
            limits = FloatingPointRange(from_value=float(spec.low), to_value=float(spec.high))
            descriptor.floating_point_range = [limits]
        else:
            integer_range = IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=1)
            descriptor.integer_range = [integer_range]
    return descriptor
