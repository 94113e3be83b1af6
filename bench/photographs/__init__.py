"""Real photographs of small parts, in which the parts are marked by hand, to evaluate detectors.

`photographs.yaml` lists their sources. `fetch` downloads the photographs, and `evaluate` runs
detectors on the photographs.
"""
