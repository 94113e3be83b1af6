"""Contacts between parts, and between parts and walls. The package detects contacts and computes
contact points and impulses.

Public name: `Contacts`, the parameters of a contact."""

from .parameters import INELASTIC, Contacts

__all__ = ["INELASTIC", "Contacts"]
