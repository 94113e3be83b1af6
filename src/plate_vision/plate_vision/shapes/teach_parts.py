"""The program `teach`: learn part types from pictures, and manage files of types.

The program does not need ROS. Example:

ros2 run plate_vision teach nut nut_1.png nut_2.png --bare plate.png --out parts.yaml
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from plate_core import PlateError, load_rig, piped
from plate_core.rig import MAX_HEIGHT_M, PartType, load_part_types

from ..camera import read_pictures, rig_of_picture
from ..errors import TeachError, check_size
from ..recognition import calibrate_by_scale
from ..vision import make_vision
from .part_files import (
    OUT,
    add_type,
    colour_text,
    extent_text,
    lesson_text,
    load_bare,
    save_part_types,
)
from .teaching import Example, drawing_file_name, merge_types, type_differences

COMMANDS = ("list", "merge", "rename", "delete")
"""Words that are commands and not names of types, in the order of `_make_management_parser`."""

BOX = (
    "use only the part in this box; X and Y are its upper left corner [px]. Up to five boxes, each "
    "after a --box (default: all parts in the picture)"
)

HEIGHT = (
    "height of the part [m], so that its side faces are not learned; requires a known position of "
    "the camera (default: the type's height in the file, or 0)"
)

SCALE = (
    "scale of pictures that were taken from straight above, all from the same height; they may "
    "have any size (default: pictures of the rig's camera)"
)

AROUND = 1.0
"""Width of the surround of a box, relative to the sides of the box [-]. The surround is also
evaluated."""


@piped()
def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line. If there is an error, print it in one line and exit with code 2."""
    argv = list(sys.argv[1:] if arguments is None else arguments)
    managing = bool(argv) and argv[0] in COMMANDS
    args = (_make_management_parser() if managing else _make_teach_parser()).parse_args(argv)
    try:
        args.run(args)
    except BrokenPipeError:
        raise
    except (PlateError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def _make_teach_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="teach",
        description=(__doc__ or "").partition("\n")[0],
        epilog=f"`teach {'|'.join(COMMANDS)}` work on a file of types: see `teach list --help`.",
    )
    add = parser.add_argument
    add("name", metavar="NAME", help="name of the type, such as nut")
    add("pictures", metavar="PICTURES", type=Path, nargs="+", help="one to five files, or a folder")
    add("--rig", default="", help="rig file, or a name in config/rigs (default: the default rig)")
    add("--bare", type=Path, help="picture of the bare plate, or a folder of pictures")
    add("--box", type=_parse_box, action="append", default=[], metavar="X,Y,WIDTH,HEIGHT", help=BOX)
    add("--scale", type=_parse_scale, metavar="PX_PER_MM", help=SCALE)
    add("--height", type=_parse_height, metavar="M", help=HEIGHT)
    add(
        "--out",
        type=Path,
        default=OUT,
        help="file of types to write or extend (default: parts.yaml)",
    )
    parser.set_defaults(run=_teach)
    return parser


def _make_management_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="teach", description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    abouts: tuple[tuple[Callable[..., None], str, dict[str, str]], ...] = (
        (_list, "list the types", {}),
        (_merge, "merge two types", {"name": "type to keep", "other": "type to merge into it"}),
        (_rename, "rename a type", {"name": "present name", "new": "new name"}),
        (_delete, "delete a type", {"name": "name of the type"}),
    )
    for word, (run, about, names) in zip(COMMANDS, abouts, strict=True):
        command = commands.add_parser(word, help=about)
        for name, meaning in names.items():
            command.add_argument(name, metavar=name.upper(), help=meaning)
        command.add_argument(
            "--out", type=Path, default=OUT, help="file of types (default: parts.yaml)"
        )
        command.set_defaults(run=run)
    return parser


def _parse_box(text: str) -> tuple[int, int, int, int]:
    try:
        x, y, width, height = (int(word) for word in text.split(","))
    except ValueError:
        x = y = width = height = -1
    if min(x, y) < 0 or min(width, height) < 1:
        allowed = "allowed: x, y, width and height in pixels, such as 120,80,60,40"
        raise argparse.ArgumentTypeError(f"box is {text!r}, {allowed}")
    return x, y, width, height


def _parse_scale(text: str) -> float:
    try:
        scale = float(text)
    except ValueError:
        scale = float("nan")
    if not 0.01 <= scale <= 1000:
        raise argparse.ArgumentTypeError(f"scale is {text!r}, allowed: 0.01 to 1000 px/mm")
    return scale


def _parse_height(text: str) -> float:
    try:
        height = float(text)
    except ValueError:
        height = float("nan")
    if not 0 <= height <= MAX_HEIGHT_M:
        raise argparse.ArgumentTypeError(f"height is {text!r}, allowed: 0 to {MAX_HEIGHT_M:g} m")
    return height


def _teach(args: argparse.Namespace) -> None:
    pictures = [named for path in args.pictures for named in read_pictures(path)]
    if args.box and len(pictures) > 1:
        raise TeachError(f"--box: number of pictures is {len(pictures)}, allowed: 1")
    name, picture = pictures[0]
    size = picture.shape[1], picture.shape[0]
    for x, y, width, height in args.box:
        if x + width > size[0] or y + height > size[1]:
            where = f"--box: box is {x},{y},{width},{height}"
            raise TeachError(f"{where}, allowed: within {size[0]} x {size[1]} px of {name}")
    if args.scale is None or args.bare is not None:
        for other, pixels in pictures:
            why = ", the size of the first picture; or use --scale without --bare"
            check_size(f"{other}:", pixels.shape[1::-1], size, TeachError, why)
    region = None
    if args.scale is not None:
        calibration = calibrate_by_scale(1e3 * args.scale)
    else:
        rig, warning = rig_of_picture(load_rig(args.rig), size)
        if warning:
            print(f"warning: {name}: {warning}; or use --scale", file=sys.stderr)
        try:
            vision = make_vision(rig)
        except PlateError as error:
            hint = "; if it does not show the whole plate, use --scale" if warning else ""
            raise TeachError(f"{name}: {error}{hint}") from None
        calibration, region = vision.calibration, vision.region
    bare = None if args.bare is None else load_bare(args.bare, size)
    if bare is None:
        print(
            "without --bare, the bare plate is estimated from each picture. The outline of a hole "
            "may then be learned instead of the outline of the part. Check the drawn outline.",
            file=sys.stderr,
        )
    if args.box:
        # If the scale is given and there is no bare plate, the position of the part in the picture
        # has no effect. In this case, the picture can be cut.
        cuts = args.scale is not None and bare is None
        examples = [
            _make_example(picture, box, f"{name}, box {','.join(map(str, box))}", cuts)
            for box in args.box
        ]
    else:
        examples = [Example(pixels, name=other) for other, pixels in pictures]
    lesson = add_type(args.out, args.name, examples, calibration, bare, region, args.height)
    for problem in lesson.unused:
        print(f"warning: example not used: {problem}", file=sys.stderr)
    for warning in lesson.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(lesson_text(lesson))
    picture_file = args.out.with_name(lesson.part.picture)
    print(f"written: {args.out} (types), {picture_file} (picture of the taught part)")


def _make_example(
    picture: np.ndarray, box: tuple[int, int, int, int], name: str, cuts: bool
) -> Example:
    """Return the example that a box in a picture contains. If `cuts`, the picture is cut to the box
    and its surround."""
    x, y, width, height = box
    if not cuts:
        return Example(picture, (x, y, x + width, y + height), name)
    left, top = max(0, x - round(AROUND * width)), max(0, y - round(AROUND * height))
    right, bottom = x + width + round(AROUND * width), y + height + round(AROUND * height)
    inner = (x - left, y - top, x - left + width, y - top + height)
    return Example(picture[top:bottom, left:right].copy(), inner, name)


def _find_type(types: dict[str, PartType], name: str, path: Path) -> PartType:
    if name not in types:
        raise TeachError(
            f"{path}: type is {name!r}, allowed: {', '.join(types) or 'none, the file is empty'}"
        )
    return types[name]


def _list(args: argparse.Namespace) -> None:
    for part in load_part_types(args.out).values():
        corners = "disc" if part.radius_m else f"{len(part.outline)} corners"
        print(
            f"{part.name}: {corners}, {len(part.holes)} holes, symmetry {part.symmetry}, "
            f"{extent_text(part)}, colour {colour_text(part)}"
        )


def _merge(args: argparse.Namespace) -> None:
    types = dict(load_part_types(args.out))
    if args.name == args.other:
        raise TeachError(f"{args.out}: both types are {args.other!r}, allowed: different types")
    part, other = _find_type(types, args.name, args.out), _find_type(types, args.other, args.out)
    outlines, _, colours = type_differences(part, other, 1e3)
    types[args.name] = merge_types(part, other)
    del types[args.other]
    save_part_types(args.out, types)
    print(
        f"{args.name}: {args.other} was merged into it; their outlines differed by "
        f"{outlines:.2f} mm, their colours by {colours:.0f} Lab"
    )


def _rename(args: argparse.Namespace) -> None:
    types = dict(load_part_types(args.out))
    part = _find_type(types, args.name, args.out)
    if args.new in types:
        raise TeachError(f"{args.out}: type {args.new!r} exists, allowed: a new name")
    picture = part.picture
    if picture == drawing_file_name(args.name) and args.out.with_name(picture).exists():
        picture = drawing_file_name(args.new)
    renamed = {(args.new if name == args.name else name): kept for name, kept in types.items()}
    renamed[args.new] = replace(part, name=args.new, picture=picture)
    save_part_types(args.out, renamed)
    if picture != part.picture:
        args.out.with_name(part.picture).rename(args.out.with_name(picture))
    print(f"{args.name} was renamed to {args.new}")


def _delete(args: argparse.Namespace) -> None:
    types = dict(load_part_types(args.out))
    part = _find_type(types, args.name, args.out)
    del types[args.name]
    save_part_types(args.out, types)
    # delete only the picture that this program has drawn, not a picture of the user
    if part.picture == drawing_file_name(args.name):
        args.out.with_name(part.picture).unlink(missing_ok=True)
    print(f"{args.name} was deleted")


if __name__ == "__main__":
    main()
