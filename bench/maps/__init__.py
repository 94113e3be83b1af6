"""Stability maps: measured regions of two parameters in which methods fail, compared with the
border by theory.

Each module defines one `MAP`. `maps.stability` measures all maps.
"""
