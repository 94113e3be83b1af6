"""Charts of the measurements: as a page, as pictures and in `docs/results.md`.

`bench/charts.py` names every chart.
"""
