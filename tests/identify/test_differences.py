"""What one recording has otherwise than those fitted beside it, planted in the plant."""

import numpy as np
import pytest
from planted import Runs, hidden

from excitant.identify import Recording, identify_robot, publication
from excitant.robots import Robot

BODY = {"m": 1.5, "mcx": 0.3, "Iyy": 0.07, "Izz": 0.07, "Ixx": 0.01}
BODY |= dict.fromkeys(("mcy", "mcz", "Ixy", "Ixz", "Iyz"), 0.0)
PLANTED = {
    "payload": (hidden("payload", "joint2", **BODY), 1.5),
    "coulomb_friction": (hidden("coulomb_friction", "joint1", Fc=3.0), 3.0),
    "encoder_offset": (hidden("encoder_offset", "joint2", offset=2.8), 2.8),
}


@pytest.fixture(scope="module")
def plain(planar: Robot, runs: Runs) -> list[Recording]:
    return runs(planar, 3, names=("one", "two", "three"))


@pytest.mark.parametrize("kind", PLANTED)
def test_what_the_hold_out_has_otherwise_is_named(
    planar: Robot, plain: list[Recording], runs: Runs, kind: str
) -> None:
    planted, size = PLANTED[kind]
    [held] = runs(planar, 4, hidden=[planted], names=["held"])
    estimate = identify_robot(planar, plain[0], validate=held)
    [found] = estimate.differences
    assert (found.recording, found.effect.name, found.rivals) == ("held", kind, ())
    [told] = found.sizes(planar)
    # a reading too large by an offset is corrected by its negative
    assert abs(abs(told.value) - size) < 5 * told.std + 0.01 * size
    assert found.sentence(planar) in estimate.result()["notes"]
    # which zero position is right, nothing says
    assert publication(estimate, formats=()).published == (kind != "encoder_offset")


def test_a_recording_among_several_is_told_from_the_others(
    planar: Robot, plain: list[Recording], runs: Runs
) -> None:
    planted, size = PLANTED["coulomb_friction"]
    [other] = runs(planar, 4, hidden=[planted], names=["other"])
    [found] = identify_robot(planar, [*plain[:2], other], validate=plain[2]).differences
    assert (found.recording, found.effect.joints) == ("other", ("joint1",))
    assert found.effect.coefficients[0] == pytest.approx(size, rel=0.05)


def test_what_all_recordings_have_is_no_difference(planar: Robot, runs: Runs) -> None:
    """A spring that no usual effect explains spoils both alike."""
    both = runs(
        planar, 5, hidden=[hidden("spring", "joint1", stiffness=40.0, moment=0.0, rest=0.3)]
    )
    estimate = identify_robot(planar, both[0], validate=both[1])
    assert np.nanmax(estimate.validate.nrmse) > 0.05
    assert estimate.differences == ()
