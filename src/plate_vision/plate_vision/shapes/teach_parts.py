"""The program `teach`: types of parts from pictures of them, in a file. It needs no ROS.

ros2 run plate_vision teach nut nut_1.png nut_2.png --bare plate.png --out parts.yaml
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from plate_core import PlateError, load_rig
from plate_core.rig import PartType

from ..camera import read_pictures, rig_of_picture
from ..errors import TeachError
from ..vision import make_vision
from .part_files import OUT, add_type, colour_text, load_bare, read_types, save_part_types, told
from .teaching import Example, apart, merged

COMMANDS = ("list", "merge", "rename", "delete")
"""Words that are no names of types."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; exit code 2, with one line, if something is wrong."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    managing = bool(words) and words[0] in COMMANDS
    args = (_managing_parser() if managing else _parser()).parse_args(words)
    try:
        args.run(args)
    except (PlateError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="teach",
        description=__doc__.splitlines()[0],
        epilog=f"`teach {'|'.join(COMMANDS)}` work on a file of types: see `teach list --help`.",
    )
    add = parser.add_argument
    add("name", metavar="NAME", help="of the type, as nut")
    add("pictures", metavar="PICTURES", type=Path, nargs="+", help="one to five, or a folder")
    add("--rig", default="", help="rig file, or a name in config/rigs (the default rig)")
    add("--bare", type=Path, help="picture of the bare plate, or a folder of them")
    add("--out", type=Path, default=OUT, help="file of types, written or added to (parts.yaml)")
    parser.set_defaults(run=_teach)
    return parser


def _managing_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="teach", description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    abouts = {
        "list": ("say what types there are", _list, {}),
        "merge": (
            "make one type of two",
            _merge,
            {"name": "that stays", "other": "that goes into it"},
        ),
        "rename": (
            "give a type another name",
            _rename,
            {"name": "as it is", "new": "as it shall be"},
        ),
        "delete": ("forget a type", _delete, {"name": "of the type"}),
    }
    for word, (about, run, names) in abouts.items():
        command = commands.add_parser(word, help=about)
        for name, meaning in names.items():
            command.add_argument(name, metavar=name.upper(), help=meaning)
        command.add_argument("--out", type=Path, default=OUT, help="file of types (parts.yaml)")
        command.set_defaults(run=run)
    return parser


def _teach(args: argparse.Namespace) -> None:
    examples = [
        Example(picture, name=name)
        for path in args.pictures
        for name, picture in read_pictures(path)
    ]
    rig = load_rig(args.rig)
    height, width = examples[0].image.shape[:2]
    rig, doubt = rig_of_picture(rig, (width, height))
    if doubt:
        print(f"warning: {examples[0].name}: {doubt}", file=sys.stderr)
    bare = None if args.bare is None else load_bare(args.bare, (width, height))
    if bare is None:
        print("no bare plate (--bare): its light is taken from each picture", file=sys.stderr)
    vision = make_vision(rig)
    lesson = add_type(args.out, args.name, examples, vision.calibration, bare, vision.region)
    for problem in lesson.unused:
        print(f"warning: not used: {problem}", file=sys.stderr)
    print(told(lesson))
    print(f"{args.out}: types; {args.out.with_name(lesson.part.picture)}: the part taught")


def _known(types: dict[str, PartType], name: str, path: Path) -> PartType:
    if name not in types:
        raise TeachError(
            f"{path}: type {name!r}, allowed: {', '.join(types) or 'none, it is empty'}"
        )
    return types[name]


def _list(args: argparse.Namespace) -> None:
    types = read_types(args.out)
    for part in types.values():
        size = 2e3 * np.sqrt(part.area_m2 / np.pi)
        corners = "disc" if part.radius_m else f"{len(part.outline)} corners"
        print(
            f"{part.name}: {corners}, {len(part.holes)} holes, symmetry {part.symmetry}, "
            f"{size:.2f} mm across, colour {colour_text(part)}"
        )


def _merge(args: argparse.Namespace) -> None:
    types = read_types(args.out)
    part, other = _known(types, args.name, args.out), _known(types, args.other, args.out)
    outlines, _, colours = apart(part, other, 1e3)
    types[args.name] = merged(part, other)
    del types[args.other]
    save_part_types(args.out, types)
    print(
        f"{args.name}: {args.other} is merged into it; they were {outlines:.2f} mm and "
        f"{colours:.0f} Lab apart"
    )


def _rename(args: argparse.Namespace) -> None:
    types = read_types(args.out)
    part = _known(types, args.name, args.out)
    if args.new in types:
        raise TeachError(f"{args.out}: type {args.new!r} is there, allowed: a new name")
    picture = part.picture
    if picture == f"{args.name}.png" and args.out.with_name(picture).exists():
        picture = f"{args.new}.png"
    renamed = {(args.new if name == args.name else name): kept for name, kept in types.items()}
    renamed[args.new] = replace(part, name=args.new, picture=picture)
    save_part_types(args.out, renamed)
    if picture != part.picture:
        args.out.with_name(part.picture).rename(args.out.with_name(picture))
    print(f"{args.name} is {args.new} now")


def _delete(args: argparse.Namespace) -> None:
    types = read_types(args.out)
    part = _known(types, args.name, args.out)
    del types[args.name]
    save_part_types(args.out, types)
    if part.picture:
        args.out.with_name(part.picture).unlink(missing_ok=True)
    print(f"{args.name} is forgotten")


if __name__ == "__main__":
    main()
