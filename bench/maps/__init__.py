"""Stability maps: where methods fail over two parameters, beside a line where theory says so.

Each module has one `MAP`; `maps.stability` measures them all.
"""
