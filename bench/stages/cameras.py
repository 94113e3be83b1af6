"""Scenes with the effects of real cameras: height, gloss, shadow, contrast, tilt, lens, light.

Each scene has 100 discs, or 56 parts of several types. The simulated camera draws the scene, so the
true positions are known.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from harness import Result, Table, paired
from plate_bringup.views import view_from, with_height
from plate_core import PlateError, Rig, load_rig
from plate_core.rig import Lens, PartType
from plate_sim.camera import Camera, Lighting, part_colours, part_greys
from plate_vision import Tracker, make_vision, observe
from plate_vision.bare_plate import BARE_IMAGES, BarePlate, know_plate
from plate_vision.plate import OutlineCheck
from stages.vision import layout

DISCS, TYPED = 100, 56
"""Number of parts in a scene."""

IMAGES, QUICK_IMAGES = 4, 1
"""Number of layouts of each scene."""

QUICK_STEP = 8
"""A quick measurement uses only every eighth kind of scene."""

FIRST_SEED = 54000
"""Seed of the first layout. Smaller seeds are for tuning."""

SHOTS, TYPED_SHOTS = 5, 6
"""Numbers of successive images of each layout: for discs, and for parts with part types. The images
differ in noise. For discs, only the last image is evaluated, because a detector can learn from the
others. For parts with part types, all images are evaluated, because the light changes between the
images."""

INTERVAL_S = 0.15
"""Time between two images [s], one cycle of the plate."""

BARREL = (-0.2675, 0.0926, 0.0, 0.0, 0.0)
"""Published coefficients k1, k2, p1, p2, k3 of a webcam's lens distortion."""

MOVED_PX = 12
"""Shift of the image if somebody pushes the camera [px]."""

WEBCAM_QUALITY = 70
"""JPEG quality of a webcam's images."""


@dataclass(frozen=True)
class Kind:
    """One kind of scene. The default values of the attributes describe the simplest scene.

    Attributes
    ----------
    name : str
    rig : callable
        Function that returns the true rig.
    lighting : Lighting
    greys : tuple of float, or of (blue, green, red)
        Grey values or colours of the parts at full light, used in turn. Empty for typed parts.
    plate, room : float
        Grey values of the plate and its surroundings at full light.
    height : float
        Height of the parts [m].
    known : callable, optional
        Function that converts the true rig to the rig that the detector gets. None: the detector
        gets the true rig.
    warp : callable, optional
        Function that changes each image before the detector gets it.
    sizes : tuple of float
        Factors from the rig's part size to the sizes of the parts, used in turn.
    noise, defocus_px : float
    blur_px : float
        Motion of parts during the exposure [px], in random directions.
    marked : bool
        Whether discs have marks.
    typed : bool
        Whether the parts have several types. The detector then gets images of the bare plate first.
    levels : tuple of float
        Factors of the light in successive images. The last factor applies to all further images.
    softer_px : float
        Additional defocus after the bare plate was learned.
    jpeg : int
        JPEG quality of the images. 0: no compression.
    """

    name: str
    rig: Callable[[], Rig] = load_rig
    lighting: Lighting = field(default_factory=Lighting)
    greys: tuple[Any, ...] = tuple(part_greys(["black", "grey"]).tolist())
    plate: float = 220.0
    room: float = 60.0
    height: float = 0.0
    known: Callable[[Rig], Rig] | None = None
    warp: Callable[[np.ndarray], np.ndarray] | None = None
    sizes: tuple[float, ...] = ()
    noise: float = 2.0
    defocus_px: float = 0.0
    blur_px: float = 0.0
    marked: bool = False
    typed: bool = False
    levels: tuple[float, ...] = (1.0,)
    softer_px: float = 0.0
    jpeg: int = 0


@dataclass(frozen=True)
class Scene:
    """Data of one scene: the rig that the detector gets, images of the bare plate (only for typed
    parts), and images of the parts. Also the true positions (M, 2) [m], angles (M,) [rad,
    plate_home] and types (M,) of the parts. There are no types for discs."""

    rig: Rig
    bare: list[np.ndarray]
    images: list[np.ndarray]
    position: np.ndarray
    angle: np.ndarray
    types: list[PartType]

    @property
    def image(self) -> np.ndarray:
        """The last image (H, W) or (H, W, 3)."""
        return self.images[-1]


def seen_from(name: str = "", radius_m: float = 0.0, **view: float) -> Rig:
    """Return a rig of config/rigs with another camera position (`view_from`). If the radius is 0,
    the parts of the rig are unchanged."""
    rig = view_from(load_rig(name), **view)  # type: ignore[arg-type]
    return replace(rig, parts=replace(rig.parts, radius_m=radius_m or rig.parts.radius_m))


def near_camera_rig() -> Rig:
    """Return the default rig with a camera 0.43 m above the plate."""
    return seen_from(focal_px=430.0, distance_m=0.43)


def wide_angle_rig() -> Rig:
    """Return a rig with a wide-angle lens, by a published calibration of a camera of 1480 x 1080
    px."""
    rig = load_rig()
    lens = Lens(
        (983.23425, 974.13698), (909.40739, 573.79454),
        (-0.364955, 0.124123, -0.003946, 0.000371, 0.0),
    )  # fmt: skip
    corners_px = (
        (181.218, 844.969), (1441.088, 880.169), (1437.252, 208.946), (178.972, 242.099),
    )  # fmt: skip
    camera = replace(rig.camera, width_px=1480, height_px=1080, corners_px=corners_px, lens=lens)
    return replace(rig, camera=camera)


def without_heights(rig: Rig) -> Rig:
    """Return the rig that the detector would get from a rig file without heights."""
    return with_height(rig, 0.0)


def without_distortion(rig: Rig) -> Rig:
    """Return the rig that the detector would get from a rig file without lens distortion."""
    lens = rig.camera.lens
    assert lens is not None
    return replace(rig, camera=replace(rig.camera, lens=Lens(lens.focal_px, lens.centre_px)))


def mirror_image(image: np.ndarray) -> np.ndarray:
    """Return the image with left and right exchanged."""
    return np.ascontiguousarray(image[:, ::-1])


def shift_image(image: np.ndarray) -> np.ndarray:
    """Return the image shifted to the right by `MOVED_PX`, as if somebody had pushed the camera."""
    return np.roll(image, MOVED_PX, axis=1)


def part_types_rig() -> Rig:
    """Return the rig with the part types."""
    return load_rig("shapes")


def lamp_lighting(length_m: float, depth: float = 0.5) -> Lighting:
    """Return the lighting by a lamp whose shadows have this length."""
    return Lighting(shadows=depth, shadow_m=length_m, penumbra_m=min(0.003, length_m / 2))


GLOSS = (0.15, 0.2, 0.25, 0.3)
CONTRASTS = ((160.0, 10.0), (160.0, 20.0), (160.0, 30.0), (205.0, 40.0))
STEP_DOWN = (1.0, 1.0, 0.85)

KINDS = (
    Kind("plain"),
    *(Kind(f"gloss {radius:g} r", lighting=Lighting(gloss=radius)) for radius in GLOSS),
    *(
        Kind(f"contrast {less:g} on {plate:g}", greys=(plate - less,), plate=plate)
        for plate, less in CONTRASTS
    ),
    Kind("yellow on white", rig=part_types_rig, greys=((60.0, 215.0, 220.0),)),
    *(
        Kind(f"bright on {plate:g}", greys=(200.0,), plate=plate, room=plate / 3)
        for plate in (70.0, 130.0)
    ),
    Kind("5 mm high, 0.91 m", height=0.005, rig=lambda: seen_from(distance_m=0.91)),
    Kind("5 mm high, 0.43 m", height=0.005, rig=near_camera_rig),
    Kind("10 mm high, 0.91 m", height=0.01, rig=lambda: seen_from(distance_m=0.91)),
    Kind("10 mm high, 0.43 m", height=0.01, rig=near_camera_rig),
    Kind("20 mm high, 0.43 m", height=0.02, rig=near_camera_rig),
    Kind(
        "10 mm high, 0.43 m, not in the rig file", height=0.01, rig=near_camera_rig,
        known=without_heights,
    ),
    *(
        Kind(f"shadow {1e3 * length:g} mm", lighting=lamp_lighting(length))
        for length in (3e-3, 5e-3, 1e-2)
    ),
    *(
        Kind(f"tilt {tilt} sideways", rig=lambda tilt=tilt: seen_from(tilt_deg=tilt, focal_px=500))  # type: ignore[misc]
        for tilt in (15, 20, 25, 30, 40)
    ),
    Kind("strong lens", rig=wide_angle_rig),
    Kind("sizes 0.8, 1 and 1.2", sizes=(0.8, 1.0, 1.2)),
    Kind("sizes 0.7 to 1.3", sizes=(0.7, 0.85, 1.0, 1.15, 1.3)),
    Kind("radius 4 px, soft 1.2 px", rig=lambda: seen_from(radius_m=0.004), defocus_px=1.2),
    Kind("radius 4 px, soft 1.5 px", rig=lambda: seen_from(radius_m=0.004), defocus_px=1.5),
    Kind("radius 4 px, soft 2 px", rig=lambda: seen_from(radius_m=0.004), defocus_px=2.0),
    Kind("radius 5 px, soft 2 px", rig=lambda: seen_from(radius_m=0.005), defocus_px=2.0),
    Kind("noise 15", noise=15.0),
    Kind("noise 20", noise=20.0),
    Kind("motion 10 px", blur_px=10.0),
    Kind("light flickers by 10 %", levels=(1.1, 0.9, 1.1)),
    Kind(
        "webcam: tilt 15, 5 mm high, shadow, JPEG",
        rig=lambda: seen_from(tilt_deg=15, towards_deg=-90, focal_px=500), height=0.005,
        lighting=lamp_lighting(4e-3, 0.3), jpeg=WEBCAM_QUALITY, marked=True, noise=4.0,
    ),
    Kind(
        "barrel lens, left out of the rig file", known=without_distortion,
        rig=lambda: view_from(load_rig(), focal_px=500, distortion=BARREL),
    ),
    Kind("image mirrored", warp=mirror_image),
    Kind("camera pushed by 12 px", warp=shift_image),
    Kind("typed, plain", typed=True, rig=part_types_rig),
    Kind(
        "typed, light 15 % down, dark room", typed=True, rig=part_types_rig, room=8.0,
        levels=STEP_DOWN,
    ),
    Kind("typed, light 20 % down", typed=True, rig=part_types_rig, levels=(1.0, 1.0, 0.8)),
    Kind("typed, light 5 % down", typed=True, rig=part_types_rig, levels=(1.0, 1.0, 0.95)),
    Kind("typed, light 10 % up", typed=True, rig=part_types_rig, levels=(1.0, 1.0, 1.1)),
    *(
        Kind(
            f"typed, flicker {100 * part:g} %", typed=True, rig=part_types_rig,
            levels=(1 + part, 1 - part) * (TYPED_SHOTS // 2),
        )
        for part in (0.06, 0.1)
    ),
    Kind("typed, 2 px softer", typed=True, rig=part_types_rig, softer_px=2.0),
    Kind("typed, motion 6 px", typed=True, rig=part_types_rig, blur_px=6.0),
    Kind("typed, gloss 0.25 r", typed=True, rig=part_types_rig, lighting=Lighting(gloss=0.25)),
    Kind("typed, shadow 5 mm", typed=True, rig=part_types_rig, lighting=lamp_lighting(5e-3)),
    Kind("typed, shadow 10 mm", typed=True, rig=part_types_rig, lighting=lamp_lighting(1e-2)),
    Kind(
        "typed, tilt 25 sideways", typed=True,
        rig=lambda: seen_from("shapes", tilt_deg=25, focal_px=500),
    ),
    Kind(
        "typed, 10 mm high, 0.43 m", typed=True, height=0.01,
        rig=lambda: seen_from("shapes", focal_px=430, distance_m=0.43),
    ),
)  # fmt: skip

BY_NAME = {kind.name: kind for kind in KINDS}


def measure(quick: bool) -> Result:
    """Measure all kinds of scenes."""
    cv2.setNumThreads(1)
    kinds, count = (KINDS[::QUICK_STEP], QUICK_IMAGES) if quick else (KINDS, IMAGES)
    rows = [row_of(kind, count) for kind in kinds]
    return Result([Table.of("views", rows, discs=DISCS, typed=TYPED)])


def scene(name: str, seed: int) -> Scene:
    """Return one scene of a kind, by its name in `BY_NAME`."""
    return draw_scene(BY_NAME[name], seed)


def draw_scene(kind: Kind, seed: int) -> Scene:
    """Draw one scene of a kind: `scene`."""
    rng = np.random.default_rng(seed)
    real = with_height(kind.rig(), kind.height)
    count = TYPED if kind.typed else DISCS
    types: list[PartType] = []
    if kind.typed:
        every = list(real.types.values())
        types = [every[k % len(every)] for k in range(count)]
        position = random_centres(real, types, rng)
        colours = part_colours(types, real.camera.colour)
    else:
        real = replace(real, types={})
        position = layout(real, count, False, rng)
        colours = np.array([kind.greys[k % len(kind.greys)] for k in range(count)])
    light = {"plate": kind.plate, "room": kind.room}
    camera = Camera(real, kind.noise, **light, defocus_px=kind.defocus_px + kind.softer_px)
    angle = rng.uniform(-np.pi, np.pi, count)
    more: dict[str, Any] = {"types": types} if kind.typed else {}
    if kind.typed or kind.marked:
        more["angle"] = angle
    if kind.height:
        more["height"] = np.full(count, kind.height)
    if kind.sizes:
        more["size"] = np.array([kind.sizes[k % len(kind.sizes)] for k in range(count)])
    begin, path = position, position
    if kind.blur_px:
        direction, middle = rng.uniform(0, 2 * np.pi, count), np.array(real.camera.corners_px)
        px_m = float(np.linalg.norm(middle[1] - middle[0]) / real.plate.length_m)
        step = kind.blur_px / px_m * np.stack([np.cos(direction), np.sin(direction)], axis=1)
        begin, path = position - step / 2, np.stack([position - step / 2, position + step / 2])
    images = []
    for shot in range(TYPED_SHOTS if kind.typed else SHOTS):
        lighting = replace(kind.lighting, level=kind.levels[min(shot, len(kind.levels) - 1)])
        image = camera.render(
            path if kind.blur_px else begin, colours, rng, lighting=lighting, **more
        )
        image = compress_image(image, kind.jpeg) if kind.jpeg else image
        images.append(image if kind.warp is None else kind.warp(image))
    bare = []
    if kind.typed:
        sharp = Camera(real, kind.noise, **light, defocus_px=kind.defocus_px)
        no_parts = np.zeros((0, 2))
        bare = [sharp.render(no_parts, colours[:0], rng) for _ in range(BARE_IMAGES)]
    known = real if kind.known is None else kind.known(real)
    return Scene(known, bare, images, position, angle, types)


def random_centres(rig: Rig, types: Sequence[PartType], rng: np.random.Generator) -> np.ndarray:
    """Return random centres (n, 2) [m] of typed parts, each in a separate cell of a grid."""
    reach = max(part.reach_m for part in types)
    limit = rig.plate.half - reach
    columns, lines = 10, 6
    cell = 2 * rig.plate.half / (columns, lines)
    chosen = rng.permutation(columns * lines)[: len(types)]
    middle = -rig.plate.half + cell * (np.column_stack([chosen % columns, chosen // columns]) + 0.5)
    part_reach = np.array([part.reach_m for part in types])[:, None]
    free = np.maximum(cell / 2 - part_reach - 0.001, 0)
    return np.clip(middle + rng.uniform(-1, 1, middle.shape) * free, -limit, limit)


def compress_image(image: np.ndarray, quality: int) -> np.ndarray:
    """Return an image after JPEG compression with this quality."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED))


def detect_in_scene(scene: Scene) -> Iterator[tuple[Tracker, bool]]:
    """Yield the detector's result for each image of a scene, and whether the detector reports a
    problem. Problems are rejected objects, a moved outline of the plate, and a refused image."""
    vision = make_vision(scene.rig)
    tracker = Tracker()
    plate = BarePlate()
    stamp = 1.0
    outline = OutlineCheck.of(scene.rig, vision.calibration)
    if scene.types:
        plate = replace(plate, requested=len(scene.bare))
    for image in scene.bare:
        plate, vision, _ = know_plate(plate, vision, image)
    for image in scene.images:
        stamp += INTERVAL_S
        try:
            if scene.types:
                plate, vision, _ = know_plate(plate, vision, image)
            tracker = observe(vision, tracker, image, stamp)
            outline = outline.add(image, stamp)
        except PlateError:
            yield Tracker(), True
        else:
            yield tracker, len(tracker.overlooked) > 0 or outline.finding is not None


def row_of(kind: Kind, count: int) -> dict[str, Any]:
    """Measure one kind of scene in a number of layouts, and return its row."""
    gaps: list[float] = []
    true = false = right = lost = reported = 0
    times = []
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        scene = draw_scene(kind, seed)
        began = time.process_time()
        for number, (tracker, named_parts) in enumerate(detect_in_scene(scene)):
            times.append(time.process_time() - began)
            began = time.process_time()
            if not kind.typed and number < len(scene.images) - 1:
                continue
            # A part that is published with the class unknown counts as not detected. `named_parts`
            # states whether the detector has reported such a problem.
            named = [not name.startswith("unknown") for name in tracker.parts.ids]
            found = tracker.parts.position[named]
            ids = [name for name, kept in zip(tracker.parts.ids, named, strict=True) if kept]
            reach = np.array([part.reach_m for part in scene.types]) if scene.types else None
            i, j, gap = paired(
                found, scene.position, scene.rig.parts.radius_m if reach is None else reach
            )
            gaps += gap.tolist()
            true += len(scene.position)
            false += len(found) - len(i)
            if scene.types:
                right += sum(
                    ids[a].rsplit("_", 1)[0] == scene.types[b].name
                    for a, b in zip(i, j, strict=True)
                )
            if len(i) < len(scene.position):
                lost += 1
                reported += named_parts
    error = 1e3 * np.array(gaps)
    return {
        "scene": kind.name,
        "parts": true,
        "detected_percent": 100 * len(gaps) / true,
        "false": false,
        "rms_mm": float(np.sqrt(np.mean(error**2))) if len(error) else None,
        "worst_mm": float(np.max(error)) if len(error) else None,
        "right_percent": 100 * right / max(len(gaps), 1) if kind.typed else None,
        "reported": f"{reported} of {lost}" if lost else None,
        "ms": 1e3 * float(np.median(times)),
    }
