"""Measurements of complete tasks in the closed loop. `measure(quick)` of each module returns a
`Result`.

Other folders do not import these modules, except `bench/run.py`, by their names.
"""
