"""Finds parts in camera images and measures their positions and drift."""
