"""Parameters as data: a frozen dataclass whose fields say type, range, unit and description."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..errors import PlateError, did_you_mean

Options = TypeVar("Options")

OF_RCLPY = ("qos_overrides.", "use_sim_time", "start_type_description_service")
"""What rclpy declares by itself, some of it late."""


@dataclass(frozen=True)
class Spec:
    """What is allowed for one parameter, and whether it may change while the node runs."""

    description: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] | None = None
    live: bool = False

    @property
    def allowed(self) -> str:
        """What is allowed, in words; empty where everything of the right type is."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.low is not None and self.high is not None:
            return f"{self.low} to {self.high}"
        return ""

    def problem(self, name: str, value: Any) -> str | None:
        """Return why a value is refused, or None."""
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
) -> Any:
    """Return a dataclass field that declares a parameter."""
    spec = Spec(description, low, high, tuple(choices) if choices else None, live)
    return field(default=default, metadata={"spec": spec})


def declare(node: Node, kind: type[Options]) -> Options:
    """Declare the fields of `kind` as parameters of `node` and return their values.

    What is not `live` is read-only from here on: ROS refuses changes.

    Raises
    ------
    PlateError
        If a value given at start has the wrong type or is out of range, or is of a parameter that
        the node does not have: names the parameter, the value and what is allowed.
    """
    values = {}
    for item in fields(kind):  # type: ignore[arg-type]  # mypy has no bound for "a dataclass"
        spec: Spec = item.metadata["spec"]
        assert item.default is not MISSING
        node.declare_parameter(item.name, item.default, _descriptor(item.default, spec))
        given = node.get_parameter_or(item.name).value
        values[item.name] = _checked(item.name, given, item.default, spec)
    _refuse_unknown(node, tuple(values))
    return kind(**values)


def _refuse_unknown(node: Node, known: Sequence[str]) -> None:
    """Refuse parameters that were given at start and that nobody declares: spelling mistakes."""
    for name in node._parameter_overrides:  # rclpy has no public name for what was given
        if not node.has_parameter(name) and not name.startswith(OF_RCLPY):
            raise PlateError(
                f"parameter {name} is not one of {node.get_name()}{did_you_mean(name, known)}, "
                f"allowed: {', '.join(known)}"
            )


def follow(
    node: Node, options: Options, changed: Callable[[Options], None]
) -> Callable[[list[Parameter]], SetParametersResult]:
    """Call `changed` with new options whenever a live parameter is set; refuse wrong values."""
    current = [options]
    specs = {item.name: item for item in fields(options)}  # type: ignore[arg-type]

    def on_set(parameters: list[Parameter]) -> SetParametersResult:
        new: dict[str, Any] = {}
        for item in parameters:
            known = specs.get(item.name)
            if known is None:
                continue
            try:
                new[item.name] = _checked(
                    item.name, item.value, known.default, known.metadata["spec"]
                )
            except PlateError as error:
                return SetParametersResult(successful=False, reason=str(error))
        if new:
            current[0] = replace(current[0], **new)  # type: ignore[type-var]
            changed(current[0])
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)
    return on_set


def _checked(name: str, value: Any, default: Any, spec: Spec) -> Any:
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


def _descriptor(default: Any, spec: Spec) -> ParameterDescriptor:
    # Ranges are told to tools, but checked by us: rclpy's own message does not say what is allowed.
    descriptor = ParameterDescriptor(
        description=spec.description, dynamic_typing=True, read_only=not spec.live
    )
    descriptor.additional_constraints = spec.allowed
    return descriptor
