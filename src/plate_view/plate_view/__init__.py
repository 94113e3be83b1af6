"""A live web page of the graph: its data, its commands, and the access rules."""

from .access import Access, AccessError, Role
from .commands import COMMANDS, URGENT, Command, CommandError, read_command

__all__ = [
    "COMMANDS", "URGENT", "Access", "AccessError", "Command", "CommandError", "Role",
    "read_command",
]  # fmt: skip
