"""Definitions of the keys of a scenario file.

Each key has a type, a range and a meaning. The readers check values by these definitions, and
docs/reference.md is generated from them.
"""

from __future__ import annotations

from ..rig.keys import MAX_XY
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
    return next(name for name, named_side in SIDES.items() if named_side == side)


KINDS = ("sort", "follow", "assemble", "pose", "move", "feed")
"""Kinds of task."""

CLASSES = ("black", "grey")
"""Classes of parts on rigs without part types. Detector and simulator distinguish these classes."""

CURVES = ("waypoints_m", "circle", "spline_m")
"""Keys that define the curve of a path. A path has exactly one of these keys."""

SLOWEST_MPS, FASTEST_MPS = 1e-5, 10.0
"""Allowed range of the speed along a path [m/s]."""

ALL_DIFFERENT = "each class once"
ANGLE_ERROR = "Maximum error of a part's angle."
ANY_ANGLE = "any angle"
PLACE = Numbers((2,), -MAX_XY, MAX_XY)
PLACES = Numbers((None, 2), -MAX_XY, MAX_XY)
TARGET = "Target position of the part's centre."
TARGET_ANGLE = "Target angle of the part, counter-clockwise from x."
TOLERANCE = Key(
    "tolerance_m", Number(1e-4, 1), "Maximum distance of a part's centre from its target position."
)
HOLD = Key(
    "hold_s",
    Number(0, 60),
    "Time for which the goal must be met without interruption, less than `time_limit_s`.",
)


def class_key(*labels: str) -> Key:
    """Return the definition of the key `class` of a path, a pose or a pick. The value of this key
    must be one of the classes of the scenario."""
    kind = Choice(labels) if labels else Text("a class of `parts`")
    return Key("class", kind, "Class of the part.")


FILE = Section(
    "scenario file",
    "The keys at the top level of a scenario file: the parts on the plate, and one task.",
    (
        Key("description", Text(), "Description of the task in one sentence."),
        Key(
            "marked", Flag(), "Whether each round part has a mark that shows its angle. Tasks with "
            "angles of round parts require true.", False,
        ),
        Key(
            "rig", Text("a name in config/rigs, or the path of a .yaml file"), "Rig that "
            "is used if no other rig is selected. A path is relative to the scenario's folder.",
            "", "the default rig",
        ),
        Key("parts", List(), "One entry for each class of parts, with the keys of `parts[]`."),
        Key("task", Table(), "Kind of the task, and the keys of this kind."),
        Key(
            "time_limit_s", Number(0.1, 1e5), "Maximum duration of the task after all parts have "
            "been detected. A longer task fails. Only `feed`, and `move` with `until_canceled: "
            "true`, can omit this key.",
            None, "no limit",
        ),
    ),
)  # fmt: skip

GROUP = Section(
    "parts[]",
    "The parts of one class, at given or random positions.",
    (
        Key(
            "class", Text("black, grey, or a type of the rig's `types`"), "Class of the parts. "
            "`black` and `grey` are round parts that differ in brightness. The section `parts` of "
            "the rig file defines their mass, radius and height. If the rig has `types`, only "
            "these types are allowed.",
        ),
        Key(
            "count", Whole(0, 100), "Number of parts at random positions, which depend on the "
            "random seed. The centres of two parts are five radii apart, or less if the plate "
            "has too little space. Only the task `feed` allows 0.",
            None, "or `positions_m`",
        ),
        Key(
            "positions_m", PLACES, "Initial position of each part's centre. The "
            "circumscribed circles of two parts must not overlap.",
            None, "or `count`",
        ),
    ),
)  # fmt: skip

TASK = Section(
    "task",
    "The task of the scenario.",
    (
        Key(
            "kind",
            Choice(KINDS),
            "Kind of the task, which determines the other keys.",
        ),
    ),
)

SORT = Section(
    "task, kind: sort",
    "This task moves the parts of each class to the region of their class. The task is done when "
    "all parts have been in their regions for `hold_s`.",
    (
        Key(
            "regions", Table("for each class a side, a corner, or {bin_m: ...}"), "Region of "
            f"each class: {', '.join(SIDES)}, or a polygon. Regions must not overlap. The key "
            "`sides` is a synonym.",
        ),
        Key(
            "goal_fraction", Number(0, 0.8), "Distance from the plate's centre at which the "
            "regions of sides and corners begin. The distance along x is this fraction of the "
            "plate's half length. The distance along y is this fraction of its half width.",
            None, "not required if all regions are polygons",
        ),
        HOLD,
    ),
)  # fmt: skip

BIN = Section(
    "task, kind: sort, a polygon in regions",
    "A region with the shape of a polygon.",
    (
        Key(
            "bin_m", PLACES, "Three or more corners of the polygon, in order around it. The "
            "polygon must have space for all parts of its class, with 3.5 radii between their "
            "centres.",
        ),
    ),
)  # fmt: skip

FOLLOW = Section(
    "task, kind: follow",
    "This task moves all parts to the starts of their paths, then each part along its path. The "
    "task is done when all paths are completed.",
    (
        Key("paths", List(), "One path for each part."),
        Key(
            "max_error_m",
            Number(1e-4, 10),
            "Maximum distance of a part from its reference, the point that moves along its path. "
            "If a distance is larger, the task fails. If a distance exceeds 15 % of the maximum, "
            "all references slow down.",
        ),
    ),
)

PATH = Section(
    "task, kind: follow, paths[]",
    f"The path of one part. Exactly one of the keys {', '.join(CURVES)} defines its shape.",
    (
        class_key(),
        Key(
            "waypoints_m", PLACES, "Two or more corners of a path with straight sides.",
            None, "or `circle` or `spline_m`",
        ),
        Key(
            "circle", Table(), "Circular path, with the keys of the next section.", None,
            "or `waypoints_m` or `spline_m`",
        ),
        Key(
            "spline_m", PLACES, "Three or more points through which a cubic spline passes.",
            None, "or `waypoints_m` or `circle`",
        ),
        Key(
            "speed_mps", Number(SLOWEST_MPS, FASTEST_MPS), "Speed along the path. A list of pairs "
            "[fraction of a lap, speed in m/s] is a speed profile. The fractions increase from 0 "
            "to 1. Between the pairs, the speed is interpolated linearly.",
        ),
        Key(
            "closed", Flag(), "Whether the last point of the path is connected to the first point.",
            None, "required except with `circle`",
        ),
        Key(
            "laps", Number(0.01, 1000), "Number of laps on a closed path. Open paths must not "
            "contain this key.",
            None, "required for closed paths",
        ),
    ),
)  # fmt: skip

CIRCLE = Section(
    "task, kind: follow, paths[], circle",
    "A circular path.",
    (
        Key("centre_m", PLACE, "Centre of the circle."),
        Key("radius_m", Number(1e-4, MAX_XY), "Radius of the circle."),
        Key(
            "start_deg", Number(-360, 360), "Direction from the circle's centre to the start of "
            "the path, counter-clockwise from x.", 0.0,
        ),
        Key("turn", Choice(("left", "right")), "Direction of motion on the circle. left: "
            "counter-clockwise; right: clockwise."),
    ),
)  # fmt: skip

ASSEMBLE = Section(
    "task, kind: assemble",
    "This task moves the parts to a pattern of positions. The task is done when each position has "
    "had a part of its class for `hold_s`.",
    (
        Key(
            "places_m", Table("for each class a list of [x, y]"), "Target positions of each class, "
            "one per part. Two positions must be at least 2.5 radii apart. The planner assigns the "
            "parts to the positions.",
        ),
        TOLERANCE,
        HOLD,
    ),
)  # fmt: skip

POSE = Section(
    "task, kind: pose",
    "This task moves each part to an angle and, if `place_m` is given, to a position. The task is "
    "done when all parts have been within both tolerances for `hold_s`. Round parts require "
    "`marked: true`.",
    (
        Key("poses", List(), "One target pose for each part."),
        Key(
            "anywhere",
            Flag(),
            "Whether parts without `place_m` can end at any position. If false, such a part must "
            "stay within `tolerance_m` of its position.",
            False,
        ),
        TOLERANCE,
        Key("tolerance_deg", Number(0.1, 180), ANGLE_ERROR),
        HOLD,
    ),
)

POSES = Section(
    "task, kind: pose, poses[]",
    "Target of one part. The angle of a round part is that of its mark.",
    (
        class_key(),
        Key("angle_deg", Number(-360, 360), TARGET_ANGLE),
        Key("place_m", PLACE, TARGET, None, "the part's position at the start of the task"),
    ),
)

MOVE = Section(
    "task, kind: move",
    "This task moves parts to separate targets. The topic `targets` can change the targets. A part "
    "without a target stays in place, but the planner moves it out of the way of other parts. The "
    "task is done when all targets have been reached for `hold_s`.",
    (
        Key("targets", List(), "One target for each part that must move.", None, "no targets"),
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
        Key("place_m", PLACE, TARGET),
        Key(
            "angle_deg", Number(-360, 360), f"{TARGET_ANGLE} A round part with an angle requires "
            "`marked: true`.", None, ANY_ANGLE,
        ),
    ),
)  # fmt: skip

FEED = Section(
    "task, kind: feed",
    "This task keeps parts ready for a robot, until the task is canceled. Parts of classes that "
    "are not in `picks` are moved to the chute.",
    (
        Key("picks", List(), "One entry for each class that the robot picks."),
        Key(
            "clearance_m", Number(0, 0.5), "Minimum gap between a ready part and any other part, "
            "required by the gripper.",
        ),
        Key(
            "chute", Choice(("left", "right", "bottom", "top")), "Side over which unwanted "
            "parts leave the plate.", None, "unwanted parts stay on the plate",
        ),
        Key("hopper", Table(), "Hopper, which drops new parts onto the plate.", None, "no hopper"),
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
        Key("window_m", Numbers((2, 2), -MAX_XY, MAX_XY), "Lower left and upper right corner "
            "[x, y] of the pick window. The centres of ready parts are inside this window.", None,
            "all points whose distance from the edges is at least the stroke and 1.25 radii"),
        Key("ready", Whole(1, 100), "Number of parts that are kept ready at the same time.", 1),
        Key(
            "angle_deg", Number(-360, 360), "Angle of ready parts, counter-clockwise from x.",
            None, ANY_ANGLE,
        ),
        Key("tolerance_deg", Number(0.1, 180), ANGLE_ERROR, 5.0),
    ),
)  # fmt: skip

HOPPER = Section(
    "task, kind: feed, hopper",
    "Hopper, which drops new parts onto the plate. At each opening, the hopper drops as many "
    "parts as the plate lacks.",
    (
        Key("fill", Whole(1, 100), "Number of parts on the plate after the hopper has closed."),
        Key("least", Whole(1, 100), "Minimum number of parts on the plate. If the plate has fewer "
            "parts, the hopper opens.", None, "`fill`"),
        Key("rate_ps", Number(0.1, 1000), "Number of parts that the open hopper drops per second."),
        Key("place_m", PLACE, "Centre of the disc on which parts drop."),
        Key("spread_m", Number(0.001, 1), "Radius of the disc on which parts drop."),
        Key("mix", Table("for each class a fraction, 1 in all"), "Fraction of each class among "
            "the dropped parts. The classes in `picks` are "
            "required.", None, "equal fractions of the classes in `picks`"),
    ),
)  # fmt: skip

SECTIONS = (
    FILE, GROUP, TASK, SORT, BIN, FOLLOW, PATH, CIRCLE, ASSEMBLE, POSE, POSES, MOVE, MOVES,
    FEED, PICK, HOPPER,
)  # fmt: skip
"""All sections of a scenario file, in the order of docs/reference.md."""
