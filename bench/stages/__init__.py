"""Measurements of single stages, compared with baselines. `measure(quick)` of each module returns a
`Result`.

`scenes` creates parts, requests and plate motions for several of these modules.
"""
