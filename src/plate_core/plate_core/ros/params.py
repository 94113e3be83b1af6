"""Parameters as data: a frozen dataclass whose fields say type, range, unit and description."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any, TypeVar

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..errors import PlateError

Options = TypeVar("Options")


@dataclass(frozen=True)
class Spec:
    """What is allowed for one parameter, and whether it may change while the node runs."""

    description: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] | None = None
    live: bool = False

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
        If a value given at start has the wrong type or is out of range: names the parameter, the
        value and what is allowed.
    """
    values = {}
    for item in fields(kind):  # type: ignore[arg-type]  # mypy has no bound for "a dataclass"
        spec: Spec = item.metadata["spec"]
        assert item.default is not MISSING
        node.declare_parameter(item.name, item.default, _descriptor(item.default, spec))
        given = node.get_parameter_or(item.name).value
        values[item.name] = _checked(item.name, given, item.default, spec)
    return kind(**values)


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
    if spec.choices:
        descriptor.additional_constraints = "one of " + ", ".join(spec.choices)
    elif spec.low is not None and spec.high is not None:
        descriptor.additional_constraints = f"{spec.low} to {spec.high}"
    return descriptor
