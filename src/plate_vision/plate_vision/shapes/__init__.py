"""Parts of any outline, size and brightness, on a background that is learned from the image.

`detection` calls `find_outlines` where nothing is known of the parts.
"""

from .segmentation import OUTLINE, find_outlines

__all__ = ["OUTLINE", "find_outlines"]
