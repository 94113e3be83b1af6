"""ROS node of the simulator. The node simulates the parts on a plate that follows the received
motor tables or the motion of the simulated device. The node publishes camera images and the true
positions of the parts. `world.Simulation` is the model.

Cycle k begins at the time t_k with the newest motor table. The message cycle_started has the stamp
t_k. Then image k is taken, and the parts are simulated until t_k+1. In real time, cycle k+1 begins
at t_k+1. In lockstep, cycle k+1 begins when a table with the stamp of image k arrives. If image k
is missing, cycle k+1 begins at once. If no new table has arrived, the plate repeats the last table
or executes its tail. If the device drives the plate, the parts are simulated for each segment of
motor_motion. An image is taken at the end of a segment or at a trigger pulse. While the node is
inactive, simulated time does not advance.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock as ClockMsg
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from plate_core import Parts, PlateCycle, PlateError, load_rig
from plate_core.motion import HOLD_CYCLES, IDLE_S, CycleUsage, Timeline
from plate_core.ros import (
    DATA,
    IMAGE,
    LATCHED,
    WARN_S,
    NodeOptions,
    SafeLifecycleNode,
    array_to_image,
    camera_to_info,
    cycle_to_msg,
    msg_to_knots,
    msg_to_motors,
    nanoseconds,
    parameter,
    parts_to_msg,
    run_node,
    to_time,
)
from plate_core.status import INPUT_TIMEOUT_S, Finding, Input, Level, combined, used
from plate_core.tasks import load_scenario
from plate_interfaces.msg import DriverStatus, Part
from plate_interfaces.msg import Parts as PartsMsg
from plate_interfaces.srv import MoveRobot, OpenHopper, PlacePart, RemovePart

from .camera import NOISE, Camera
from .plate import PlateMotion, check_table
from .world import RANGES, WORLD_RANGES, Disturbances, Simulation, run_cycle

START_NS = 1_000_000_000
"""Simulated time of the first image [ns]. The time is not 0, because a stamp of 0 means "no
time"."""

CLOCK_PERIOD_S = 0.01
"""Interval between two messages on /clock [s, wall]."""

REPEAT_PERIOD_S = 1.0
"""In lockstep, the simulator waits for the motor table that results from an image. While this table
is missing, the simulator publishes the image and the start of its cycle again at this interval [s,
wall]."""

MIN_NS = 20_000_000
"""Minimum time between two images if the simulated device moves the plate [ns]. If the next image
would be taken earlier, it is omitted."""

PLAYING = (DriverStatus.READY, DriverStatus.CALIBRATING)
"""States in which the driver sends motor tables."""

GAP_NS = 1_000_000
"""Tolerance of times of the device's motion [ns]. The gap between two consecutive segments must not
exceed it. The gap between the end of a segment and the trigger pulse for its image must not exceed
it either."""

MAX_CLOCK_ERROR_NS = 50_000_000
"""Maximum difference between the stamps of images and the clock of the system [ns]. This limit
applies only in real time."""

IMAGE_GROUP = "Effects in the images (config/nodes.yaml explains them)"
"""Title of the group of parameters that affect only images."""

NO_USE = CycleUsage(0.0, 0.0, 0.0, 0.0)


def _disturbance_parameter(name: str, description: str, live: bool = True, group: str = "") -> Any:
    """Return a parameter of the node that sets the field `name` of `Disturbances`."""
    value = getattr(Disturbances, name)
    return parameter(value, description, *RANGES[name], live=live, group=group)


def _image_parameter(name: str, description: str) -> Any:
    """Return a parameter of the node that sets a disturbance of the images only."""
    return _disturbance_parameter(name, description, group=IMAGE_GROUP)


@dataclass(frozen=True)
class Options(NodeOptions):
    """Parameters of the simulator."""

    scenario: str = parameter("sort_10", "Scenario that defines the parts on the plate.")
    seed: int = parameter(
        0, "Random seed of the parts' places and of the image noise, used from the next reset on.",
        0, 2**31 - 1, live=True,
    )  # fmt: skip
    driven_by: str = parameter(
        "setpoints", "Source of the plate's motion: the setpoints of the driver, or a device.",
        choices=("setpoints", "device"),
    )  # fmt: skip
    lockstep: bool = parameter(
        False,
        "Whether the simulator waits for the reply to each image. If false, it runs in real time.",
    )
    rate: float = parameter(
        1.0, "Simulated seconds per second, if time is simulated.", 0.01,
        100, live=True,
    )  # fmt: skip
    simulated_time: bool = parameter(
        False, "Whether time is simulated (/clock); rate can then be changed."
    )
    noise: float = parameter(
        NOISE, "Standard deviation of the image noise [grey values].", *WORLD_RANGES["noise"],
        live=True,
    )  # fmt: skip
    mu_scale: float = parameter(
        1.0,
        "Friction in the simulation divided by the friction in the rig file.",
        *WORLD_RANGES["mu_scale"],
        live=True,
    )
    hold_cycles: int = parameter(
        HOLD_CYCLES,
        "Number of times that a cycle from rest to rest is played if no new cycle arrives.",
        1,
        1000,
    )
    input_timeout_s: float = parameter(
        INPUT_TIMEOUT_S,
        "Time without motor commands after which diagnostics are STALE [s, wall].",
        0.1,
        3600.0,
    )
    idle_period: float = parameter(
        IDLE_S, "Length of a cycle while the plate is at rest [s].", 0.01, 10
    )
    friction_spread: float = _disturbance_parameter(
        "friction_spread", "Maximum relative deviation of friction between parts."
    )
    friction_patches: float = _disturbance_parameter(
        "friction_patches", "Maximum relative deviation of friction on the plate."
    )
    static_ratio: float = _disturbance_parameter(
        "static_ratio", "Static friction divided by dynamic friction."
    )
    friction_slope: float = _disturbance_parameter(
        "friction_slope", "Relative friction change per slip speed [1/(m/s)]."
    )
    heave: float = _disturbance_parameter("heave", "Upward motion divided by the motion along x.")
    tilt_x: float = _disturbance_parameter(
        "tilt_x", "Tilt of the plate [rad]. If positive, parts slide towards +x."
    )
    tilt_y: float = _disturbance_parameter(
        "tilt_y", "Tilt of the plate [rad]. If positive, parts slide towards +y."
    )
    latency: float = _disturbance_parameter(
        "latency", "Age of an image when it is published and stamped [s].", live=False
    )
    image_rate: float = _disturbance_parameter(
        "image_rate", "Image rate of a free-running camera [1/s]. 0 means one image at the "
        "start of each cycle.",
        live=False,
    )  # fmt: skip
    stamp_jitter: float = _disturbance_parameter(
        "stamp_jitter", "Noise of a free-running camera's stamps [s].",
        live=False,
    )  # fmt: skip
    blur: bool = parameter(
        True, "Whether motion during the exposure time blurs the images.", live=True
    )
    missed_images: float = _disturbance_parameter(
        "missed_images", "Fraction of images that are never published."
    )
    highlights: float = _image_parameter(
        "highlights", "Fraction of each part's area that a highlight covers."
    )
    shadows: float = _image_parameter(
        "shadows", "Fraction of the light that is missing in the shadows of parts."
    )
    missed_parts: float = _image_parameter(
        "missed_parts", "Fraction of the parts that an image does not show."
    )
    false_parts: float = _image_parameter(
        "false_parts", "Number of false parts per true part in an image."
    )
    pick_failure: float = _disturbance_parameter(
        "pick_failure", "Fraction of grips in which the part slips."
    )

    part_height_m: float = _image_parameter(
        "part_height_m", "Height of parts in images [m]. 0 uses the height in the rig file."
    )
    side_shade: float = _image_parameter(
        "side_shade",
        "Brightness of the parts' side faces divided by the brightness of their top faces.",
    )
    size_spread: float = _image_parameter(
        "size_spread", "Maximum relative deviation of the parts' sizes in images."
    )
    gloss: float = _image_parameter(
        "gloss", "Radius of the lamp's reflection on each part, divided by the part's radius."
    )
    shadow_length_m: float = _image_parameter("shadow_length_m", "Length of the shadows [m].")
    shadow_deg: float = _image_parameter("shadow_deg", "Direction of the shadows from x [degrees].")
    penumbra_m: float = _image_parameter("penumbra_m", "Width of the shadows' soft edge [m].")
    light_step: float = _image_parameter(
        "light_step", "Relative change of the light at light_step_s."
    )
    light_step_s: float = _image_parameter(
        "light_step_s", "Time from the start of the simulation to the change of the light [s]."
    )
    flicker: float = _image_parameter("flicker", "Relative amplitude of the light's flicker.")
    flicker_hz: float = _image_parameter("flicker_hz", "Frequency of the light's flicker [Hz].")
    defocus_px: float = _image_parameter(
        "defocus_px", "Standard deviation of the Gaussian blur of images [px]."
    )
    plate_grey: float = _image_parameter("plate_grey", "Grey value of the plate at full light.")
    room_grey: float = _image_parameter(
        "room_grey", "Grey value of the surroundings of the plate at full light."
    )
    black_grey: float = _image_parameter("black_grey", "Grey value of black parts at full light.")
    grey_grey: float = _image_parameter("grey_grey", "Grey value of grey parts at full light.")

    @property
    def disturbances(self) -> Disturbances:
        """Return the disturbances that the parameters set."""
        kinds = {f.name for f in fields(Disturbances)}
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name in kinds}
        return Disturbances(**values)


@dataclass
class Tally:
    """Counts since the diagnostics were last published. The counts are the numbers of received
    tables, of refused tables, and of cycles that started late. `why` is the reason of the last
    refusal."""

    tables: int = 0
    refused: int = 0
    why: str = ""
    late: int = 0


class SimulatorNode(SafeLifecycleNode[Options]):
    """Lifecycle node `simulator`. The node simulates parts on a moving plate and publishes images.

    The node subscribes to motor_setpoints and driver_status. If the device drives the plate, the
    node subscribes to motor_motion and camera_trigger instead. The node publishes image_raw,
    camera_info, cycle_started, diagnostics and ground_truth, and /clock if time is simulated. Use
    ground_truth, the true parts, only to evaluate a run. The service ~/reset restarts the scenario
    with the seed that was set since the last reset, or if none was set, with the last seed plus 1.
    The services ~/place_part, ~/remove_part, hopper/open and ~/move_robot change the parts. After
    such a call, or a change of a live parameter, the seed alone no longer reproduces the run.
    """

    def __init__(self) -> None:
        super().__init__("simulator", Options)
        # seed of the next reset; None if the parameter `seed` was not set
        self._next_seed: int | None = None
        self.add_post_set_parameters_callback(self._record_seed)
        self.report(
            self._diagnose, self._diagnostic_values, "simulation", self._begin_report,
            lambda: to_time(self._time_ns),
        )  # fmt: skip

    def configure(self) -> None:
        """Load the rig and the scenario, place the parts on the plate, and create publishers and
        subscriptions."""
        options = self.options
        self._rig = load_rig(options.rig_file)
        self._scenario, self._seed = load_scenario(options.scenario), options.seed
        self._next_seed, self._rate = None, options.rate
        self._usage = NO_USE
        self._count = {
            "cycles": 0, "late cycles": 0, "held cycles": 0, "refused tables": 0,
            "missed images": 0,
        }  # fmt: skip
        self._simulated_time = options.lockstep or options.rate != 1 or options.simulated_time
        self._driven = options.driven_by == "device"
        if self._driven and self._simulated_time:
            raise PlateError(
                "driven_by is 'device', which requires real time, allowed: rate 1 without lockstep "
                "and simulated_time"
            )
        if options.image_rate > 0 and options.lockstep:
            raise PlateError(
                f"image_rate is {options.image_rate:g} in lockstep, allowed: 0 (one image at the "
                "start of each cycle)"
            )
        self._by_line = self._driven and self._rig.camera.trigger is not None
        if self._by_line and options.latency > 0:
            raise PlateError(
                f"latency is {options.latency:g}, allowed: 0, because the rig has a trigger_phase"
            )
        self._next_ns = START_NS  # start time of the next cycle [ns]
        self._simulation = self._new_simulation()
        self._warm_up()
        self._make_interfaces()

    def begin(self) -> None:
        """Start with the plate at rest. The next cycle begins at once."""
        options = self.options
        self._timeline = Timeline.at_rest(options.idle_period)
        self._tally = Tally()
        self._driver: DriverStatus | None = None  # last status, if the driver moves the plate
        source, topic = "motor table", "motor_setpoints"
        advice = "check that the driver is active and the computer is fast enough"
        if self._driven:
            source, topic, advice = "motion", "motor_motion", "check that the device runs"
        self._input = Input(source, topic, advice, options.input_timeout_s, time.monotonic())
        if not self._simulated_time:
            self._next_ns = Clock(clock_type=ClockType.SYSTEM_TIME).now().nanoseconds
        self._time_ns = self._moved_ns = self._next_ns
        self._pulse_ns = 0  # time of the last trigger pulse [ns]
        self._due_ns = time.monotonic_ns()  # wall time at `_next_ns`
        self._start_shots(self._next_ns)
        # the next image, if it was already rendered; otherwise empty
        self._ahead: list[np.ndarray | None] = []
        if not self._driven:
            self._begin_cycle()

    def rest(self) -> None:
        """Bring the plate to rest. Simulate the remaining time of the running cycle, and then the
        tail of this cycle."""
        if not self._driven:
            self._simulate_parts(self._timeline.cycle, self._next_ns)
            if self._timeline.cycle.tail is not None:
                self._simulation.run(self._timeline.cycle.tail)

    def retune(self) -> None:
        """Apply new values of the parameters for disturbances, noise, friction and rate.

        Raises
        ------
        PlateError
            If the rate cannot be changed in this mode, or a value is outside its range.
        """
        options, before = self.options, self._rate
        if options.rate != before and (options.lockstep or not self._simulated_time):
            now = "in lockstep" if options.lockstep else "in real time, which other nodes use"
            raise PlateError(
                f"rate is {options.rate:g} {now}, allowed: {before:g} (for other rates, start the "
                "simulator with simulated_time or with a rate other than 1)"
            )
        self._simulation.change(options.disturbances, options.noise, options.mu_scale)
        self._ahead = []
        if options.rate != before:
            self._rate, now_ns = options.rate, time.monotonic_ns()
            if self.active:
                self._due_ns = now_ns + round((self._due_ns - now_ns) * before / options.rate)
                self._set_alarm(self._moved_ns)

    def _record_seed(self, parameters: list[Parameter]) -> None:
        """If the parameter `seed` was set, store its value for the next reset, even if it is equal
        to the present seed."""
        for item in parameters:
            if item.name == "seed":
                self._next_seed = int(item.value)

    def _new_simulation(self) -> Simulation:
        """Return a new simulation of the scenario with the current seed."""
        options = self.options
        return Simulation(
            self._rig, self._scenario, self._seed, options.disturbances,
            noise=options.noise, mu_scale=options.mu_scale,
        )  # fmt: skip

    def _warm_up(self) -> None:
        """Simulate one cycle and render one image. All libraries are thus loaded, and all tables
        are computed, before the first cycle."""
        state = self._simulation.state
        angle, rng = np.zeros(len(state.ids)), np.random.default_rng(0)
        run_cycle(state, PlateCycle.rest(self.options.idle_period), self._rig)
        Camera(self._rig).render(state.position, angle, rng)

    def _make_interfaces(self) -> None:
        self._images = self.managed_publisher(Image, "image_raw", IMAGE)
        self._infos = self.managed_publisher(CameraInfo, "camera_info", IMAGE)
        self._truths = self.managed_publisher(PartsMsg, "ground_truth", DATA)
        if not self._driven:
            self._starts = self.managed_publisher(JointTrajectory, "cycle_started", DATA)
        if self._simulated_time:
            self._clocks = self.managed_publisher(ClockMsg, "/clock", DATA)
        if self._driven:
            self.managed_subscription(JointTrajectory, "motor_motion", self._on_motion, DATA)
            if self._by_line:
                self.managed_subscription(Header, "camera_trigger", self._on_pulse, DATA)
        else:
            self.managed_subscription(DriverStatus, "driver_status", self._on_driver, LATCHED)
            self.managed_subscription(JointTrajectory, "motor_setpoints", self._on_table, DATA)
        self.managed_service(Trigger, "~/reset", self._on_reset)
        self.managed_service(PlacePart, "~/place_part", self._on_place)
        self.managed_service(RemovePart, "~/remove_part", self._on_remove)
        self.managed_service(OpenHopper, "hopper/open", self._on_open)
        self.managed_service(MoveRobot, "~/move_robot", self._on_move)
        if self.options.lockstep:
            self._repeat = self.managed_timer(REPEAT_PERIOD_S, self._repeat_image)
        elif not self._driven:
            self._alarm = self.managed_timer(REPEAT_PERIOD_S, self._on_alarm)
            if self._simulated_time:
                self.managed_timer(CLOCK_PERIOD_S, self._publish_clock)

    # Time

    def _begin_cycle(self) -> None:
        """Start the next cycle. In lockstep, if the image of this cycle is missing, start further
        cycles until an image was published."""
        while not self._run_cycle() and self.options.lockstep:
            pass

    def _run_cycle(self) -> bool:
        """Select the table of the next cycle and take its image. Then simulate the parts until the
        next image or the end of the cycle. Return whether an image was published.
        """
        self._time_ns = self._moved_ns = self._next_ns
        options, before = self.options, self._timeline
        self._timeline = before.next(options.hold_cycles, options.idle_period)
        cycle = self._timeline.cycle
        self._publish_start()
        seen = self._shot is None and self._take_image(self._time_ns)
        self._publish_truth()
        period_ns = round(cycle.period * 1e9)
        self._next_ns += period_ns
        self._due_ns += round(period_ns / options.rate)
        self._count["cycles"] += 1
        # `alone` is true if no new table has arrived. In this case, the simulator repeats the last
        # table or executes the tail of the last table.
        tail_alone = before.waiting is None and cycle is before.cycle.tail
        alone = self._timeline.repeats > 0 or tail_alone
        self._count["held cycles"] += alone
        self._count["missed images"] += self._shot is None and not seen
        self._simulate_to_next_event()
        if self._shot is None and not options.lockstep:
            # Render the next image now, while the simulator is idle. A real camera would not use
            # computing time here.
            self._ahead = [self._simulation.capture()]
        return seen

    def _simulate_to_next_event(self) -> None:
        """Simulate the parts until the time at which the next image is delivered or the cycle ends.
        Set the timer to this time."""
        cycle, end_ns = self._timeline.cycle, self._next_ns
        if self._shot is not None and self._delivered_ns < end_ns:
            end_ns = self._delivered_ns
        self._simulate_parts(cycle, end_ns)
        if not self.options.lockstep:
            self._set_alarm(end_ns)

    def _set_alarm(self, until_ns: int) -> None:
        """Set the timer to the simulated time `until_ns` in this cycle [ns]."""
        ahead_ns = round((self._next_ns - until_ns) / self.options.rate)
        self._alarm.timer_period_ns = max(1, self._due_ns - ahead_ns - time.monotonic_ns())
        self._alarm.reset()

    def _simulate_parts(self, motion: PlateCycle | PlateMotion, end_ns: int) -> None:
        """Simulate the parts from the time `_moved_ns` to `end_ns`. The motion `motion` of the
        plate began at the time `_time_ns`."""
        begin, end = (1e-9 * (t - self._time_ns) for t in (self._moved_ns, end_ns))
        if begin == 0 and end_ns == self._next_ns:
            self._simulation.run(motion)
        elif end > begin:
            self._simulation.run(PlateMotion.section(motion, begin, min(end, motion.period)))
        self._moved_ns = max(end_ns, self._moved_ns)

    def _on_alarm(self) -> None:
        if self._moved_ns < self._next_ns:
            self._take_next_image()
            self._simulate_to_next_event()
            return
        behind_ns = time.monotonic_ns() - self._due_ns
        now_ns = Clock(clock_type=ClockType.SYSTEM_TIME).now().nanoseconds
        late = behind_ns > (self._next_ns - self._time_ns) / self.options.rate
        # The stamps of the simulator are wrong if the system clock was set or the computer was
        # suspended.
        wrong = (
            abs(now_ns - behind_ns - self._next_ns) > MAX_CLOCK_ERROR_NS
            and not self._simulated_time
        )
        if late or wrong:
            # During the delay, the simulated plate and parts did not move. Therefore the next cycle
            # begins now.
            self._due_ns += behind_ns
            if not self._simulated_time:
                self._next_ns = now_ns
                self._start_shots(self._next_ns)
            self._count["late cycles"] += 1
            self._tally.late += 1
        self._begin_cycle()

    def _start_shots(self, begin_ns: int) -> None:
        """Start the sequence of images of a free-running camera at the time `begin_ns`."""
        self._shot = None
        if self.options.image_rate > 0:
            self._shots = self._simulation.shots(0.0)
            self._shots_ns = begin_ns
            self._shot = next(self._shots)

    @property
    def _delivered_ns(self) -> int:
        """Delivery time of the next image of a free-running camera [ns]."""
        assert self._shot is not None
        return self._shots_ns + round(1e9 * self._shot.delivered)

    def _take_next_image(self) -> None:
        """Publish the next image of a free-running camera."""
        shot = self._shot
        assert shot is not None
        age = 1e-9 * (self._moved_ns - self._shots_ns) - shot.middle
        seen = self._take_image(self._shots_ns + round(1e9 * shot.stamp), age)
        self._count["missed images"] += not seen
        self._shot = next(self._shots)

    def _publish_clock(self) -> None:
        ahead_ns = (self._due_ns - time.monotonic_ns()) * self.options.rate
        now_ns = self._next_ns - max(0, round(ahead_ns))
        self._clocks.publish(ClockMsg(clock=to_time(max(self._time_ns, now_ns))))

    # Tables

    def _record_input(self) -> None:
        """Count a motor table or a segment of motion that was received."""
        self._input = self._input.received(time.monotonic())
        self._tally.tables += 1

    def _record_refusal(self, error: PlateError) -> None:
        """Count a motor table or a segment of motion that was refused."""
        self._count["refused tables"] += 1
        self._tally.refused += 1
        self._tally.why = str(error)

    def _on_table(self, msg: JointTrajectory) -> None:
        lockstep = self.options.lockstep
        self._record_input()
        if lockstep and nanoseconds(msg.header.stamp) != self._time_ns:
            return  # the table has an old stamp, because the solver has sent its last result again
        try:
            cycle = msg_to_motors(self._rig, msg)
            if cycle.moves and (second_publisher := self.second_publisher("motor_setpoints")):
                raise PlateError(second_publisher)
            self._usage = check_table(self._rig, cycle, self._timeline.cycle)
            self._timeline = self._timeline.send(cycle)
        except PlateError as error:
            self._record_refusal(error)
            self.get_logger().warning(
                f"motor table refused, the plate continues its motion: {error}",
                throttle_duration_sec=WARN_S,
            )
        if lockstep:
            self._begin_cycle()

    def _on_motion(self, msg: JointTrajectory) -> None:
        """Simulate the parts during a segment of the device's motion, and take the images of this
        interval."""
        self._record_input()
        try:
            times, *motors = msg_to_knots(msg, [motor.name for motor in self._rig.motors])
            motion = PlateMotion.of_motors(self._rig, times, np.stack(motors, axis=1))
        except PlateError as error:
            self._record_refusal(error)
            self.get_logger().warning(
                f"motor motion refused, the parts do not move: {error}",
                throttle_duration_sec=WARN_S,
            )
            return
        begin_ns = nanoseconds(msg.header.stamp)
        end_ns = begin_ns + round(motion.period * 1e9)
        self._count["cycles"] += 1
        if self._shot is None:
            self._simulation.run(motion)
            self._moved_ns = end_ns
            if not self._by_line or abs(end_ns - self._pulse_ns) <= GAP_NS:
                self._take_triggered_image(end_ns)
            return
        if abs(begin_ns - self._next_ns) > GAP_NS:
            self._start_shots(begin_ns)
        self._time_ns, self._moved_ns, self._next_ns = begin_ns, begin_ns, end_ns
        self._publish_truth()
        while self._delivered_ns < end_ns:
            self._simulate_parts(motion, self._delivered_ns)
            self._take_next_image()
        self._simulate_parts(motion, end_ns)

    def _on_pulse(self, msg: Header) -> None:
        """Process a trigger pulse. If the parts are already simulated up to the time of the pulse,
        take an image. Otherwise, `_on_motion` takes the image later."""
        self._pulse_ns = nanoseconds(msg.stamp)
        if abs(self._moved_ns - self._pulse_ns) <= GAP_NS:
            self._take_triggered_image(self._pulse_ns)

    def _take_triggered_image(self, now_ns: int) -> None:
        """Take an image, unless the last image was taken less than `MIN_NS` ago."""
        if now_ns - self._time_ns >= MIN_NS:
            self._time_ns = now_ns
            self._count["missed images"] += not self._take_image(now_ns)
            self._publish_truth()

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Restart the scenario. If the parameter `seed` was set since the last reset, it is the
        seed. Otherwise, the seed is the last seed plus 1."""
        self._seed = (self._seed + 1) % 2**31 if self._next_seed is None else self._next_seed
        plate, self._next_seed = self._simulation.plate, None
        self._simulation, self._ahead = self._new_simulation(), []
        self._simulation.plate = plate  # the plate continues its motion
        response.success, response.message = True, f"parts are at new positions, seed {self._seed}"
        return response

    def _on_place(
        self, request: PlacePart.Request, response: PlacePart.Response
    ) -> PlacePart.Response:
        """Place a part on the plate, as if by hand. The part is visible from the next image on."""
        position = np.array([request.x, request.y])
        self._ahead = []
        try:
            response.id = self._simulation.place(request.id, request.type, position, request.angle)
        except PlateError as error:
            response.message = str(error)
            return response
        new = "" if request.id else "new: "
        response.success = True
        response.message = f"{new}{response.id} is at ({request.x:.3f}, {request.y:.3f}) m"
        return response

    def _on_remove(
        self, request: RemovePart.Request, response: RemovePart.Response
    ) -> RemovePart.Response:
        """Remove a part from the plate, as if by hand."""
        self._ahead = []
        try:
            self._simulation.remove(request.id)
        except PlateError as error:
            response.message = str(error)
            return response
        response.success, response.message = True, f"{request.id} was removed"
        return response

    def _on_open(
        self, request: OpenHopper.Request, response: OpenHopper.Response
    ) -> OpenHopper.Response:
        """Open the hopper for the requested time."""
        try:
            count = self._simulation.open_hopper(request.duration_s)
        except PlateError as error:
            response.message = str(error)
            return response
        response.success = True
        response.message = f"open for {request.duration_s:g} s, {count} parts will drop"
        return response

    def _on_move(
        self, request: MoveRobot.Request, response: MoveRobot.Response
    ) -> MoveRobot.Response:
        """Move the robot, and grip a part if this is requested."""
        self._ahead = []
        try:
            done = self._simulation.move_robot(request.to, request.x, request.y, request.angle)
        except PlateError as error:
            response.message = str(error)
            return response
        response.success, response.message, response.id = done.success, done.message, done.id
        response.error_m, response.error_rad = done.error_m, done.error_rad
        return response

    # Messages

    def _take_image(self, stamp_ns: int, age: float | None = None) -> bool:
        """Publish the image that `Simulation.capture` returns, unless the image is missing. Return
        whether an image was published."""
        stamp = to_time(stamp_ns)
        pixels = self._ahead.pop() if self._ahead else self._simulation.capture(age)
        if pixels is not None:
            self._image = array_to_image(pixels, stamp, "mono8" if pixels.ndim == 2 else "bgr8")
            self._publish_image()
        elif self._simulated_time and self._shot is None:
            self._clocks.publish(ClockMsg(clock=stamp))
        return pixels is not None

    def _publish_truth(self) -> None:
        state = self._simulation.state
        on = state.on_plate
        ids = tuple(name for name, on_plate in zip(state.ids, on, strict=True) if on_plate)
        truth = Parts.make(
            ids, state.position[on], state.velocity[on], angle=state.angle[on], spin=state.spin[on]
        )
        self._truths.publish(parts_to_msg(truth, to_time(self._time_ns), Part.SIMULATED))

    def _publish_start(self) -> None:
        """Publish the cycle that the plate has begun, with its start time."""
        if self._starts.get_subscription_count():
            self._starts.publish(cycle_to_msg(self._timeline.cycle, to_time(self._time_ns)))

    def _repeat_image(self) -> None:
        """Publish the last image and the start of its cycle again. In lockstep, this is repeated
        while the motor table that results from the image is missing."""
        self._publish_start()
        self._publish_image()

    def _publish_image(self) -> None:
        """Publish the last image."""
        if self._simulated_time and self._shot is None:
            self._clocks.publish(ClockMsg(clock=self._image.header.stamp))
        self._images.publish(self._image)
        self._infos.publish(camera_to_info(self._rig.camera, self._image.header))
        if self.options.lockstep:
            self._repeat.reset()

    def _on_driver(self, msg: DriverStatus) -> None:
        self._driver = msg

    def _diagnose(self, now: float) -> Finding:
        """Return the most severe problem of the received tables, the plate and the parts (see
        `plate_core.status`)."""
        tally, dropped = self._tally, self._simulation.dropped
        findings = [used("tables", tally.tables, tally.refused, tally.why)]
        silent = self._input.timeout_finding(now)
        fine = "all parts on the plate, all cycles on time"
        if silent and self._driver is not None and self._driver.state not in PLAYING:
            silent, fine = None, f"the plate rests, driver: {self._driver.text}"
        findings.append(silent)
        troubles = [f"parts dropped: {dropped}"] if dropped else []
        if tally.late:
            troubles.append(f"late cycles: {tally.late}")
        overtravel = self._simulation.plate.overtravel_m
        if overtravel > 0:
            troubles.append(f"a motor exceeds its stroke by {1e3 * overtravel:.2g} mm")
        findings += [Finding(Level.WARN, trouble) for trouble in troubles]
        return combined(findings, fine)

    def _diagnostic_values(self) -> Mapping[str, object]:
        limits, used = self._rig.limits, self._usage
        mu = self._simulation.mu
        return {
            **self._count,
            "parts dropped": self._simulation.dropped,
            "parts over the chute": self._simulation.discharged,
            **{
                f"{label} over the chute": count
                for label, count in self._simulation.discharged_classes.items()
            },
            "stroke used": f"{used.stroke_m / limits.stroke_m:.3f}",
            "speed used": f"{used.speed / limits.speed:.3f}",
            "acceleration used": f"{used.accel / limits.accel:.3f}",
            "true friction": f"{np.min(mu, initial=np.inf):.3g} to {np.max(mu, initial=0):.3g}",
            "disturbances": self._simulation.disturbances.summary,
            "silent": f"{self._input.age(time.monotonic()):.2f} s",
        }

    def _begin_report(self) -> None:
        self._tally = Tally()


def main() -> None:
    """Run the simulator."""
    run_node(SimulatorNode, Options)
