"""Contacts between parts, and between parts and walls: detection, contact points and impulses.

Public: `Contacts`, the parameters of a contact."""

from .parameters import INELASTIC, Contacts

__all__ = ["INELASTIC", "Contacts"]
