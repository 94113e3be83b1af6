"""Applies the rig's limits to plate motions and sends them to the motors."""
