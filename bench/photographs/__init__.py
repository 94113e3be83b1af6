"""Real photographs of small parts with hand-marked truth, to evaluate detectors.

`photographs.yaml` lists their sources. `fetch` downloads the photographs, and `evaluate` runs
detectors on the photographs.
"""
