"""Definitions of the keys of a scenario file.

Each key has a type, a range and a meaning. The readers check values by these definitions, and
docs/reference.md is generated from them.
"""

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
"""Classes of parts on rigs without part types. Detector and simulator distinguish these classes."""

CURVES = ("waypoints_m", "circle", "spline_m")
"""Keys that define the curve of a path. A path has exactly one of these keys."""

OR_ANOTHER = "or another curve"

SLOWEST_MPS, FASTEST_MPS = 1e-5, 10.0
"""Allowed range of the speed along a path [m/s]."""

ALL_DIFFERENT = "each class once"
ANGLE_ERROR = "Maximum error of a part's angle."
PLACE = Numbers((2,), -FAR_M, FAR_M)
PLACES = Numbers((None, 2), -FAR_M, FAR_M)
TOLERANCE = Key(
    "tolerance_m", Number(1e-4, 1), "Maximum distance of a part's centre from its place."
)
HOLD = Key(
    "hold_s",
    Number(0, 60),
    "Time for which the goal must hold without interruption; shorter than `time_limit_s`.",
)


def class_key(*labels: str) -> Key:
    """Return the definition of the key `class` of a path, a pose or a pick. The value of this key
    must be one of the classes of the scenario."""
    kind = Choice(labels) if labels else Text("a class of `parts`")
    return Key("class", kind, "Class of the part.")


FILE = Section(
    "scenario file",
    "The parts on the plate, and one task.",
    (
        Key("description", Text(), "Description of the task in one sentence."),
        Key(
            "marked", Flag(), "Whether each round part has a mark that shows its angle; `pose` "
            "requires it.", False,
        ),
        Key(
            "rig", Text("a name in config/rigs, or the path of a .yaml file"), "Rig that "
            "is used if no other rig is selected. A path is relative to the scenario's folder.",
            "", "any rig",
        ),
        Key("parts", List(), "One entry for each class."),
        Key("task", Table(), "Kind of the task, and the keys of this kind."),
        Key(
            "time_limit_s", Number(0.1, 1e5), "Maximum duration, from the detection of all parts. "
            "Longer tasks fail. Required, except for `feed` and with `until_canceled`.",
            None, "none",
        ),
    ),
)  # fmt: skip

GROUP = Section(
    "parts[]",
    "The parts of one class, at given or random places.",
    (
        Key(
            "class", Text("black, grey, or a type of the rig's `types`"), "`black` and `grey` "
            "are round parts that differ in brightness. The key `parts` of the rig file defines "
            "their mass, radius and height. If the rig has `types`, only its types are allowed.",
        ),
        Key(
            "count", Whole(0, 100), "Number of parts at random places (by `seed`). Their centres "
            "are five radii apart (less if necessary) and away from the edges. 0 requires the task "
            "`feed`.",
            None, "or `positions_m`",
        ),
        Key(
            "positions_m", PLACES, "Initial centre of each part, at least two radii from any "
            "other.",
            None, "or `count`",
        ),
    ),
)  # fmt: skip

TASK = Section(
    "task",
    "The task.",
    (
        Key(
            "kind",
            Choice(KINDS),
            "Kind of the task. The sections below list the keys of each kind.",
        ),
    ),
)

SORT = Section(
    "task, kind: sort",
    "Moves every class to its region. The task is done when all parts have been in their regions "
    "for `hold_s`.",
    (
        Key(
            "regions", Table("for each class a side, a corner, or {bin_m: ...}"), "Region of "
            f"each class: {', '.join(SIDES)}, or a polygon. Regions must not overlap. The key "
            "`sides` is a synonym.",
        ),
        Key(
            "goal_fraction", Number(0, 0.8), "Distance of sides and corners from the middle "
            "of the plate. It is a fraction of the half length (left and right), of the half "
            "width (bottom and top), or of both (corners).",
            None, "not needed if all regions are polygons",
        ),
        HOLD,
    ),
)  # fmt: skip

BIN = Section(
    "task, kind: sort, a polygon in regions",
    "A polygonal region.",
    (
        Key(
            "bin_m", PLACES, "Three or more corners [x, y] on the plate, in order. The polygon "
            "must have space for the parts of its class, 3.5 radii apart.",
        ),
    ),
)  # fmt: skip

FOLLOW = Section(
    "task, kind: follow",
    "Moves all parts to the starts of their paths, then each part along its path. "
    "The task is done when all paths are completed.",
    (
        Key("paths", List(), "One path per part."),
        Key(
            "max_error_m",
            Number(1e-4, 10),
            "Maximum distance of a part from its reference; a larger distance ends the task. All "
            "parts slow down while one of these distances exceeds 15 % of the maximum.",
        ),
    ),
)

PATH = Section(
    "task, kind: follow, paths[]",
    f"The path of one part. Exactly one of the keys {', '.join(CURVES)} gives its shape.",
    (
        class_key(),
        Key("waypoints_m", PLACES, "Two or more corners [x, y] of a polygon.", None, OR_ANOTHER),
        Key("circle", Table(), "Circle, with the keys of the next section.", None, OR_ANOTHER),
        Key(
            "spline_m", PLACES, "Three or more points [x, y] of a cubic spline.", None, OR_ANOTHER,
        ),
        Key(
            "speed_mps", Number(SLOWEST_MPS, FASTEST_MPS), "Speed along the path. "
            "A list of pairs [fraction of a lap, m/s] from 0 to 1 sets a profile, which is "
            "interpolated linearly.",
        ),
        Key(
            "closed", Flag(), "Whether the path is closed, from the last point to the first.", None,
            "needed except for a circle",
        ),
        Key(
            "laps", Number(0.01, 1000), "Number of laps.", None, "needed; 1 for open paths",
        ),
    ),
)  # fmt: skip

CIRCLE = Section(
    "task, kind: follow, paths[], circle",
    "A circle.",
    (
        Key("centre_m", PLACE, "Centre [x, y]."),
        Key("radius_m", Number(1e-4, FAR_M), "Radius."),
        Key(
            "start_deg", Number(-360, 360), "Direction from the centre to the start of the path, "
            "counter-clockwise from x.", 0.0,
        ),
        Key("turn", Choice(("left", "right")), "Direction of motion. left: counter-clockwise; "
            "right: clockwise."),
    ),
)  # fmt: skip

ASSEMBLE = Section(
    "task, kind: assemble",
    "Moves parts to a pattern of places. The task is done when every place has had a part of its "
    "class for `hold_s`.",
    (
        Key(
            "places_m", Table("for each class a list of [x, y]"), "One place per part of the "
            "class, at least 2.5 radii apart. The planner assigns the parts.",
        ),
        TOLERANCE,
        HOLD,
    ),
)  # fmt: skip

POSE = Section(
    "task, kind: pose",
    "Moves every part to a place and an angle. The task is done when all parts have been there for "
    "`hold_s`. Round parts require `marked: true`.",
    (
        Key("poses", List(), "One pose per part."),
        Key(
            "anywhere",
            Flag(),
            "Whether parts without `place_m` can end anywhere. If false, they stay in place.",
            False,
        ),
        TOLERANCE,
        Key("tolerance_deg", Number(0.1, 180), ANGLE_ERROR),
        HOLD,
    ),
)

POSES = Section(
    "task, kind: pose, poses[]",
    "Target of one part: its place, and the direction of the part or its mark.",
    (
        class_key(),
        Key("angle_deg", Number(-360, 360), "Angle, counter-clockwise from x."),
        Key("place_m", PLACE, "Place [x, y].", None, "the present place"),
    ),
)

MOVE = Section(
    "task, kind: move",
    "Moves parts to individual targets, which the topic `targets` can change. A part without a "
    "target stays in place, but gives way to others. The task is done when all targets have been "
    "reached for `hold_s`.",
    (
        Key("targets", List(), "One target per part.", None, "none"),
        TOLERANCE,
        Key(
            "tolerance_deg", Number(0.1, 180), ANGLE_ERROR, 5.0
        ),
        HOLD,
        Key("until_canceled", Flag(), "Whether the task runs until it is canceled.", False),
    ),
)  # fmt: skip

MOVES = Section(
    "task, kind: move, targets[]",
    "Target of one part.",
    (
        Key("id", Text("a class of `parts` and a number, such as black_1"), "Id of the part."),
        Key("place_m", PLACE, "Place [x, y]."),
        Key(
            "angle_deg", Number(-360, 360), "Angle, counter-clockwise from x. Round parts must "
            "be `marked`.", None, "any",
        ),
    ),
)  # fmt: skip

FEED = Section(
    "task, kind: feed",
    "Keeps parts ready for a robot, until the task is canceled. Parts of classes that are not in "
    "`picks` go to the chute.",
    (
        Key("picks", List(), "One entry per requested class."),
        Key(
            "clearance_m", Number(0, 0.5), "Minimum gap between a ready part and any other "
            "part.",
        ),
        Key(
            "chute", Choice(("left", "right", "bottom", "top")), "Side over which unwanted "
            "parts leave the plate.", None, "none, they stay",
        ),
        Key("hopper", Table(), "Hopper, which drops new parts onto the plate.", None, "none"),
        Key(
            "timeout_s"
        , Number(0.1, 3600), "Maximum time for which a robot waits for a part.", 30.0),
        Key("valid_s", Number(0.1, 3600), "Time for which a part is reserved for the robot.", 10.0),
    ),
)  # fmt: skip

PICK = Section(
    "task, kind: feed, picks[]",
    "Parts of one class that are kept ready for the robot.",
    (
        class_key(),
        Key("window_m", Numbers((2, 2), -FAR_M, FAR_M), "Lower left and upper right corner [x, y] "
            "of the pick window. The centres of ready parts are inside it.", None,
            "the plate without the stroke and 1.25 radii along its edges"),
        Key("ready", Whole(1, 100), "Number of parts that are ready at the same time.", 1),
        Key("angle_deg", Number(-360, 360), "Angle of ready parts.", None, "any"),
        Key("tolerance_deg", Number(0.1, 180), ANGLE_ERROR, 5.0),
    ),
)  # fmt: skip

HOPPER = Section(
    "task, kind: feed, hopper",
    "Hopper, which drops new parts onto the plate. It opens when parts are missing, until enough "
    "parts have dropped.",
    (
        Key("fill", Whole(1, 100), "Number of parts on the plate after a refill."),
        Key("least", Whole(1, 100), "Minimum number of parts on the plate. If there are fewer, the "
            "hopper opens.", None, "`fill`"),
        Key("rate_ps", Number(0.1, 1000), "Number of dropped parts per second."),
        Key("place_m", PLACE, "Centre of the drop area [x, y]."),
        Key("spread_m", Number(0.001, 1), "Radius of the drop area."),
        Key("mix", Table("for each class a fraction, 1 in all"), "Fraction of each class among "
            "the dropped parts. The classes in `picks` are "
            "required.", None, "the classes of `picks`, equally"),
    ),
)  # fmt: skip

SECTIONS = (
    FILE, GROUP, TASK, SORT, BIN, FOLLOW, PATH, CIRCLE, ASSEMBLE, POSE, POSES, MOVE, MOVES,
    FEED, PICK, HOPPER,
)  # fmt: skip
"""All sections of a scenario file, in the order of docs/reference.md."""
