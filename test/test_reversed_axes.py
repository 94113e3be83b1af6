"""Images that are mirrored or rotated, in a closed loop without markers."""

import numpy as np
import pytest

from plate_bringup.loop import Setup, SimulatedScene, run
from plate_core import Parts, load_rig


class Reversed(SimulatedScene):
    """The parts as a camera shows them whose axes have the signs (2,)."""

    signs = np.ones(2)

    def see(self, image, stamp, expected):
        seen = super().see(image, stamp, None)
        position, drift = self.signs * seen.position, self.signs * seen.velocity
        return Parts.make(seen.ids, position, drift, seen.angle, seen.spin)


@pytest.mark.parametrize("signs", [(-1, 1), (1, -1), (-1, -1)])
def test_reversed_axes_are_the_reason_of_a_lost_part(signs):
    setup = Setup("sort_4", seed=1)
    rig = load_rig(setup.recipe.rig)
    scene = Reversed(setup, setup.recipe, rig)
    scene.signs = np.array(signs)
    *_, last = run(setup, rig, scene=scene)
    assert last.progress.phase == "lost part"
    assert "the image is mirrored or rotated" in last.progress.text
