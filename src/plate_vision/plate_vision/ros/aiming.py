"""The view that helps to aim the camera, and its services. A worker thread measures pictures while
the topic `aim` has a subscriber.

The worker thread measures one picture at a time. The worker thread never blocks the detector's
callbacks.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from plate_core import PlateError, Rig, load_rig
from plate_core.rig import LENS_MODELS, edit_rig, rig_path
from plate_core.ros import DATA, SafeLifecycleNode, seconds
from plate_core.status import Finding, Level
from plate_interfaces.msg import Aim, AimCheck, LensPictures, SeenThing
from plate_interfaces.srv import TakeLensPictures

from ..aiming import (
    AimField,
    Focus,
    Situation,
    edge_blur_px,
    light_finding,
    measure_light,
    measure_sharpness,
    outline_finding,
    outline_px,
    size_finding,
)
from ..camera import Board, Lens, LensFit, grey_levels, lens_keys, rig_lens
from ..camera.boards import MIN_PICTURES, find_board
from ..camera.lens_pictures import COLUMNS, ROWS
from ..camera.lens_pictures import LensPictures as Pictures
from ..errors import CalibrationError, check_size
from ..plate import find_home
from ..plate.corners import find_plate_corners
from ..plate.outline import measure_outline

PERIOD_S = 0.4
"""Minimum time between two measured pictures [s]. A measurement takes 30 to 150 ms."""

TIMEOUT_S = 1.0
"""Time without an image after which the view reports an error [s]."""

OTHER_NODES = (
    "restart the server of the page; if readout_s in section camera is above 0, restart the "
    "planner too; other nodes need no restart"
)
"""Advice after a change of the rig file. The advice concerns other nodes than the detector that
also transform positions between image and plate."""

LEVELS = {
    Level.OK: AimCheck.OK,
    Level.STALE: AimCheck.WAIT,
    Level.WARN: AimCheck.WARN,
    Level.ERROR: AimCheck.ERROR,
}


@dataclass(frozen=True, eq=False)
class LensJob:
    """The pictures for the lens, and the state of the fit.

    Attributes
    ----------
    pictures : Pictures or None
        The collected pictures; None before the first image.
    board : Board
    model : str
        Model of the distortion.
    state : int
        State constant of the message `LensPictures`.
    text : str
    seen_px : (n, 2)
        Corners of the board in the newest image [px].
    fit : LensFit or None
    """

    pictures: Pictures | None
    board: Board
    model: str
    state: int = LensPictures.TAKING
    text: str = "waiting for an image"
    seen_px: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    fit: LensFit | None = None


class AimingView:
    """Publishes `aim` and provides the services ~/find_home, ~/save_home, ~/take_lens_pictures,
    ~/fit_lens and ~/save_lens.

    Parameters
    ----------
    node : SafeLifecycleNode
        The detector, which is being configured.
    situation : callable
        Returns the present state of the detector.
    take_corners : callable
        Function that is called with the plate's corners (4, 2) [px] after home was found.
    take_lens : callable
        Function that is called with the lens after the lens was written to the rig file.
    """

    def __init__(
        self,
        node: SafeLifecycleNode,
        situation: Callable[[], Situation],
        take_corners: Callable[[np.ndarray], None],
        take_lens: Callable[[Lens], None],
    ) -> None:
        self._node, self._situation = node, situation
        self._path = rig_path(node.options.rig_file)
        self._take_corners, self._take_lens = take_corners, take_lens
        self._publisher = node.managed_publisher(Aim, "aim", DATA)
        node.managed_service(Trigger, "~/find_home", self._on_find_home)
        node.managed_service(Trigger, "~/save_home", self._on_save_home)
        node.managed_service(TakeLensPictures, "~/take_lens_pictures", self._on_take)
        node.managed_service(Trigger, "~/fit_lens", self._on_fit)
        node.managed_service(Trigger, "~/save_lens", self._on_save)
        node.managed_timer(TIMEOUT_S, self._report_timeout)
        done = node.create_guard_condition(self._run_results)
        node.keep(node.destroy_guard_condition, done)
        self._wake = done.trigger
        self._pool: ThreadPoolExecutor | None = None

    def begin(self) -> None:
        """Start the worker thread, and reset the state of an earlier activation."""
        self._pool = ThreadPoolExecutor(1, "aim")
        self._job: Future[None] | None = None
        self._results: list[Callable[[], None]] = []
        self._field: AimField | None = None
        self._focus = Focus()
        self._lens: LensJob | None = None
        self._home, self._home_requested = "", False
        # whether the home in the rig file was measured with an older lens
        self._home_is_old = False
        # Measured corners of the plate that are not yet written to the rig file.
        self._corners: tuple[tuple[float, float], ...] = ()
        self._measured_at = self._image_at = -math.inf

    def rest(self) -> None:
        """End the worker thread."""
        pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=True, cancel_futures=True)

    @property
    def needed(self) -> bool:
        """Whether the result of any measurement is needed."""
        taking = self._lens is not None and self._lens.state == LensPictures.TAKING
        return taking or self._home_requested or self._publisher.get_subscription_count() > 0

    def add_image(self, image: np.ndarray, stamp: Time, refused: str = "") -> None:
        """Pass an image (H, W) or (H, W, 3) uint8 to the worker thread if measurements are needed
        and the thread is free. `refused` is the reason why the detector could not use the image."""
        now = self._image_at = time.monotonic()
        busy = self._job is not None and not self._job.done()
        if self._pool is None or busy or now - self._measured_at < PERIOD_S or not self.needed:
            return
        self._measured_at = now
        situation = self._situation()
        self._job = self._pool.submit(self._measure_image, image, stamp, refused, situation)

    # The functions below run on the worker thread.

    def _measure_image(
        self, image: np.ndarray, stamp: Time, refused: str, situation: Situation
    ) -> None:
        try:
            self._process_requests(image, situation)
            msg = self._make_message(image, stamp, refused, situation)
        except Exception as error:
            # Log the error here. The thread pool would only store it in the future, where nobody
            # reads it.
            text = f"aim: {type(error).__name__}: {error}"
            self._run_on_executor(
                lambda: self._node.get_logger().error(text, throttle_duration_sec=5.0)
            )
            return
        self._run_on_executor(lambda: self._publisher.publish(msg))

    def _run_on_executor(self, result: Callable[[], None]) -> None:
        """Run a function on the thread of the ROS executor."""
        self._results.append(result)
        self._wake()

    def _process_requests(self, image: np.ndarray, situation: Situation) -> None:
        """If requested, search the image for the plate at home or for a calibration board."""
        if self._home_requested:
            self._home_requested = False
            self._find_home(image, situation)
        lens = self._lens
        if lens is None or lens.state != LensPictures.TAKING:
            return
        size_px = (image.shape[1], image.shape[0])
        pictures, corners = lens.pictures, None
        if pictures is None or pictures.size_px != size_px:
            pictures = Pictures(lens.board, size_px)
        try:
            board, corners = find_board(grey_levels(image), pictures.board, fast=True)
            pictures, text = pictures.shown(board, corners)
        except CalibrationError as error:
            text = str(error)
        seen_px = np.empty((0, 2)) if corners is None else corners[1]
        if self._lens is lens:  # false if the user has discarded the pictures
            self._lens = replace(lens, pictures=pictures, text=text, seen_px=seen_px)

    def _find_home(self, image: np.ndarray, situation: Situation) -> None:
        rig, lens = situation.rig, situation.lens
        try:
            if situation.moving:
                raise CalibrationError("a task moves the plate, allowed: the plate at rest at home")
            camera = rig.camera
            size_px, allowed_px = image.shape[1::-1], (camera.width_px, camera.height_px)
            check_size("image: size is", size_px, allowed_px, CalibrationError)
            if rig.fiducials is None:
                corners_px, error = find_plate_corners(image, rig, lens)
                by = f"bow of the edges is {1e3 * error:.2f} mm"
            else:
                calibration, error = find_home(image, rig.fiducials, lens or rig_lens(rig))
                corners_px = calibration.to_image(rig.plate.corners)
                by = f"error of the markers' corners is {1e3 * error:.2f} mm"
        except PlateError as error:
            self._home, self._corners = f"not found: {error}", ()
            return
        self._corners = tuple((round(x, 2), round(y, 2)) for x, y in corners_px.tolist())
        self._home_is_old = False
        self._home = f"found, {by}; corners_px: {corners_text(self._corners)}"
        self._run_on_executor(lambda: self._take_corners(corners_px))

    def _fit_lens(self, lens: LensJob) -> None:
        assert lens.pictures is not None
        try:
            fit = lens.pictures.fit(lens.model)
        except Exception as error:
            # Also catch errors of OpenCV. An error that is not caught would leave the state FITTING
            # forever.
            if self._lens is lens:
                self._lens = replace(lens, state=LensPictures.TAKING, text=f"no lens: {error}")
            return
        matrix, deviation = fit.lens.matrix, fit.deviation
        text = f"focal length {matrix[0, 0]:.1f} +- {deviation[0]:.1f} px"
        if fit.warning:
            text += f"; {fit.warning}"
        if self._lens is lens:  # false if the user has discarded the pictures
            self._lens = replace(lens, state=LensPictures.FITTED, text=text, fit=fit)

    def _make_message(
        self, image: np.ndarray, stamp: Time, refused: str, situation: Situation
    ) -> Aim:
        msg = Aim(header=Header(stamp=stamp, frame_id="camera_optical_frame"))
        msg.height, msg.width = image.shape[:2]
        checks: list[tuple[str, Finding]] = []
        if refused:
            checks.append(("picture", Finding(Level.ERROR, refused)))
        else:
            checks.append(("picture", Finding(Level.OK, f"{msg.width} x {msg.height} px")))
        # While the user shows a board to the camera, the board hides the plate.
        board = self._lens is not None
        if (msg.width, msg.height) == situation.vision.region.size_px:
            checks += self._measure_plate(msg, image, seconds(stamp), situation, board)
        known = [] if refused or board else situation.things
        msg.things = [
            SeenThing(
                id=thing.id, x_px=thing.x_px, y_px=thing.y_px, radius_px=thing.radius_px,
                reason=thing.reason, remedy=thing.remedy,
            )
            for thing in known
        ]  # fmt: skip
        waits = [("lens", Finding(Level.STALE, "taking pictures of a board"))]
        checks += waits if board else situation.findings
        if self._home_is_old and not board:
            home_finding = Finding(
                Level.WARN, "home was found before the lens was changed; find home again"
            )
            checks.insert([name for name, _ in checks].index("lens") + 1, ("home", home_finding))
        msg.checks = [
            AimCheck(name=name, level=LEVELS[found.level], text=found.message)
            for name, found in checks
        ]
        msg.home, msg.home_found = self._home, bool(self._corners)
        msg.lens = self._lens_progress()
        return msg

    def _measure_plate(
        self, msg: Aim, image: np.ndarray, stamp: float, situation: Situation, board: bool
    ) -> list[tuple[str, Finding]]:
        """Measure an image of the correct size, fill in the message, and return the checks. While
        pictures of a board are taken, only light and sharpness are measured."""
        field = self._field
        if field is None or field.vision.region is not situation.vision.region:
            field = AimField.of(situation.rig, situation.vision, situation.expected)
            self._field, self._focus = field, Focus()
        light = measure_light(image, field)
        msg.black, msg.white = light.black, light.white
        msg.histogram = light.histogram.astype(np.uint32)
        msg.part_px_min, msg.part_px_max = field.part_px
        msg.sharpness = measure_sharpness(image, field)
        msg.sharpness_best = msg.sharpness_change = math.nan
        if board:  # the sharpness of a board cannot be compared with the sharpness of the plate
            return []
        outline = measure_outline(image, field.grid)
        blur_px = math.nan if situation.moving else edge_blur_px(image, outline, field)
        self._focus = focus = self._focus.add(stamp, msg.sharpness, blur_px)
        msg.sharpness_best, msg.sharpness_change = focus.best, focus.change
        msg.expected = points_to_msg(situation.vision.region.outline_px)
        msg.seen = points_to_msg(outline_px(outline, field))
        return [
            ("light", light_finding(image, light, field)),
            ("focus", focus.finding),
            ("outline", outline_finding(image, outline, field, situation.moving)),
            ("size", size_finding(field.part_px)),
        ]

    def _lens_progress(self) -> LensPictures:
        lens, msg = self._lens, LensPictures(needed=MIN_PICTURES, file=str(self._path))
        msg.cover_columns, msg.cover_rows, msg.error_px = COLUMNS, ROWS, math.nan
        if lens is None:
            return msg
        msg.state, msg.text, msg.corners = lens.state, lens.text, points_to_msg(lens.seen_px)
        if lens.pictures is not None:
            msg.kept = len(lens.pictures.kept)
            msg.cover = lens.pictures.cover.tolist()
            msg.missing = list(lens.pictures.missing)
        if lens.fit is not None:
            msg.error_px = lens.fit.error_px
        return msg

    # The functions below run on the thread of the ROS executor.

    def _run_results(self) -> None:
        while self._results:
            result = self._results.pop(0)
            if self._node.active:
                result()

    def _report_timeout(self) -> None:
        """Publish an error if no image arrives."""
        if not self._publisher.get_subscription_count():
            return
        image_age_s = time.monotonic() - self._image_at
        if image_age_s < TIMEOUT_S:
            return
        msg = Aim(sharpness=math.nan, sharpness_best=math.nan, sharpness_change=math.nan)
        msg.header.stamp = self._node.get_clock().now().to_msg()
        text = "no image has arrived; check that the camera runs"
        if math.isfinite(image_age_s):
            text = f"no image for {image_age_s:.0f} s; check that the camera runs"
        msg.checks = [AimCheck(name="picture", level=AimCheck.ERROR, text=text)]
        msg.home, msg.home_found = self._home, bool(self._corners)
        msg.lens = self._lens_progress()
        self._publisher.publish(msg)

    def _on_find_home(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._home, self._corners, self._home_requested = "searching in the next image", (), True
        self._measured_at = -math.inf
        response.success, response.message = True, self._home
        return response

    def _on_save_home(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Write the corners found by the last search to the rig file."""
        corners = self._corners
        if not corners:
            response.message = "home has not been found; call ~/find_home first"
            return response
        try:
            before = load_rig(self._path)
            after = replace(before, camera=replace(before.camera, corners_px=corners))
            text = corners_text(corners)
            edit_rig(self._path, {("camera",): {"corners_px": text}}, lambda rig: rig == after)
        except (PlateError, OSError) as error:
            response.message = str(error)
            return response
        self._home, self._corners = f"written: {self._path}", ()
        response.success = True
        response.message = f"{self._home}; {OTHER_NODES}"
        return response

    def _on_take(
        self, request: TakeLensPictures.Request, response: TakeLensPictures.Response
    ) -> TakeLensPictures.Response:
        """Start to take pictures of a calibration board, or discard all pictures."""
        if not request.on:
            self._lens = None
            response.success, response.message = True, "the pictures are discarded"
            return response
        model = request.model or "plumb_bob"
        try:
            if model not in LENS_MODELS:
                raise CalibrationError(f"model is {model!r}, allowed: {', '.join(LENS_MODELS)}")
            board = Board(
                request.columns, request.rows, request.square_m, request.marker_m,
                request.dictionary or Board.dictionary,
            )  # fmt: skip
        except CalibrationError as error:
            response.message = str(error)
            return response
        self._lens = LensJob(None, board, model)
        response.success = True
        response.message = "taking pictures: move the board, then hold it still for a second"
        return response

    def _on_fit(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        lens, pool = self._lens, self._pool
        kept = 0 if lens is None or lens.pictures is None else len(lens.pictures.kept)
        if lens is None or pool is None or kept < MIN_PICTURES:
            response.message = f"{kept} pictures were taken, allowed: at least {MIN_PICTURES}"
            return response
        if lens.state == LensPictures.FITTING:
            response.message = "the lens is being fitted"
            return response
        self._lens = replace(lens, state=LensPictures.FITTING, text="the lens is being fitted")
        pool.submit(self._fit_lens, self._lens)
        response.success, response.message = True, f"the lens is fitted to {kept} pictures"
        return response

    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Write the fitted lens to the rig file, and use it. If the plate has no markers, home must
        be found again, because its corners were found by edges that appeared bent without this
        lens."""
        lens = self._lens
        if lens is None or lens.fit is None:
            response.message = "no lens has been fitted; call ~/fit_lens first"
            return response
        try:
            before, keys = load_rig(self._path), lens_keys(lens.fit.lens)
            size_px = before.camera.width_px, before.camera.height_px
            check_size("size of the pictures is", lens.fit.size_px, size_px)

            def is_changed(rig: Rig) -> bool:
                new = rig_lens(rig)
                rest = replace(rig, camera=replace(rig.camera, lens=before.camera.lens))
                return new is not None and lens_keys(new) == keys and rest == before

            edit_rig(self._path, {("camera",): keys}, is_changed)
            self._take_lens(lens.fit.lens)
        except (PlateError, OSError) as error:
            response.message = str(error)
            return response
        self._lens = None
        self._home, self._corners = "", ()
        # If the rig has markers, each image shows the pose of the home position. With markers, a
        # stored home cannot be too old.
        self._home_is_old = before.fiducials is None
        response.success = True
        response.message = f"written: {self._path}; {OTHER_NODES}"
        return response


def corners_text(corners: Sequence[tuple[float, float]]) -> str:
    """Return corners (4, 2) [px] as text for a rig file."""
    return "[" + ", ".join(f"[{x:.2f}, {y:.2f}]" for x, y in corners) + "]"


def points_to_msg(place_px: np.ndarray) -> list[Point]:
    """Return image points (n, 2) [px] as messages. Points outside the lens's field of view are
    omitted."""
    return [Point(x=x, y=y) for x, y in place_px.tolist() if math.isfinite(x + y)]
