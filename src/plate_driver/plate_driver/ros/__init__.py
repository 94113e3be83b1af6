"""ROS code of the driver: subscriptions to serialized messages, and conversion of messages."""

from .messages import bytes_to_cycle, motor_state_to_msg, table_to_msg
from .raw_inputs import RawInput, RawInputs

__all__ = ["RawInput", "RawInputs", "bytes_to_cycle", "motor_state_to_msg", "table_to_msg"]
