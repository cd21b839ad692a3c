"""What forbids to publish a model: a joint that is not explained, friction that no drive has."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from marks import refused
from plant_recordings import PENDULUM

from excitant.exceptions import BadRecording
from excitant.identify import Estimate, Recording, identify_robot, load_dataset, publication, split
from excitant.identify.export import hold_out
from excitant.identify.objections import MISSED, HoldOut, objections
from excitant.identify.tables import of_bodies
from excitant.robots import Robot, load_robot

TIME = np.arange(0, 12, 1 / 100)
Exact = Callable[..., Recording]


@pytest.fixture(scope="module")
def estimate(planar: Robot, exact: Exact) -> Estimate:
    return identify_robot(planar, [exact(planar, TIME)], validate=[exact(planar, TIME, 1)])


def with_error(judged: HoldOut, joint: int, share: float) -> HoldOut:
    """The hold-out with an error of some share of a joint's variation, without mean."""
    rows = judged.series
    wave = np.sin(7.1 * rows.t)
    wave = (wave - wave.mean()) / wave.std()
    predicted = np.array(rows.measured)
    predicted[:, joint] += share * rows.std[joint] * wave
    return replace(judged, predicted=predicted, nominal=predicted)


@pytest.mark.parametrize("joint", [0, 1])
def test_a_joint_that_is_not_explained_forbids_it(estimate: Estimate, joint: int) -> None:
    judged, model = hold_out(estimate), estimate.model
    assert objections(model, with_error(judged, joint, MISSED - 0.05)) == []
    [missed] = objections(model, with_error(judged, joint, MISSED + 0.05))
    assert f"% of the torque of {model.joints[joint]}" in missed.why
    assert "worse than no model" in objections(model, with_error(judged, joint, 1.5))[0].why


def test_friction_beyond_the_effort_limit_forbids_it_and_so_does_no_judgement(estimate: Estimate):
    model, judged = estimate.model, with_error(hold_out(estimate), 0, 0.1)
    weak = replace(model.limits, torque=np.array([np.inf, 1e-6]))
    [strained] = objections(model.with_limits(weak), judged)
    assert model.joints[1] in strained.why
    assert model.joints[0] not in strained.why
    assert objections(model.with_limits(replace(weak, torque=np.zeros(2))), judged) == []
    judged = with_error(hold_out(estimate), 0, 0.1)
    still = replace(judged.series, moves=np.zeros_like(judged.series.moves))
    [unjudged] = objections(estimate.model, replace(judged, series=still))
    assert "nothing judges the model" in unjudged.why


def test_masses_that_no_description_misses_so_far_forbid_it(data_folder: Path) -> None:
    """Six short motions of a real arm show springs that it has not, and weightless links."""
    arm = load_dataset(data_folder / "lwa4p")
    fit, held = (arm.recordings(names) for names in (["rec01", "rec02", "rec05"], ["rec06"]))
    found = identify_robot(arm.robot, fit, validate=held)
    light = [k for k, mass in enumerate(found.phi[::10]) if mass < arm.robot.phi[10 * k] / 5][:-1]
    note = publication(found).note
    assert light
    assert all(f"{arm.robot.links[k]} has " in note for k in light)
    assert "which the data do not tell alone" in note
    assert publication(found, force=True).published
    # of links of which nothing is said none is too far off
    bare = replace(found, given=arm.robot.with_parameters(np.tile(arm.robot.phi[:10], 6)))
    assert not of_bodies(bare)


@pytest.mark.parametrize(("masses", "asked"), [((0.1, 0.1), True), ((0.1, 9.0), False)])
def test_bodies_that_are_all_too_light_ask_for_the_unit(
    masses: tuple[float, ...], asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = load_robot("puma560")
    told = [{"given": 1.0, "value": mass, "decided_by": "prior"} for mass in (*masses, 0.1, 0.1)]
    changes = [{"link": f"{k}", "moved": "far", "mass": mass} for k, mass in enumerate(told)]
    monkeypatch.setattr("excitant.identify.tables.body_changes", lambda estimate: changes)
    [objection] = of_bodies(SimpleNamespace(given=robot))
    assert ("torque is that of motors" in objection.advice) == asked


@pytest.mark.parametrize(
    "seen", [slice(None), slice(300, 700), slice(900, None), slice(1, None, 3)]
)
def test_a_hold_out_that_was_fitted_is_refused(planar: Robot, exact: Exact, seen: slice) -> None:
    """A copy with other times, a part, or one that leaves rows out, of either."""
    run = exact(planar, TIME)
    copy = run.take(np.arange(len(run))[seen])
    copy = replace(copy, name="copy", file="copy.csv", t=copy.t + 100.0)
    with pytest.raises(BadRecording, match=r"copy.csv: .* must be unseen"):
        split([exact(planar, TIME, 2), run], [copy])
    refused("must be unseen", split, [copy], [run], error=BadRecording)


def test_overlap_is_found_within_and_rests_are_none(planar: Robot, exact: Exact) -> None:
    one, other = exact(planar, TIME), exact(planar, TIME, 1)
    joined = {name: np.concatenate([x[:500], getattr(one, name)[200:400]])
              for name, x in other.channels()}  # fmt: skip
    mixed = replace(other, t=0.01 * np.arange(700), **joined)
    refused("200 of its 700 rows", split, [one], [mixed], error=BadRecording)
    parked = [
        replace(run, **{name: np.concatenate([x, np.full((100, x.shape[1]), 0.3)])
                        for name, x in run.channels()},
                t=0.01 * np.arange(len(run) + 100))
        for run in (one, other)
    ]  # fmt: skip
    assert split(parked[:1], parked[1:]).validate


def test_coarse_readings_that_repeat_are_no_copy(exact: Exact) -> None:
    """A servo of 4096 ticks a turn and 20 steps of torque, the same motion twice."""
    rng = np.random.default_rng(0)

    def read(run: Recording) -> Recording:
        q = run.q + 2e-4 * rng.standard_normal(run.q.shape)
        tau = run.tau + 0.02 * np.ptp(run.tau) * rng.standard_normal(run.tau.shape)
        tick, step = 2 * np.pi / 4096, np.ptp(run.tau) / 20
        return replace(run, q=tick * np.round(q / tick), tau=step * np.round(tau / step), dq=None)

    runs = [read(exact(PENDULUM, np.arange(0, 60, 0.01))) for _ in range(2)]
    assert split(runs[:1], runs[1:]).validate
