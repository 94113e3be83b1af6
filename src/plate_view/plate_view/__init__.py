"""A live page of the graph: what it shows, what it may ask for, and who may ask."""

from .access import Access, AccessError, Role
from .commands import COMMANDS, URGENT, Command, CommandError, read_command

__all__ = [
    "COMMANDS", "URGENT", "Access", "AccessError", "Command", "CommandError", "Role",
    "read_command",
]  # fmt: skip
