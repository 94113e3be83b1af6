"""Turns a task and the parts' positions into the force wanted on each part."""
