"""Definitions of the keys of a scenario file: type, range and meaning (docs/reference.md)."""

from __future__ import annotations

from ..rig.keys import FAR_M
from ..yaml_fields import Choice, Flag, Key, List, Number, Numbers, Section, Table, Text, Whole
from .tasks import Side

SIDES = {
    "left": Side(-1, 0), "right": Side(1, 0), "bottom": Side(0, -1), "top": Side(0, 1),
    "bottom_left": Side(-1, -1), "bottom_right": Side(1, -1),
    "top_left": Side(-1, 1), "top_right": Side(1, 1),
}  # fmt: skip
"""Sides and corners of the plate."""


def side_name(side: Side) -> str:
    """Return the name of a side or corner."""
    return next(name for name, each in SIDES.items() if each == side)


KINDS = ("sort", "follow", "assemble", "pose", "move", "feed")
"""Kinds of task."""

CLASSES = ("black", "grey")
"""Default classes of parts that detector and simulator can distinguish."""

CURVES = ("waypoints_m", "circle", "spline_m")
"""Alternative keys that define a path."""

SLOWEST_MPS, FASTEST_MPS = 1e-5, 10.0
"""Allowed range of the speed along a path [m/s]."""

ALL_DIFFERENT = "each class once"
PLACE = Numbers((2,), -FAR_M, FAR_M)
PLACES = Numbers((None, 2), -FAR_M, FAR_M)
TOLERANCE = Key(
    "tolerance_m", Number(1e-4, 1), "A part is there when its centre is this near its place."
)
HOLD = Key(
    "hold_s",
    Number(0, 60),
    "The task is done when its goal has been met for so long, unbroken; "
    "shorter than `time_limit_s`.",
)


def class_key(*labels: str) -> Key:
    """Return the key `class` of a path or a pose, one of the classes of the scenario."""
    kind = Choice(labels) if labels else Text("a class of `parts`")
    return Key("class", kind, "Class of the part that is meant.")


FILE = Section(
    "scenario file",
    "One task: parts on the plate, and what is to be done with them.",
    (
        Key("description", Text(), "The task, in a sentence."),
        Key(
            "marked", Flag(), "Whether each round part has a spot that shows its angle, as `pose` "
            "needs.", False,
        ),
        Key(
            "rig", Text("a name in config/rigs, or the path of a .yaml file"), "The rig that is "
            "taken where none is chosen. A path begins at the scenario's folder.",
            "", "any rig will do",
        ),
        Key("parts", List(), "One entry for each class."),
        Key("task", Table(), "`kind`, and the keys of that kind."),
        Key(
            "time_limit_s", Number(0.1, 1e5), "Longest time from the task's beginning, in which "
            "all parts were seen, to its end; a task that takes longer has failed.",
            None, "none; with `until_canceled` there may be no limit",
        ),
    ),
)  # fmt: skip

GROUP = Section(
    "parts[]",
    "The parts of one class: placed, or scattered at random.",
    (
        Key(
            "class", Text("black, grey, or a type of the rig's `types`"), "`black` and `grey` "
            "are round, as `parts` in the rig file says, and differ in brightness; a rig with "
            "`types` has these, and no others.",
        ),
        Key(
            "count", Whole(0, 100), "How many, scattered at random (by `seed`): five radii from "
            "centre to centre, or less where so many do not fit, and clear of the edges. 0 only in "
            "a task of `feed`.",
            None, "or `positions_m`",
        ),
        Key(
            "positions_m", PLACES, "Where the centre of each starts, two radii or more from that "
            "of any other.",
            None, "or `count`",
        ),
    ),
)  # fmt: skip

TASK = Section(
    "task",
    "What is to be done.",
    (Key("kind", Choice(KINDS), "Each kind has keys of its own, below."),),
)

SORT = Section(
    "task, kind: sort",
    "Every class to its region. Done when all parts have been in their regions for `hold_s`.",
    (
        Key(
            "regions", Table("for each class a side, a corner, or {bin_m: ...}"), "Where each "
            f"class belongs: {', '.join(SIDES)}, or a polygon. Regions of two classes have no area "
            "in common. `sides` is another word for it.",
        ),
        Key(
            "goal_fraction", Number(0, 0.8), "Where sides and corners begin, from the plate's "
            "middle: as a fraction of the half length for left and right, of the half width for "
            "bottom and top; a corner lies beyond both.",
            None, "none; for bins alone it is not needed",
        ),
        HOLD,
    ),
)  # fmt: skip

BIN = Section(
    "task, kind: sort, a polygon in regions",
    "A region with corners of its own.",
    (
        Key(
            "bin_m", PLACES, "Corners [x, y] in order, three or more, on the plate. There must be "
            "room for the parts of its class 3.5 radii apart.",
        ),
    ),
)  # fmt: skip

FOLLOW = Section(
    "task, kind: follow",
    "Every part along its own path, once all were led to the first points of their paths. "
    "Done when all paths are run.",
    (
        Key("paths", List(), "One path for each part."),
        Key(
            "max_error_m",
            Number(1e-4, 10),
            "A part further from where it should be ends the "
            "task; from 0.15 of it on all parts are slowed down.",
        ),
    ),
)

PATH = Section(
    "task, kind: follow, paths[]",
    f"The path of one part, given by one of {', '.join(CURVES)}.",
    (
        class_key(),
        Key("waypoints_m", PLACES, "Corners [x, y] of a polygon, two or more.", None, "see above"),
        Key("circle", Table(), "Its keys are below.", None, "see above"),
        Key(
            "spline_m", PLACES, "Points [x, y] of a cubic spline, three or more.", None, "see above"
        ),
        Key(
            "speed_mps", Number(SLOWEST_MPS, FASTEST_MPS), "Speed along the path; or pairs "
            "[fraction of a lap, m/s] from 0 to 1, linear between them.",
        ),
        Key(
            "closed", Flag(), "Whether the last corner leads back to the first.", None,
            "none; a circle is closed",
        ),
        Key(
            "laps", Number(0.01, 1000), "How many times round; 0.5 is half a round.",
            None, "none; open paths: 1",
        ),
    ),
)  # fmt: skip

CIRCLE = Section(
    "task, kind: follow, paths[], circle",
    "A circle.",
    (
        Key("centre_m", PLACE, "Its centre [x, y]."),
        Key("radius_m", Number(1e-4, FAR_M), "Its radius."),
        Key(
            "start_deg", Number(-360, 360), "Where the path begins, counter-clockwise from x.", 0.0,
        ),
        Key("turn", Choice(("left", "right")), "left: counter-clockwise; right: clockwise."),
    ),
)  # fmt: skip

ASSEMBLE = Section(
    "task, kind: assemble",
    "A pattern of places is filled. Done when every place has had a part of its class for "
    "`hold_s`.",
    (
        Key(
            "places_m", Table("for each class a list of [x, y]"), "As many as there are parts "
            "of the class, 2.5 radii or more from each other; the planner chooses which part goes "
            "where.",
        ),
        TOLERANCE,
        HOLD,
    ),
)  # fmt: skip

POSE = Section(
    "task, kind: pose",
    "Every part to a place and an angle. Done when all have been there for `hold_s`. "
    "Round parts need `marked: true`.",
    (
        Key("poses", List(), "One pose for each part."),
        Key(
            "anywhere",
            Flag(),
            "Whether parts without `place_m` may be anywhere; else they stay where they are.",
            False,
        ),
        TOLERANCE,
        Key("tolerance_deg", Number(0.1, 180), "A part has turned when its angle is this near."),
        HOLD,
    ),
)

POSES = Section(
    "task, kind: pose, poses[]",
    "Where one part is to be, and which way it, or its mark, is to point.",
    (
        class_key(),
        Key("angle_deg", Number(-360, 360), "Counter-clockwise from x."),
        Key("place_m", PLACE, "Its place [x, y].", None, "it stays where it is"),
    ),
)

MOVE = Section(
    "task, kind: move",
    "Parts to targets of their own, which topic `targets` may change. A part without one is to "
    "stay where it is, but gives way. Done when all targets have been reached for `hold_s`.",
    (
        Key("targets", List(), "One for each part that is to be moved.", None, "none"),
        TOLERANCE,
        Key(
            "tolerance_deg", Number(0.1, 180), "A part has turned when its angle is this near.", 5.0
        ),
        HOLD,
        Key("until_canceled", Flag(), "It goes on until it is canceled, and is never done.", False),
    ),
)  # fmt: skip

MOVES = Section(
    "task, kind: move, targets[]",
    "Where one part is to come.",
    (
        Key("id", Text("a class of `parts` and a number, such as black_1"), "The part."),
        Key("place_m", PLACE, "Its place [x, y]."),
        Key(
            "angle_deg", Number(-360, 360), "Counter-clockwise from x; of round parts only if they "
            "are `marked`.", None, "any",
        ),
    ),
)  # fmt: skip

FEED = Section(
    "task, kind: feed",
    "A feeder: parts lie ready for a robot while parts come and go, until it is canceled. Parts of "
    "classes without an entry in `picks` are brought to the chute.",
    (
        Key("picks", List(), "One entry for each class that is wanted."),
        Key(
            "clearance_m", Number(0, 0.5), "Least distance of a ready part's rim from that of "
            "any other part.",
        ),
        Key(
            "chute", Choice(("left", "right", "bottom", "top")), "Side over which parts leave "
            "that nobody wants.", None, "none: they stay",
        ),
        Key("hopper", Table(), "Where new parts come from.", None, "none"),
        Key("timeout_s", Number(0.1, 3600), "Longest wait for a part.", 30.0),
        Key("valid_s", Number(0.1, 3600), "So long a part is reserved for the robot.", 10.0),
    ),
)  # fmt: skip

PICK = Section(
    "task, kind: feed, picks[]",
    "Parts of one class that are to be ready.",
    (
        class_key(),
        Key("window_m", Numbers((2, 2), -FAR_M, FAR_M), "Corners [x, y] of the pick window, lower "
            "left and upper right: their centres are to lie in it.", None,
            "the plate, but for the stroke and 1.25 radii along its edges"),
        Key("ready", Whole(1, 100), "How many are to be ready at once.", 1),
        Key("angle_deg", Number(-360, 360), "In which they are to lie.", None, "any"),
        Key("tolerance_deg", Number(0.1, 180), "How far from that they may lie.", 5.0),
    ),
)  # fmt: skip

HOPPER = Section(
    "task, kind: feed, hopper",
    "It is opened for as long as the missing parts take when there are too few.",
    (
        Key("fill", Whole(1, 100), "How many parts are to be on the plate."),
        Key("least", Whole(1, 100), "It is opened when there are fewer.", None, "`fill`"),
        Key("rate_ps", Number(0.1, 1000), "Parts a second that drop while it is open."),
        Key("place_m", PLACE, "Where they drop [x, y]."),
        Key("spread_m", Number(0.001, 1), "How far around it they drop."),
        Key("mix", Table("for each class a fraction, 1 in all"), "Classes of the parts that drop; "
            "some of each in `picks`.", None, "the classes of `picks`, each as often"),
    ),
)  # fmt: skip

SECTIONS = (
    FILE, GROUP, TASK, SORT, BIN, FOLLOW, PATH, CIRCLE, ASSEMBLE, POSE, POSES, MOVE, MOVES,
    FEED, PICK, HOPPER,
)  # fmt: skip
"""All sections of a scenario file, in the order of the reference."""
