"""One PD step per cycle, with a disturbance observer, for parts that follow a path.

The answer to image k acts during cycle k+1. So the controller looks at the error where the part
will be when its answer begins to act, and asks for the mean drift over that cycle:

    v_des = (x_ref(t + 2T) - x_ref(t + T))/T + kp (x_ref(t + T) - x_pred)/T - d

kp = 1 corrects the whole predicted error in one cycle. The solver brings a part from the drift it
has to the one it should have: that is the D of PD, with a gain of 1. What parts are known to do
otherwise than foretold, the disturbance d, is part of the prediction, and taken away.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FollowOptions:
    """Gains and bounds of the path controller.

    Attributes
    ----------
    kp : float
        Share of the predicted position error to correct in one cycle [-].
    observer_gain : float
        Share of a cycle's surprise that is expected of the next one [-].
    disturbance_max : float
        Greatest disturbance along and across the path, in multiples of the path's speed [-].
    slow_from, slow_to : float
        Errors at which the references begin to slow down, and stand still [max_error_m].
    speed_ratio_max : float
        Greatest drift to ask for, in multiples of the path's speed [-].
    force_share_max : float
        Greatest component of the force to ask for [mu m g].
    settle_s : float
        A part may be further off than the scenario allows for this long after the start [s].
    """

    kp: float = 0.8
    observer_gain: float = 0.7
    disturbance_max: float = 1.0
    slow_from: float = 0.15
    slow_to: float = 0.5
    speed_ratio_max: float = 3.0
    force_share_max: float = 1.0
    settle_s: float = 3.0


def pd_drift(
    predicted: np.ndarray,
    reference: np.ndarray,
    reference_after: np.ndarray,
    period: float,
    kp: float,
    disturbance: np.ndarray,
    speed_max: np.ndarray,
) -> np.ndarray:
    """Drift wanted over the cycle in which the answer acts.

    Parameters
    ----------
    predicted : (M, 2)
        Positions when the cycle begins [m, plate_home].
    reference, reference_after : (M, 2)
        Where the parts should be when it begins, and when it ends [m, plate_home].
    period : float
        Length of a cycle [s].
    kp : float
        Share of the error to correct [-].
    disturbance : (M, 2)
        Drift that they have anyway [m/s, plate_home].
    speed_max : (M,)
        Bound of the result's magnitude [m/s].

    Returns
    -------
    (M, 2)
        Drift [m/s, plate_home].
    """
    wanted = (reference_after - reference + kp * (reference - predicted)) / period - disturbance
    magnitude = np.hypot(*wanted.T)
    return wanted * np.minimum(1, speed_max / np.maximum(magnitude, 1e-12))[:, None]
