"""Measurements of whole tasks in the closed loop: `measure(quick)` of a module gives its `Result`.

Nothing here is imported from outside, but by `bench/run.py` by its name.
"""
