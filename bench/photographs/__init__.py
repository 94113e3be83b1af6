"""Real photographs of small parts, with truth marked by hand: how many are found, and by whom.

`photographs.yaml` says where they come from; `fetch` brings them, `evaluate` judges detectors.
"""
