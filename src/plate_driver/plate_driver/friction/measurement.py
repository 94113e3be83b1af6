"""Procedure that measures friction, one push at a time.

1. *Search.* The acceleration of the pushes increases until every part slides. The pushes alternate
   between +x and -x.
2. *Distance.* Stronger pushes follow, forward and back along x, then along y. The slip decreases
   with increasing mu, so each push determines the local mu of each part. A least-squares fit over
   all these pushes gives the mean mu of the part.
3. *Onset.* The acceleration of the pushes increases in small steps, from below to above the
   acceleration at which parts begin to slide. The step at which a part begins to slide determines
   its ratio of static to dynamic friction.

The inputs are detected parts. The outputs are the next push and, at the end, the friction. The
directions of the pushes alternate, so that the parts return to their places. This module uses
neither ROS nor a clock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import pairwise

import numpy as np

from plate_core import Parts, PlateError, Rig, part_class

from .push import Push, make_push, max_accel, slip

FIRST_G = 0.08
"""Acceleration of the first push [g]."""

SLOW_G = 0.01
"""Acceleration of slow motions until the first slip is known [g]. The acceleration is small,
because parts must not slide in slow motions. If parts slid in slow motions, their friction would be
overestimated."""

SEARCH_FACTOR = 1.25
"""Ratio of the accelerations of two successive pushes in the search stage."""

ONSET_FACTOR = 1.05
"""Ratio of the accelerations of two successive pushes in the onset stage."""

SLOW_FRACTION = 0.5
"""Acceleration of later slow motions, as a fraction of the maximum acceleration at which no part
has slid."""

ABOVE = 1.7
"""Acceleration of distance pushes, as a multiple of the mean mu g. At this acceleration, the
equation for the slip s in push.py is valid for parts with up to 40 % less friction. Parts whose
ratio of static to dynamic friction is at most 1.5 slide."""

MIN_ABOVE = 1.2
"""Minimum acceleration of distance pushes, as a multiple of mu g of each part."""

ONSET_FROM = 0.8
"""Acceleration of the first onset push, as a fraction of the minimum mu g."""

ONSET_TO = 2.0
"""Acceleration of the last onset push, as a multiple of the maximum mu g."""

SLID_M = 5e-4
"""Minimum slip for a first estimate of mu [m]."""

MIN_SLIP_M = 6e-5
"""Minimum slip that shows that a part has begun to slide [m]."""

NOISE_FACTOR = 5.0
"""Minimum slip that is distinguished from noise [standard errors of a displacement]."""

FLOOR_M = 1e-5
"""Minimum standard error of a displacement [m]. This minimum represents errors of the camera that
an average over images does not reduce."""

MIN_SIGNAL = 20.0
"""Minimum ratio of the slip to its standard error in distance pushes. With this ratio, the error of
mu is 5 %."""

TRAVEL_M = 0.03
"""Total displacement of parts by distance pushes, if there is enough clearance [m]. The measurement
averages the friction over this displacement, because friction varies over a few centimetres."""

MAX_STEPS = 6
"""Maximum number of distance pushes in one direction."""

STEP_CLEARANCE_M = 0.006
"""Required distance of each part from every edge, in addition to the safe distance `wall_m` of
`EdgeMargin` [m]."""

MIN_GAP_M = 0.004
"""Minimum gap between two parts at the start of the measurement [m]."""

TOUCH_M = 0.0005
"""Minimum gap between two parts during the measurement [m]."""

STILL_M = 5e-4
"""Maximum standard deviation of the position of a part at rest over several images [m]."""

STUCK_FACTOR = 3.0
"""A part that has not slid yet is excluded if the next push would accelerate the plate by more than
this multiple of the median mu g of the parts that have slid. At least half of the parts must have
slid."""

HERE_M = 0.005
"""Radius around a part [m]. Values that were measured inside this radius are used as the local
friction of the part."""

RANGE = 2.4
"""Ratio of the maximum mu to the minimum mu that one push can measure."""

CURVE = 80
"""Number of values of mu in the table of the slip. These values cover the range `RANGE` of a
push."""

AGREE = 0.05
SURE = 3.0
"""A difference of mu between types or directions is reported if it is larger than `AGREE`, as a
fraction of mu, and larger than `SURE` standard errors."""


class Stage(Enum):
    """Purpose of a push."""

    SEARCH = "search"
    DISTANCE = "distance"
    ONSET = "onset"
    DONE = "done"


@dataclass(frozen=True)
class Rest:
    """Positions of the parts while the plate rests.

    Attributes
    ----------
    position : dict of str to (2,)
        Mean centres in the images [m, plate_home].
    error : float
        Standard error of a coordinate [m]: the root mean square over the parts.
    """

    position: Mapping[str, np.ndarray]
    error: float

    @classmethod
    def of(cls, images: Sequence[Parts]) -> Rest | None:
        """Average the positions of the parts over two or more images. Return None while a part
        still moves. Parts that are not in every image are omitted."""
        ids = [name for name in images[0].ids if all(name in seen.ids for seen in images)]
        if not ids:
            return cls({}, 0.0)
        places = np.array(
            [[seen.position[seen.ids.index(name)] for name in ids] for seen in images]
        )
        deviation = np.std(places, axis=0, ddof=1)
        if np.max(deviation) > STILL_M:
            return None
        error = float(np.sqrt(np.mean(deviation**2) / len(images)))
        return cls(dict(zip(ids, places.mean(axis=0), strict=True)), error)


@dataclass(frozen=True)
class Trial:
    """A push and the slip of each part during this push.

    Attributes
    ----------
    push : Push
    stage : Stage
    lag : dict of str to float
        Slip of each part in the direction opposite to the push [m].
    position : dict of str to (2,)
        Mean of the positions of each part before and after the push [m].
    error : float
        Standard error of a value in `lag` [m].
    curve : (2, n)
        Values of mu in ascending order, and the slip for each value [m].
    """

    push: Push
    stage: Stage
    lag: Mapping[str, float]
    position: Mapping[str, np.ndarray]
    error: float
    curve: np.ndarray

    def lag_at(self, mu: float) -> float:
        """Return the slip of a part with this mu [m]."""
        return float(np.interp(mu, *self.curve))

    def local(self, name: str) -> tuple[float, float]:
        """Return mu of a part, computed from this push only, and its standard error."""
        grid, lags = self.curve
        mu = np.interp(self.lag[name], lags[::-1], grid[::-1])
        slope = np.interp(mu, grid, np.gradient(lags, grid))
        return float(mu), float(self.error / max(abs(slope), 1e-9))


@dataclass(frozen=True)
class PartFriction:
    """Friction of one part.

    Attributes
    ----------
    id : str
    position : (2,)
        Position of the part [m, plate_home].
    mu, error : float
        Mean coefficient of dynamic friction along the part's path, and its standard error.
    static_ratio : float
        Ratio of static to dynamic friction. NaN if the measurement did not observe the start of
        sliding.
    """

    id: str
    position: np.ndarray
    mu: float
    error: float
    static_ratio: float


@dataclass(frozen=True)
class FrictionResult:
    """Friction of all parts.

    Attributes
    ----------
    parts : tuple of PartFriction
    mu, error : float
        Mean mu over the parts, and its standard error.
    between_parts, over_plate : float
        Standard deviation of mu between the parts, and standard deviation along one part's path on
        the plate. Both values are fractions of the mean mu. The contribution of the camera's noise
        is subtracted.
    static_ratio, static_error : float
        Mean ratio of static to dynamic friction over the parts, and its standard error. Both values
        are NaN if no part was observed to begin sliding.
    notes : tuple of str
        Further remarks for the user.
    """

    parts: tuple[PartFriction, ...]
    mu: float
    error: float
    between_parts: float
    over_plate: float
    static_ratio: float
    static_error: float
    notes: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Result in one line."""
        ratio = "not measured"
        if np.isfinite(self.static_ratio):
            ratio = f"{self.static_ratio:.2f} +- {self.static_error:.2f}"
        return (
            f"mu {self.mu:.4f} +- {self.error:.4f} ({len(self.parts)} parts), standard deviation "
            f"between parts {100 * self.between_parts:.1f} %, over the plate "
            f"{100 * self.over_plate:.1f} %, static over dynamic friction {ratio}"
        )


@dataclass(frozen=True)
class FrictionMeasurement:
    """A running measurement.

    Attributes
    ----------
    rig : Rig
    max_accel : float
        Maximum acceleration of a push on this rig [m/s2].
    stage : Stage
    todo : tuple of Push
        Remaining pushes of the stage, in the order in which they will be executed.
    rest : Rest
        Current places of the parts.
    trials : tuple of Trial
    slow : float
        Acceleration of slow motions [m/s2].
    guess : dict of str to float
        First estimates of mu.
    notes : tuple of str
    """

    rig: Rig
    max_accel: float
    stage: Stage
    todo: tuple[Push, ...]
    rest: Rest
    trials: tuple[Trial, ...] = ()
    slow: float = 0.0
    guess: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @classmethod
    def start(cls, rig: Rig, rest: Rest, corrected: bool = False) -> FrictionMeasurement:
        """Start a measurement.

        Parameters
        ----------
        rig : Rig
        rest : Rest
        corrected : bool
            Whether a calibration corrects the commands of the plate.

        Raises
        ------
        PlateError
            If no part is detected, a part is too near an edge, two parts are too near each other,
            or the rig's limits do not allow the first push.
        """
        if not rest.position:
            raise PlateError("friction: no part is detected, allowed: one or more parts at rest")
        names = list(rest.position)
        for name in names:
            margin = float(np.min(rig.plate.half - np.abs(rest.position[name])))
            min_margin = rig.edge_margin(part_class(name)).wall_m + STEP_CLEARANCE_M
            if margin < min_margin:
                raise PlateError(
                    f"friction: {name} is {1e3 * margin:.0f} mm from an edge, allowed: "
                    f"{1e3 * min_margin:.0f} mm or more"
                )
        _check_gaps(rig, rest, MIN_GAP_M)
        slow = SLOW_G * rig.friction.gravity
        notes: tuple[str, ...] = ()
        if rig.suspension is not None and not corrected:
            notes = (
                "the rig has flexures but no calibration, so mu may be wrong: call calibrate first",
            )
        first = make_push(rig, 0, 1, FIRST_G * rig.friction.gravity, slow)
        reach = max_accel(rig, slow)
        if first.accel > reach:
            raise PlateError(
                f"friction: the rig's limits allow pushes of up to {reach:.2g} m/s2, required: "
                f"{first.accel:.2g} m/s2"
            )
        return cls(rig, reach, Stage.SEARCH, (first,), rest, slow=slow, notes=notes)

    @property
    def push(self) -> Push | None:
        """The next push. None at the end of the measurement."""
        return self.todo[0] if self.todo else None

    @property
    def progress(self) -> str:
        """Progress as text."""
        if self.push is None:
            return "done"
        axis = "xy"[self.push.axis]
        return (
            f"{self.stage.value}: push {len(self.trials) + 1}, along {axis}, "
            f"{self.push.accel:.2f} m/s2"
        )

    @property
    def fraction(self) -> float:
        """Approximate progress of the measurement, 0 to 1."""
        stages = {Stage.SEARCH: 0.0, Stage.DISTANCE: 0.25, Stage.ONSET: 0.6, Stage.DONE: 1.0}
        done = sum(trial.stage is self.stage for trial in self.trials)
        weights = {Stage.SEARCH: 0.25, Stage.DISTANCE: 0.35, Stage.ONSET: 0.4, Stage.DONE: 0.0}
        expected = 10 if self.stage is Stage.SEARCH else max(1, done + len(self.todo))
        return stages[self.stage] + weights[self.stage] * min(1.0, done / expected)

    def after(self, rest: Rest, played: Push | None = None) -> FrictionMeasurement:
        """Return the measurement after its current push.

        Parameters
        ----------
        rest : Rest
            Current places of the parts.
        played : Push, optional
            Commanded push, if `push` was scaled down to the rig's limits. Default: `push`.

        Raises
        ------
        PlateError
            If too many parts are lost, or if parts move in the wrong direction, come too near to
            each other, or do not slide.
        """
        assert self.push is not None
        push = played or self.push
        along = np.eye(2)[push.axis] * push.sign
        ids = [name for name in self.rest.position if name in rest.position]
        if 2 * len(ids) < len(self.rest.position) or not ids:
            raise PlateError(
                f"friction: {len(ids)} of {len(self.rest.position)} parts are detected after the "
                "push, allowed: half of them or more"
            )
        lost = sorted(set(self.rest.position) - set(ids))
        notes = self.notes + tuple(
            f"{name} is excluded, because it is no longer detected" for name in lost
        )
        lag = {
            name: float(-along @ (rest.position[name] - self.rest.position[name])) for name in ids
        }
        position = {name: (rest.position[name] + self.rest.position[name]) / 2 for name in ids}
        error = float(np.hypot(np.hypot(rest.error, self.rest.error), FLOOR_M))
        for name, value in lag.items():
            if value < -max(SLID_M, NOISE_FACTOR * error):
                raise PlateError(
                    f"friction: {name} moved {-1e3 * value:.2f} mm in the direction of the push, "
                    "allowed: against it; check the motors' directions and the order of corners_px "
                    "in the rig file"
                )
        rest = replace(rest, position={name: rest.position[name] for name in ids})
        _check_gaps(self.rig, rest, TOUCH_M)
        curves = [t.curve for t in self.trials if t.push.accel == push.accel]
        curve = curves[0] if curves else _slip_curve(push, self.rig.friction.gravity)
        trial = Trial(push, self.stage, lag, position, error, curve)
        if self.stage is Stage.DISTANCE:
            _check_slips(trial, self.rig.friction.gravity)
        trials = (*self.trials, trial)
        new = replace(self, rest=rest, trials=trials, todo=self.todo[1:], notes=notes)
        if self.stage is Stage.SEARCH:
            return new._after_search_push()
        if self.stage is Stage.ONSET and all(new._find_onset_trials(name)[1] for name in ids):
            return replace(new, stage=Stage.DONE, todo=())
        if not new.todo:
            return (
                new._plan_onset_pushes()
                if self.stage is Stage.DISTANCE
                else replace(new, stage=Stage.DONE)
            )
        return new

    # Stages

    def _after_search_push(self) -> FrictionMeasurement:
        """Return the measurement after a search push. The next push is another search push, or the
        first push of the next stage."""
        trial, gravity = self.trials[-1], self.rig.friction.gravity
        guess = dict(self.guess)
        for name, value in trial.lag.items():
            # At accelerations far above mu g, the slip depends only a little on mu. Pushes with
            # such accelerations give no estimate of mu.
            known = guess.get(name, np.inf) * gravity
            slid = value > max(SLID_M, NOISE_FACTOR * trial.error)
            if slid and trial.push.accel < ABOVE * known:
                _check_slip(trial, name, gravity)
                guess[name] = trial.local(name)[0]
        new = replace(self, guess=guess)
        if not guess:
            new = replace(new, slow=max(self.slow, SLOW_FRACTION * trial.push.accel))
        unknown = sorted(set(self.rest.position) - set(guess))
        accel = trial.push.accel * SEARCH_FACTOR
        if 0 < len(unknown) <= len(guess):
            typical = float(np.median(list(guess.values()))) * gravity
            if accel > STUCK_FACTOR * typical:
                notes = tuple(
                    f"{name} is excluded, because it does not slide at {trial.push.accel:.1f} "
                    "m/s2, but other parts do"
                    for name in unknown
                )
                position = {name: new.rest.position[name] for name in guess}
                new = replace(
                    new, notes=new.notes + notes, rest=replace(new.rest, position=position)
                )
                unknown = []
        if not unknown:
            return new._plan_distance_pushes()
        if accel > self.max_accel:
            raise PlateError(
                f"friction: {', '.join(unknown)} did not slide at {trial.push.accel:.1f} m/s2, and "
                f"the rig's limits allow only {self.max_accel:.1f} m/s2. Either mu is above "
                f"{trial.push.accel / gravity:.2f}, or the plate does not move"
            )
        push = make_push(self.rig, 0, -trial.push.sign, accel, new.slow)
        return replace(new, todo=(push,))

    def _plan_distance_pushes(self) -> FrictionMeasurement:
        """Return the measurement with the distance pushes."""
        gravity = self.rig.friction.gravity
        typical = float(np.median(list(self.guess.values())))
        accel = min(ABOVE * typical * gravity, self.max_accel)
        grip = {name: self.guess[name] * gravity for name in self.rest.position}
        kept = [name for name in grip if accel / RANGE < grip[name] < accel / MIN_ABOVE]
        if not kept:
            raise PlateError(
                f"friction: mu is about {typical:.2f}, but the rig's limits allow only pushes of "
                f"up to {accel:.1f} m/s2, required: {MIN_ABOVE * typical * gravity:.1f} m/s2"
            )
        notes = tuple(
            f"{name} is excluded, because its mu is about {self.guess[name]:.2f}, but that of the "
            f"other parts is about {typical:.2f}; measure it separately"
            for name in sorted(set(grip) - set(kept))
        )
        rest = replace(self.rest, position={name: self.rest.position[name] for name in kept})
        mu = np.array([self.guess[name] for name in kept])
        todo: list[Push] = []
        for axis in (0, 1):
            forward = make_push(self.rig, axis, 1, accel, self.slow)
            step = float(np.max(slip(forward, mu, 0.0, gravity)))
            # Parts slip in the direction opposite to the push. Therefore use the clearance in this
            # direction.
            free = {sign: self._min_wall_distance(axis, -sign) for sign in (1, -1)}
            sign = max(free, key=lambda one: free[one])
            count = int(np.clip(min(free[sign], TRAVEL_M) / max(step, 1e-6), 1, MAX_STEPS))
            back = make_push(self.rig, axis, -sign, accel, self.slow)
            todo += count * [replace(forward, sign=sign, cycle=forward.cycle.scaled(sign))]
            todo += count * [back]
        weakest = float(np.min(slip(todo[0], mu, 0.0, gravity)))
        error = self.trials[-1].error
        if weakest < MIN_SIGNAL * error:
            raise PlateError(
                f"friction: parts slide {1e3 * weakest:.2f} mm, and the camera's noise is "
                f"{1e3 * error:.2f} mm, allowed: slip of at least {MIN_SIGNAL:g} times the noise"
            )
        return replace(
            self, stage=Stage.DISTANCE, todo=tuple(todo), rest=rest, notes=self.notes + notes
        )

    def _min_wall_distance(self, axis: int, sign: int) -> float:
        """Return the minimum distance of the parts from the wall along an axis [m]."""
        return min(
            float(
                self.rig.plate.half[axis]
                - self.rig.edge_margin(part_class(name)).wall_m
                - sign * position[axis]
            )
            for name, position in self.rest.position.items()
        )

    def _plan_onset_pushes(self) -> FrictionMeasurement:
        """Return the measurement with the onset pushes."""
        gravity = self.rig.friction.gravity
        mu = [self._fit_dynamic_friction(name)[0] for name in self.rest.position]
        accel, last = ONSET_FROM * min(mu) * gravity, ONSET_TO * max(mu) * gravity
        todo: list[Push] = []
        while accel < min(last, self.max_accel):
            todo.append(make_push(self.rig, 0, 1 - 2 * (len(todo) % 2), accel, self.slow))
            accel *= ONSET_FACTOR
        stage = Stage.ONSET if todo else Stage.DONE
        return replace(self, stage=stage, todo=tuple(todo))

    # Evaluation of pushes

    def _trials_of(self, name: str, stage: Stage) -> list[Trial]:
        return [t for t in self.trials if t.stage is stage and name in t.lag]

    def _local_friction(self, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return mu of a part in each distance push (n,), its standard errors (n,), and the
        distances (n,) between the part's place in each push and its current place [m]."""
        trials, rest_position = self._trials_of(name, Stage.DISTANCE), self.rest.position[name]
        values, errors = np.array([trial.local(name) for trial in trials]).T
        return (
            values,
            errors,
            np.array([np.hypot(*(t.position[name] - rest_position)) for t in trials]),
        )

    def _fit_dynamic_friction(self, name: str) -> tuple[float, float]:
        """Return mu of a part by least squares over its distance pushes, and its standard error."""
        # SciPy is imported here, because an import at the top would double the start time of the
        # driver.
        from scipy.optimize import least_squares

        trials = self._trials_of(name, Stage.DISTANCE)

        def lag_errors(mu: np.ndarray) -> np.ndarray:
            return np.array([(t.lag_at(mu[0]) - t.lag[name]) / t.error for t in trials])

        local, errors, _ = self._local_friction(name)
        fit = least_squares(lag_errors, [float(np.median(local))], diff_step=1e-3)
        # The measured position between two pushes affects the lags of both pushes. Therefore the
        # errors of both lags are correlated. The errors have opposite signs if both pushes have the
        # same direction, and equal signs otherwise.
        correlation = np.eye(len(trials))
        for k, (first, second) in enumerate(pairwise(trials)):
            if first.push.axis == second.push.axis:
                shared = -0.5 * first.push.sign * second.push.sign
                correlation[k, k + 1] = correlation[k + 1, k] = shared
        # derivatives of the lags with respect to mu, divided by the standard errors of the lags
        slopes = fit.jac[:, 0]
        noise = slopes @ correlation @ slopes / (slopes @ slopes) ** 2
        uneven = max(0.0, float(np.var(local, ddof=1) - np.mean(errors**2))) / len(trials)
        return float(fit.x[0]), float(np.sqrt(noise + uneven))

    def _find_onset_trials(self, name: str) -> tuple[Trial | None, Trial | None]:
        """Return the last onset push in which a part did not slide, and the first onset push in
        which it slid. If there is no such push, the value is None."""
        held = None
        for trial in self._trials_of(name, Stage.ONSET):
            if trial.lag[name] > _min_visible_slip(trial):
                return held, trial
            held = trial
        return held, None

    def _estimate_static_ratio(self, name: str) -> float:
        """Return the ratio of static to dynamic friction of a part. The result is NaN if the start
        of sliding was not observed. If a part did not slide in a push, mu_s g of the part exceeds
        the push's acceleration. This conclusion is used only if the part would have slid visibly
        with mu_s = mu.
        """
        held, slid = self._find_onset_trials(name)
        if slid is None:
            return np.nan
        local, _, distance = self._local_friction(name)
        along = [
            trial.push.axis == slid.push.axis for trial in self._trials_of(name, Stage.DISTANCE)
        ]
        # Use only pushes along the same axis, because friction may differ along x and y.
        local, distance = local[along], distance[along]
        mu = float(np.mean(local[distance <= np.min(distance) + HERE_M]))
        lower = grip = mu * self.rig.friction.gravity
        if held is not None and held.lag_at(mu) > _min_visible_slip(held):
            lower = max(lower, held.push.accel)
        return max(1.0, float(np.sqrt(lower * max(slid.push.accel, grip))) / grip)

    @property
    def result(self) -> FrictionResult:
        """Result of the measurement. The result is available at the end of the measurement."""
        parts, along, weights = [], [], []
        for name in self.rest.position:
            mu, error = self._fit_dynamic_friction(name)
            local, errors, _ = self._local_friction(name)
            along.append(float(np.var(local, ddof=1) - np.mean(errors**2)) / mu**2)
            weights.append(len(local) - 1)
            ratio = self._estimate_static_ratio(name)
            parts.append(PartFriction(name, self.rest.position[name], mu, error, ratio))
        values = np.array([part.mu for part in parts])
        errors = np.array([part.error for part in parts])
        mean, count = float(np.mean(values)), len(parts)
        between = (float(np.var(values, ddof=1)) if count > 1 else 0.0) - float(np.mean(errors**2))
        spread = float(np.std(values, ddof=1)) if count > 1 else 0.0
        error = float(np.hypot(spread, np.sqrt(np.mean(errors**2)) * (count == 1)) / np.sqrt(count))
        ratios = np.array([part.static_ratio for part in parts])
        ratios = ratios[np.isfinite(ratios)]
        static = float(np.mean(ratios)) if len(ratios) else np.nan
        width = np.log(ONSET_FACTOR) / np.sqrt(12)
        deviation = float(np.std(ratios, ddof=1)) if len(ratios) > 1 else 0.0
        static_error = float(np.hypot(width, deviation / np.sqrt(max(1, len(ratios)))))
        notes = self.notes + self._type_note(parts) + self._axis_note()
        if len(ratios) and ratios.size < count:
            notes += (f"static friction was measured for {len(ratios)} of {count} parts",)
        return FrictionResult(
            tuple(parts), mean, error, float(np.sqrt(max(0.0, between)) / mean),
            float(np.sqrt(max(0.0, np.average(along, weights=weights)))), static,
            static_error if len(ratios) else np.nan, notes,
        )  # fmt: skip

    def _type_note(self, parts: Sequence[PartFriction]) -> tuple[str, ...]:
        """Return a note if mu differs between types."""
        kinds: dict[str, list[float]] = {}
        for part in parts:
            kinds.setdefault(part_class(part.id), []).append(part.mu)
        means = {kind: float(np.mean(values)) for kind, values in kinds.items()}
        low, high = (pick(means, key=lambda kind: means[kind]) for pick in (min, max))
        errors = [
            np.var(kinds[kind], ddof=1) / len(kinds[kind])
            for kind in (low, high)
            if len(kinds[kind]) > 1
        ]
        apart = means[high] - means[low]
        if len(errors) < 2 or apart < max(AGREE * means[low], SURE * float(np.sqrt(sum(errors)))):
            return ()
        listed = ", ".join(f"{kind} {mu:.3f}" for kind, mu in sorted(means.items()))
        return (f"mu differs between types: {listed}",)

    def _axis_note(self) -> tuple[str, ...]:
        """Return a note if mu differs between x and y."""
        pairs = []
        for name in self.rest.position:
            axis = np.array([trial.push.axis for trial in self._trials_of(name, Stage.DISTANCE)])
            local, _, _ = self._local_friction(name)
            pairs.append([np.mean(local[axis == k]) for k in (0, 1)])
        x, y = np.mean(pairs, axis=0)
        apart = np.diff(pairs)[:, 0]
        error = float(np.std(apart, ddof=1)) / np.sqrt(len(apart)) if len(apart) > 1 else np.inf
        if abs(y - x) < max(AGREE * min(x, y), SURE * error):
            return ()
        return (
            f"mu is {x:.3f} along x and {y:.3f} along y, but the rig file has one value for both",
        )


def rig_mu(rig: Rig, result: FrictionResult) -> float:
    """Return the mu for the rig file: the mean over the parts whose types have no separate mu in
    this file.

    Raises
    ------
    PlateError
        If the types of all parts have a separate mu.
    """
    values = [
        part.mu
        for part in result.parts
        if (kind := rig.types.get(part_class(part.id))) is None or kind.mu is None
    ]
    if not values:
        raise PlateError(
            "friction: the types of all parts have a separate mu, allowed: one or more parts whose "
            f"type has none; otherwise change mu of the types by hand: {result.text}"
        )
    return float(np.mean(values))


def _min_visible_slip(trial: Trial) -> float:
    """Return the minimum measured slip [m] that shows that a part has slid."""
    return max(MIN_SLIP_M, NOISE_FACTOR * trial.error)


def _check_slip(trial: Trial, name: str, gravity: float) -> None:
    """Raise an error if a slip exceeds the maximum of the push's curve, because such a slip does
    not determine mu."""
    max_slip = float(np.max(trial.curve[1]))
    if trial.lag[name] > max_slip + NOISE_FACTOR * trial.error:
        accel = trial.push.accel
        raise PlateError(
            f"friction: {name} slid {1e3 * trial.lag[name]:.1f} mm at {accel:.2f} m/s2, allowed: "
            f"up to {1e3 * max_slip:.1f} mm. Either mu is below {accel / RANGE / gravity:.2g}, or "
            "static friction is about twice the dynamic friction or more"
        )


def _check_slips(trial: Trial, gravity: float) -> None:
    """Raise an error if the slips of a distance push do not determine mu."""
    for name, lag in trial.lag.items():
        _check_slip(trial, name, gravity)
        if lag <= NOISE_FACTOR * trial.error:
            raise PlateError(
                f"friction: {name} does not slide at {trial.push.accel:.2f} m/s2, allowed: parts "
                f"that slide. Its static friction may be above {ABOVE:g} times the dynamic "
                "friction, or it sticks. Clean the plate and the part, or remove the part"
            )


def _slip_curve(push: Push, gravity: float) -> np.ndarray:
    """Return an array (2, n) with values of mu in ascending order, and the slip in a push for each
    value [m]."""
    grid = push.accel / gravity * np.geomspace(1 / RANGE, 1, CURVE)
    return np.stack([grid, slip(push, grid, 0.0, gravity)])


def _check_gaps(rig: Rig, rest: Rest, min_gap: float) -> None:
    """Raise an error if the gap between two parts is less than `min_gap` [m]."""
    names = list(rest.position)
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            reach = sum(rig.part_type(part_class(name)).reach_m for name in (one, other))
            gap = float(np.hypot(*(rest.position[one] - rest.position[other]))) - reach
            if gap < min_gap:
                raise PlateError(
                    f"friction: {one} and {other} are {max(0.0, 1e3 * gap):.1f} mm apart, allowed: "
                    f"{1e3 * min_gap:g} mm or more"
                )
