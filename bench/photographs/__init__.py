"""Real photographs of small parts with hand-marked truth, to evaluate detectors.

`photographs.yaml` lists their sources. `fetch` downloads them, and `evaluate` runs detectors on
them.
"""
