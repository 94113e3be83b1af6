"""Measurements of single stages, compared with baselines. `measure(quick)` of each module returns a
`Result`.

`scenes` creates the parts, requests and plate motions that they share.
"""
