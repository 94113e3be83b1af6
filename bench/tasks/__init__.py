"""Measurements of complete tasks in the closed loop. `measure(quick)` of each module returns a
`Result`.

No other folder imports these modules. Only `bench/run.py` loads these modules, by their names.
"""
