"""Finds the plate motion whose friction gives each part the force wanted."""
