"""Stability maps: where methods fail over two parameters, compared with the border by theory.

Each module defines one `MAP`. `maps.stability` measures all maps.
"""
