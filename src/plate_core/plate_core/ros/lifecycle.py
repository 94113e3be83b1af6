"""Transitions of lifecycle nodes that say why they fail."""

from __future__ import annotations

import functools
import traceback
from collections.abc import Callable
from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from ..errors import PlateError

Transition = Callable[[Any, LifecycleState], TransitionCallbackReturn]


def logged(transition: Transition) -> Transition:
    """Log what a transition raises: rclpy turns it into an error state without a word."""

    @functools.wraps(transition)
    def wrapper(self: Any, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return transition(self, state)
        except PlateError as error:
            self.problem = str(error)
            if not self.starting:  # `start` raises it: one problem, one line
                self.get_logger().error(f"{transition.__name__}: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception:  # whatever it is: unlogged, it would be an error state without a reason
            self.problem = traceback.format_exc()
            self.get_logger().error(f"{transition.__name__} failed:\n{self.problem}")
            return TransitionCallbackReturn.ERROR

    return wrapper


class SafeLifecycleNode(LifecycleNode):
    """A lifecycle node that rests before it stops being active, however it ends.

    A subclass makes things in `on_configure`, hands them to `keep`, and says what `begin`, `rest`
    and `release` do.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.problem = ""
        self.starting = False
        self.active = False
        self._kept: list[tuple[Callable[[Any], Any], Any]] = []

    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:
        """Answer a request for a transition that the state does not have with `success: false`.

        rclpy lets the error of its state machine end the process, and has no public place for this.
        """
        try:
            # mypy does not know names that Python has mangled.
            return super()._LifecycleNodeMixin__on_change_state(request, response)  # type: ignore[misc]
        except RuntimeError as error:  # RCLError, which has no public name
            wanted = request.transition.label or request.transition.id
            self.get_logger().error(f"transition {wanted} refused: {error}")
            response.success = False
            return response

    def start(self) -> None:
        """Configure and activate.

        Raises
        ------
        PlateError
            If that fails: why.
        """
        self.starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                raise PlateError(self.problem)
        self.starting = False

    def keep(self, destroy: Callable[[Any], Any], *things: Any) -> None:
        """Have things destroyed at clean-up."""
        self._kept += [(destroy, thing) for thing in things]

    def begin(self) -> None:
        """Make ready for work: `active` is set next."""

    def rest(self) -> None:
        """Leave nothing moving."""

    def release(self) -> None:
        """Let go of what ROS does not know of."""

    @logged
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to listen and to publish."""
        result = super().on_activate(state)
        self.begin()
        self.active = True
        return result

    @logged
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Rest, then fall silent."""
        self._stop()
        return super().on_deactivate(state)

    @logged
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release everything that on_configure made."""
        self._release()
        return super().on_cleanup(state)

    @logged
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Rest and release everything."""
        self._stop()
        self._release()
        return super().on_shutdown(state)

    @logged
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Rest if that still works, and begin anew from unconfigured."""
        try:
            self._stop()
        finally:
            self._release()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Rest, also when the process has to stop."""
        if self.active and self.context.ok():
            self.trigger_deactivate()
        super().destroy_node()

    def _stop(self) -> None:
        if self.active:
            self.active = False
            self.rest()

    def _release(self) -> None:
        for destroy, thing in self._kept:
            destroy(thing)
        self._kept = []
        self.release()
