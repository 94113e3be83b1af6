"""Parts that touch each other or a wall: which ones, where, and the impulses between them.
Public: `Contacts`, how they touch."""

from .parameters import INELASTIC, Contacts

__all__ = ["INELASTIC", "Contacts"]
