"""Simulates parts on the vibrating plate, its camera and its motor controller."""
