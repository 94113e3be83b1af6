"""ROS node of the detector. The node detects and tracks the parts in each image of `image_raw` with
the module `vision`, and publishes them as `parts`. The node also has services for teaching part
types and for aiming the camera."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from plate_core import NAMELESS, OverlookedThing, PlateError, load_rig, part_class
from plate_core.rig import home_pose, rig_warnings
from plate_core.ros import (
    CAMERA,
    DATA,
    IMAGE,
    LATCHED,
    PHOTOGRAPHS,
    TRANSFORMS,
    WARN_S,
    SafeLifecycleNode,
    array_to_image,
    camera_to_msg,
    msg_to_request,
    parts_to_msg,
    plate_to_msg,
    pose_to_msg,
    run_node,
    scene_to_msg,
    seconds,
)
from plate_core.status import Finding, Input, Level, combined, used
from plate_interfaces.msg import PartForces, Parts

from .aiming import Situation, Thing
from .bare_plate import MODELLED, BarePlate, know_plate, learn_next
from .camera import (
    Lens,
    bits_hint,
    decode,
    decode_file,
    largest_in_file,
    largest_number,
    load_lens,
    rig_lens,
    rig_of_picture,
)
from .drawing import ARROW_S, draw_detections, outlines_px
from .errors import ImageError, TeachError
from .faint import faint_finding, faint_patches
from .live_teaching import Teaching, learn_shown
from .overlooked import Expected, OverlookedTally, is_separate_object, remedy
from .plate import OutlineCheck, PlateLocation, light_problem
from .recognition import camera_limits
from .ros import AimingView, DetectorParameters, lens_of, silence_advice
from .shapes.part_files import load_bare
from .tracking import Prediction, Tracker, found_text
from .vision import HOME, follow_plate, make_vision, observe

PLANNED_S = 1.0
"""Maximum time between an image and the planner's prediction of parts while a task runs [s]. This
time is several plate cycles. The time is limited because the last prediction remains stored after
the planner has ended."""

FAINT_PERIOD_S = 2.0
"""Minimum difference between the stamps of two images in which faint patches are searched [s]. A
search takes 10 ms."""

TRAIL = 100
"""Length of a part's trail in `markers` [images]."""


@dataclass
class Tally:
    """Counts of the images since the last report.

    Attributes
    ----------
    images, refused : int
        Images received, and images refused.
    why : str
        Reason of the last refusal.
    problem : str
        Last problem of the light or the markers.
    detection_ms : list of float
        Detection times [ms].
    overlooked, overlooked_before : OverlookedTally
        Objects that were rejected as parts in these images, and in the images of the previous
        report.
    """

    images: int = 0
    refused: int = 0
    why: str = ""
    problem: str = ""
    detection_ms: list[float] = field(default_factory=list)
    overlooked: OverlookedTally = field(default_factory=OverlookedTally)
    overlooked_before: OverlookedTally = field(default_factory=OverlookedTally)

    @property
    def overlooked_lately(self) -> OverlookedTally:
        """Overlooked objects of this report and of the previous one. Both reports are used so that
        the first image of a report alone does not cause a warning."""
        return self.overlooked_before.joined(self.overlooked)


class DetectorNode(SafeLifecycleNode[DetectorParameters]):
    """Lifecycle node `detector`: finds parts, and a plate with markers, in camera images.

    The node subscribes to image_raw (or image_raw/compressed), camera_info, and part_forces. The
    predicted positions in part_forces help the tracker to keep the parts' ids.

    The node publishes parts, detections_image, markers, and diagnostics. If the lens is known, the
    node publishes /tf_static with camera_optical_frame. For a plate with markers, the node
    publishes plate_pose, and /tf with plate in plate_home.

    The service ~/reset forgets all parts and locates the plate again. Two services are for rigs
    with part types. ~/learn_plate learns the bare plate from the next images. ~/teach learns the
    type `teach_name` from the parts in the last image, which must all be of this type. If ~/teach
    is called again with the same name, the type is learned from the images of all calls so far.

    While the topic aim has a subscriber, the node publishes measurements there that help to aim,
    focus and light the camera. The services for aiming are ~/find_home, ~/save_home,
    ~/take_lens_pictures, ~/fit_lens, ~/save_lens.

    Each usable image results in one `parts` message with the image's stamp, even if it shows no
    part. The lens of camera_info replaces the lens of the rig file. The other values of camera_info
    are not used. The markers or the rig file determine the location of the plate in the image.
    """

    def __init__(self) -> None:
        super().__init__("detector", DetectorParameters)
        self.report(self._diagnose, self._diagnostic_values, "camera", self._begin_report)

    def configure(self) -> None:
        """Read the rig and the lens."""
        values = self.options
        self._rig = load_rig(values.rig_file)
        self._lens_message: tuple[object, ...] | None = None
        self._lens: Lens | None = None
        self._lens_problem = ""  # reason why the last camera_info was refused, or ""
        for warning in rig_warnings(self._rig, "camera", "parts"):
            self.get_logger().warning(warning.text)
        if values.camera_file:
            size = self._rig.camera
            self._lens = load_lens(values.camera_file, (size.width_px, size.height_px))
        self._vision = make_vision(self._rig, values.detector(), self._lens)
        self._plate = BarePlate()
        for limit in camera_limits(self._rig.types, self._vision.calibration):
            self.get_logger().warning(limit)
        if values.bare_plate_file:
            bare = load_bare(
                Path(values.bare_plate_file),
                self._vision.region.size_px,
                self._initial_location(),
            )
            self._vision = replace(self._vision, background=bare)
            self._plate = BarePlate(True, bare)
        self._parts = self.managed_publisher(Parts, "parts", DATA)
        if self._rig.fiducials is not None:
            self._poses = self.managed_publisher(PoseStamped, "plate_pose", DATA)
            self._transforms = self.managed_publisher(TFMessage, "/tf", TRANSFORMS)
        self._cameras = self.managed_publisher(TFMessage, "/tf_static", LATCHED)
        self._drawings = self.managed_publisher(Image, "detections_image", IMAGE)
        self._markers = self.managed_publisher(MarkerArray, "markers", DATA)
        images = PHOTOGRAPHS if values.photographs else CAMERA
        if values.image_transport == "raw":
            self.managed_subscription(Image, "image_raw", self._on_image, images)
        else:
            topic = "image_raw/compressed"
            self.managed_subscription(CompressedImage, topic, self._on_file, images)
        if not (values.camera_file or values.photographs):
            self.managed_subscription(CameraInfo, "camera_info", self._on_camera_info, CAMERA)
        self.managed_subscription(PartForces, "part_forces", self._on_forces, DATA)
        self.managed_service(Trigger, "~/reset", self._on_reset)
        self.managed_service(Trigger, "~/learn_plate", self._on_learn_plate)
        self.managed_service(Trigger, "~/teach", self._on_teach)
        self._aiming = AimingView(self, self._aiming_situation, self._use_corners, self._use_lens)

    def begin(self) -> None:
        """Reset all state that was computed from images."""
        values = self.options
        self._location = self._initial_location()
        self._tracker = Tracker(values.tracker())
        self._expected: Prediction | None = None
        self._given_up_count = self._renamed_count = 0
        self._trails: dict[str, deque[tuple[float, float]]] = {}
        compressed = values.image_transport == "compressed"
        self._topic = "image_raw/compressed" if compressed else "image_raw"
        topic = self.resolve_topic_name(self._topic)
        self._input = Input(
            "image", topic, "check that the camera runs", values.input_timeout_s, time.monotonic()
        )
        self._tally, self._reported_at = Tally(), time.monotonic()
        self._images = self._refused = 0
        bare = self._plate.first if self._plate.learned else None
        self._plate = BarePlate(bare is not None, bare)
        self._vision = replace(self._vision, background=bare)
        self._teaching = Teaching()
        self._image: np.ndarray | None = None
        self._last_image = np.empty(0)  # the last usable image, unchanged
        self._older_stamp: float | None = None
        self._outline: OutlineCheck | None = None
        self._faint: Finding | None = None
        # number of faint patches in the last search, and time of this search
        self._faint_count, self._faint_at = 0, -math.inf
        if self._location is None:
            self._publish_camera_pose()
        self._aiming.begin()

    def rest(self) -> None:
        """End the measurements for the view in which a user aims the camera."""
        self._aiming.rest()

    def _on_image(self, msg: Image) -> None:
        size_px, big = (msg.width, msg.height), bool(msg.is_bigendian)
        self._process_image(
            "image_raw",
            msg.header.stamp,
            lambda: decode(msg.data, size_px, msg.encoding, msg.step, big, self.options.bits),
            lambda: largest_number(msg.data, size_px, msg.encoding, msg.step, big),
        )

    def _on_file(self, msg: CompressedImage) -> None:
        size_px = self._vision.region.size_px
        self._process_image(
            "image_raw/compressed",
            msg.header.stamp,
            lambda: decode_file(msg.data, msg.format, self.options.bits, size_px),
            lambda: largest_in_file(msg.data),
        )

    def _adapt_rig_to_photograph(self, size_px: tuple[int, int]) -> None:
        """Adapt the rig to a photograph whose size differs from the size of the rig's images. The
        photograph is assumed to show the whole plate.

        Raises
        ------
        ImageError
            If parts would be too small or too large in the image.
        """
        rig, text = rig_of_picture(self._rig, size_px)
        if not text:
            return
        for warning in rig_warnings(rig, "camera", "parts"):
            if warning.impossible:
                raise ImageError(warning.text)
        self._rig, self._lens = rig, None
        self._vision = make_vision(rig, self.options.detector(), None)
        self._location = self._initial_location()
        self._warn(text)

    def _log_photograph(self, name: str) -> None:
        """Log the parts of a photograph, the objects in it that are rejected as parts, and the
        deviation of the plate's outline."""
        self.get_logger().info(f"{name}: {found_text(self._tracker)}")
        overlooked = OverlookedTally()
        overlooked.add(*self._part_count_and_overlooked())
        outline = None if self._outline is None else self._outline.finding
        for found in (overlooked.finding(Expected.of(self._rig)), self._faint, outline):
            if found is not None:
                self._warn(f"{name}: {found.message}")

    def _process_image(
        self,
        source: str,
        stamp: Time,
        unpack: Callable[[], np.ndarray],
        largest: Callable[[], int | None],
    ) -> None:
        """Find the parts in one image, and publish them. `largest` returns the largest 16-bit
        number of the image, or None if the image has 8 bits."""
        self._input = self._input.received(time.monotonic())
        self._tally.images += 1
        self._images += 1
        is_photograph = self.options.photographs
        if is_photograph:
            source = f"image {self._images}"
        received: np.ndarray | None = None
        try:
            received = image = unpack()
            if is_photograph:
                self._tracker, self._expected = Tracker(self._tracker.options), None
                if self._images == 1 + self._refused:
                    self._adapt_rig_to_photograph(image.shape[1::-1])
            start_s = time.perf_counter()
            self._check_stamp(received, seconds(stamp))
            if self._location is not None:
                image = self._locate_plate(self._location, image, stamp)
            self._image = image
            if self._vision.catalogue is not None:
                self._update_bare_plate(image)
            before = self._tracker
            self._tracker = observe(self._vision, before, image, seconds(stamp), self._expected)
        except PlateError as error:
            self._warn(f"{source} ignored: {error}")
            self._tally.refused += 1
            self._tally.why = str(error)
            self._refused += 1
            if received is not None:
                self._aiming.add_image(received, stamp, str(error))
            return
        self._last_image = received
        self._tally.detection_ms.append(1e3 * (time.perf_counter() - start_s))
        is_new = self._tracker is not before
        if is_new:
            self._log_id_changes()
        vision, parts_found = self._vision, is_new and bool(self._tracker.found)
        problem = light_problem(
            image, vision.options.min_plate_grey, vision.lit_region, plate_found=parts_found
        )
        if problem:
            problem += bits_hint(largest(), self.options.bits)
            self._warn(f"{source}: {problem}")
            self._tally.problem = problem
        self._publish_parts(image, stamp)
        self._check_outline(received, seconds(stamp))
        if not 0 <= seconds(stamp) - self._faint_at < FAINT_PERIOD_S:
            self._count_faint_patches(image, seconds(stamp))
        if is_photograph:
            self._log_photograph(source)
        self._aiming.add_image(received, stamp)

    def _publish_parts(self, image: np.ndarray, stamp: Time) -> None:
        """Publish the detected parts. If there are subscribers, publish drawings and markers
        too."""
        self._parts.publish(
            parts_to_msg(
                self._tracker.parts,
                stamp,
                quality=self._tracker.quality,
                overlooked=self._record_overlooked(),
            )
        )
        if self._drawings.get_subscription_count():
            self._drawings.publish(array_to_image(self._draw_detections(image), stamp, "bgr8"))
        if self._markers.get_subscription_count():
            self._markers.publish(self._make_markers(stamp))

    def _check_stamp(self, image: np.ndarray, stamp: float) -> None:
        """Raise an error if an image has the same stamp as the previous image but other pixels.
        Also raise an error if a single image is older than the previous one. If the next image is
        also older, accept this image, because the clock has probably been set back."""
        last, early = self._tracker.stamp, self._older_stamp
        self._older_stamp = None
        if last is None or stamp > last:
            return
        if stamp < last and early is None:
            self._older_stamp = stamp
            raise ImageError(
                f"stamp is {stamp:.3f} s, {last - stamp:.3f} s before that of the last image, "
                "allowed: increasing stamps, from one camera"
            )
        if stamp == last and not np.array_equal(image, self._last_image):
            raise ImageError(
                f"stamp is {stamp:.3f} s, equal to that of the last image, allowed: a different "
                "stamp for each image; check that the camera's node sets the stamp"
            )

    def _update_bare_plate(self, image: np.ndarray) -> None:
        """Learn the bare plate, model it, or adapt its model to the present light."""
        self._plate, self._vision, found = know_plate(self._plate, self._vision, image)
        if found is None:
            return
        # rclpy permits only one severity per call in the code, so there are two calls
        if found.level == Level.OK:
            self.get_logger().info(found.message)
        else:
            self.get_logger().warning(found.message)

    def _on_learn_plate(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Learn the bare plate from the next images."""
        if self._vision.catalogue is None:
            response.message = "the rig file has no part types, allowed: a rig file with types"
            return response
        if self._is_plate_moving:
            response.message = "a task moves the plate, allowed: the bare plate at rest at home"
            return response
        self._plate, response.message = learn_next(self._plate, self._image, self._vision.region)
        response.success = True
        self.get_logger().info(response.message)
        return response

    def _on_teach(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Learn a part type from the parts on the plate."""
        try:
            if self._image is None:
                raise TeachError("no image has arrived yet")
            teaching = self._teaching.shown(self.options.teach_name, self._image)
            untyped = self._vision.catalogue is None
            part, self._vision, response.message = learn_shown(
                teaching, self._vision, Path(self.options.teach_file)
            )
            self._teaching = teaching
            # the previous tracks have classes of discs instead of names of types, so discard them
            if untyped:
                self._tracker = Tracker(self._tracker.options)
            self._rig = replace(self._rig, types={**self._rig.types, part.name: part})
            response.success = True
        except (PlateError, OSError) as error:
            response.message = str(error)
        self.get_logger().info(f"~/teach: {response.message}")
        return response

    def _aiming_situation(self) -> Situation:
        """Return the detector's state that is shown while the camera is aimed."""
        expected = Expected.of(self._rig)
        count, things, radius = self._part_count_and_overlooked()
        tally = OverlookedTally()
        tally.add(count, things, radius)
        found = tally.finding(expected)
        if found is None and count:
            found = Finding(
                Level.OK, f"number of detected parts is {count}; there are no other objects"
            )
        findings = [
            ("lens", self._lens_finding()),
            ("parts", found or Finding(Level.STALE, "no part is detected; put parts on the plate")),
        ]
        if self._vision.catalogue is not None:
            learned = Finding(Level.OK, "the bare plate has been learned")
            plate = learned if self._plate.learned else Finding(Level.WARN, MODELLED)
            findings.insert(1, ("plate", plate))
        return Situation(
            self._rig,
            self._vision,
            expected,
            self._visible_objects(things, radius, expected),
            tuple(findings),
            self._lens,
            moving=self._is_plate_moving,
        )

    @property
    def _is_plate_moving(self) -> bool:
        """Whether a task moves the plate. A motion is assumed if the planner's prediction is close
        in time to the last image."""
        expected, last = self._expected, self._tracker.stamp
        return expected is not None and (last is None or abs(last - expected.stamp) < PLANNED_S)

    def _visible_objects(
        self, things: np.ndarray, radius: np.ndarray, expected: Expected
    ) -> tuple[Thing, ...]:
        """Return the parts of the last image, and the overlooked objects (n,) OVERLOOKED with their
        radii (n,) [m]."""
        parts, calibration = self._tracker.parts, self._vision.calibration
        place_px = calibration.to_image(parts.position)
        scale = calibration.scale(parts.position)
        shown = [
            Thing(
                name,
                x,
                y,
                pixels * math.sqrt(self._rig.part_type(part_class(name)).area_m2 / math.pi),
            )
            for name, (x, y), pixels in zip(
                parts.ids, place_px.tolist(), scale.tolist(), strict=True
            )
            if part_class(name) not in NAMELESS  # parts without a class are already in `things`
        ]
        for thing, size in zip(things, radius.tolist(), strict=True):
            reason = str(thing["reason"])
            x, y, pixels = (float(thing[name]) for name in ("x_px", "y_px", "radius_px"))
            shown.append(Thing("", x, y, pixels, reason, remedy(reason, 1e3 * size, expected)))
        return tuple(shown)

    def _lens_finding(self) -> Finding:
        lens = self._lens or rig_lens(self._rig)
        if self._lens_problem:
            return Finding(Level.ERROR, self._lens_problem)
        if lens is None:
            return Finding(
                Level.WARN, "the lens is unknown; take pictures of a board to calibrate it"
            )
        return Finding(Level.OK, f"{lens.model}, focal length {lens.matrix[0, 0]:.0f} px")

    def _use_corners(self, corners_px: np.ndarray) -> None:
        """Use these corners (4, 2) [px] of the plate until the node ends. The bare plate is
        forgotten, because it was learned before the camera was moved."""
        corners = tuple((float(x), float(y)) for x, y in corners_px)
        self._rig = replace(self._rig, camera=replace(self._rig.camera, corners_px=corners))
        self._plate = BarePlate()
        self._restart_detection(self._lens)

    def _use_lens(self, lens: Lens) -> None:
        """Use a lens that was fitted to pictures."""
        self._restart_detection(lens)
        self._lens, self._lens_problem = lens, ""

    def _restart_detection(self, lens: Lens | None) -> None:
        """Locate the plate and the parts again with the rig and this lens, as after the start of
        the node."""
        vision = make_vision(self._rig, self._vision.options, lens)
        self._vision = replace(vision, background=self._plate.first)
        self._tracker, self._expected = Tracker(self._tracker.options), None
        self._outline, self._location = None, self._initial_location()
        if self._location is None:
            self._publish_camera_pose()

    def _on_forces(self, msg: PartForces) -> None:
        """Store the planner's prediction of the parts at the start of a cycle, if the message
        contains a prediction."""
        try:
            request = msg_to_request(msg)
        except PlateError:
            return  # the message is invalid; the solver reports this error
        self._expected = None
        if request.start is not None:
            place = request.start[:, :2]
            self._expected = Prediction(request.parts.ids, seconds(msg.start), place)

    def _check_outline(self, image: np.ndarray, stamp: float) -> None:
        """Compare the plate's outline in the first images, or in each photograph, with the
        predicted outline. For a plate with markers, the prediction is made from the markers."""
        is_photograph, before = self.options.photographs, self._outline
        if is_photograph:
            before = OutlineCheck.of(self._rig, self._vision.calibration, images=1)
        elif before is None:
            before = OutlineCheck.of(self._rig, self._vision.calibration)
        self._outline = before.add(image, stamp, moving=self._is_plate_moving)
        found = self._outline.finding
        if found is not None and before.finding is None and not is_photograph:
            self._warn(found.message)

    def _count_faint_patches(self, image: np.ndarray, stamp: float) -> None:
        """Count faint patches that are as large as round parts. The result is the smaller count of
        two consecutive searches. For a photograph, the result is the count of one search."""
        if self._vision.catalogue is not None:
            # parts with taught types are recognised by comparison with the bare plate, not by this
            # search
            return
        part_count, things, _ = self._part_count_and_overlooked()
        vision, place = self._vision, [track.position for track in self._tracker.found]
        known_px = vision.calibration.to_image(np.array(place).reshape(-1, 2))
        known_px = np.vstack([known_px, np.column_stack([things["x_px"], things["y_px"]])])
        radius_px = vision.options.radius_px
        margin_px = self._rig.limits.stroke_m * radius_px / vision.radius
        found, contrast = faint_patches(image, vision.region, radius_px, known_px, margin_px)
        is_photograph = self.options.photographs
        count = len(found) if is_photograph else min(len(found), self._faint_count)
        self._faint = faint_finding(count, contrast, part_count)
        self._faint_count, self._faint_at = len(found), stamp

    def _record_overlooked(self) -> list[OverlookedThing]:
        """Record the objects that are rejected as parts. Return these objects with their values in
        metres."""
        part_count, things, radius = self._part_count_and_overlooked()
        self._tally.overlooked.add(part_count, things, radius)
        columns = (things["x"], things["y"], radius, things["reason"])
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return [OverlookedThing(*row) for row in rows]

    def _part_count_and_overlooked(self) -> tuple[int, np.ndarray, np.ndarray]:
        """Return the number of parts in the last image, and the objects (n,) OVERLOOKED that are
        rejected as parts, with their radii (n,) [m]. Shadows and edges of round parts are not
        included."""
        things = self._tracker.overlooked
        scale = self._vision.calibration.scale(np.column_stack([things["x"], things["y"]]))
        radius = things["radius_px"] / scale
        part_places = [
            track.position for track in self._tracker.found if track.label not in NAMELESS
        ]
        if self._vision.catalogue is None:
            centre = np.array(part_places).reshape(-1, 2)
            beside = is_separate_object(things, radius, self._vision.radius, centre)
            things, radius = things[beside], radius[beside]
        return len(part_places), things, radius

    def _log_id_changes(self) -> None:
        """Log the ids that the tracker removed or renamed in the last image."""
        given_up, renamed = self._tracker.given_up, self._tracker.renamed
        if given_up:
            images = self._tracker.options.max_missed + 1
            self.get_logger().info(f"lost after {images} images: {', '.join(given_up)}")
        for before, now in renamed:
            self.get_logger().info(f"{before} has changed its class: its id is now {now}")
        self._given_up_count += len(given_up)
        self._renamed_count += len(renamed)

    def _draw_detections(self, image: np.ndarray) -> np.ndarray:
        parts, calibration = self._tracker.parts, self._vision.calibration
        return draw_detections(
            image,
            parts.ids,
            calibration.to_image(parts.position),
            self._rig.parts.radius_m * calibration.scale(parts.position),
            calibration.to_image(parts.position + ARROW_S * parts.velocity),
            self._vision.region.outline_px,
            outlines_px(self._rig.types, parts.ids, parts.position, parts.angle, calibration),
        )

    def _make_markers(self, stamp: Time) -> MarkerArray:
        parts = self._tracker.parts
        self._trails = {
            track.id: self._trails.get(track.id, deque(maxlen=TRAIL))
            for track in self._tracker.tracks
        }
        for name, (x, y) in zip(parts.ids, parts.position.tolist(), strict=True):
            self._trails[name].append((x, y))
        pose = None if self._location is None else self._location.pose
        return scene_to_msg(self._rig, parts, self._trails, HOME if pose is None else pose, stamp)

    def _initial_location(self) -> PlateLocation | None:
        """Return the initial location of a plate with markers, without a pose. Return None if the
        plate has no markers."""
        has_markers = self._rig.fiducials is not None
        return PlateLocation(self._rig, self._lens) if has_markers else None

    def _locate_plate(self, location: PlateLocation, image: np.ndarray, stamp: Time) -> np.ndarray:
        """Locate the plate by its markers. Return the image without the markers."""
        found = location.home is None
        location, self._vision, image = follow_plate(location, self._vision, image)
        self._location = location
        if found:
            self._publish_camera_pose()
        if location.pose is not None:
            self._poses.publish(pose_to_msg(location.pose, stamp))
            self._transforms.publish(plate_to_msg(location.pose, stamp))
        if location.problem:
            self._warn(location.problem)
            self._tally.problem = location.problem
        return image

    def _publish_camera_pose(self) -> None:
        """Publish the camera's pose, if its lens is known."""
        lens = self._lens or rig_lens(self._rig)
        if lens is not None:
            pose = home_pose(self._vision.calibration.image_from_home, lens.matrix)
            self._cameras.publish(camera_to_msg(*pose, self.get_clock().now().to_msg()))

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Forget all parts and the location of home. The parts' ids start from 1 again with the
        next image."""
        response.message = f"{len(self._tracker.tracks)} parts forgotten"
        self._tracker, self._expected = Tracker(self._tracker.options), None
        self._location = self._initial_location()
        self._outline = None
        response.success = True
        self.get_logger().info(response.message)
        return response

    def _diagnose(self, now: float) -> Finding:
        """Return the worst finding of the images since the last report (see
        `plate_core.status`)."""
        tally = self._tally
        findings = [used("images", tally.images, tally.refused, tally.why)]
        if second_publisher := self.second_publisher(self._topic):
            findings.append(Finding(Level.WARN, second_publisher))
        if self._lens_problem:
            findings.append(Finding(Level.ERROR, self._lens_problem))
        if tally.problem:
            findings.append(Finding(Level.WARN, tally.problem))
        if self._vision.catalogue is not None and not self._plate.learned:
            findings.append(Finding(Level.WARN, MODELLED))
        if self._outline is not None:
            findings.append(self._outline.finding)
        findings.append(self._faint)
        findings.append(tally.overlooked_lately.finding(Expected.of(self._rig)))
        findings.append(self._silence(now))
        if self._input.arrival is None:
            return combined(findings, f"waiting for images on {self._input.topic}")
        return combined(findings, "all images used")

    def _silence(self, now: float) -> Finding | None:
        """Return a finding if no image has arrived for too long, otherwise None."""
        if self._input.timeout_finding(now) is None:
            return None
        advice = silence_advice(self, self._input.topic)
        return replace(self._input, advice=advice).timeout_finding(now)

    def _diagnostic_values(self) -> Mapping[str, object]:
        now, tally = time.monotonic(), self._tally
        took = tally.detection_ms
        return {
            "images": self._images,
            "refused": self._refused,
            "rate_hz": f"{tally.images / max(now - self._reported_at, 1e-3):.1f}",
            "silent_s": f"{self._input.age(now):.2f}",
            "parts_seen": len(self._tracker.parts),
            **tally.overlooked_lately.values(),
            "faint_patches": self._faint_count,
            "ids_given_up": self._given_up_count,
            "ids_renamed": self._renamed_count,
            "plate_outline": "" if self._outline is None else self._outline.text,
            "detection_ms_median": f"{np.median(took):.2f}" if took else "0",
            "detection_ms_max": f"{max(took):.2f}" if took else "0",
        }

    def _begin_report(self) -> None:
        tally = Tally(overlooked_before=self._tally.overlooked)
        self._tally, self._reported_at = tally, time.monotonic()

    def _warn(self, text: str) -> None:
        # Each photograph is processed once, so messages about photographs are not throttled.
        if self.options.photographs:
            self.get_logger().warning(text)
        else:
            self.get_logger().warning(text, throttle_duration_sec=WARN_S)

    def _on_camera_info(self, msg: CameraInfo) -> None:
        roi = msg.roi
        content = (
            *(msg.width, msg.height, msg.distortion_model, tuple(msg.k), tuple(msg.d)),
            *(msg.binning_x, msg.binning_y, roi.x_offset, roi.y_offset, roi.width, roi.height),
        )
        if content == self._lens_message:
            return
        # remember the message, so that the same lens is checked only once
        self._lens_message = content
        try:
            lens = lens_of(msg, self._vision.region.size_px)
            known = make_vision(self._rig, self._vision.options, lens)
            self._vision = replace(known, background=self._vision.background)
            self._lens = lens
            self._outline = None
            self._location = self._initial_location()
            if self._location is None:
                self._publish_camera_pose()
            self._lens_problem = ""
        except PlateError as error:
            self._lens_problem = f"camera_info ignored: {error}"
            self._warn(self._lens_problem)

    def retune(self) -> None:
        """Apply changed live parameters."""
        radius_px = self._vision.options.radius_px
        options = replace(self.options.detector(), radius_px=radius_px)
        self._vision = replace(self._vision, options=options)
        self._tracker = replace(self._tracker, options=self.options.tracker())


def main() -> None:
    """Run the node."""
    run_node(DetectorNode, DetectorParameters)
