"""The camera: image encodings, the lens, boards and markers to determine it, and its files.

Other packages use the names below. `calibrate_camera` is the program `calibrate`.
"""

from .boards import Board, LensFit, draw_board, find_board, fit_lens
from .encodings import (
    bits_hint,
    decode,
    decode_file,
    grey_levels,
    largest_in_file,
    largest_number,
)
from .files import Pictures, load_lens, read_pictures, rig_of_picture, save_lens, write_picture
from .lens import (
    Calibration,
    Lens,
    calibrate,
    calibrate_by_matrix,
    calibrate_by_rig,
    lens_keys,
    rig_lens,
)
from .markers import draw_marker, find_markers, square_corners
from .regions import Region

__all__ = [
    "Board",
    "Calibration",
    "Lens",
    "LensFit",
    "Pictures",
    "Region",
    "bits_hint",
    "calibrate",
    "calibrate_by_matrix",
    "calibrate_by_rig",
    "decode",
    "decode_file",
    "draw_board",
    "draw_marker",
    "find_board",
    "find_markers",
    "fit_lens",
    "grey_levels",
    "largest_in_file",
    "largest_number",
    "lens_keys",
    "load_lens",
    "read_pictures",
    "rig_lens",
    "rig_of_picture",
    "save_lens",
    "square_corners",
    "write_picture",
]
