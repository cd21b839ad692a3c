"""The experiment that settles an undecided diagnosis: how far it separates, and its limits."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from diagnosis import Asked
from diagnosis import run as run_case
from marks import slow
from planted import Diagnosed, drawn

from excitant.analysis.diagnosis import Diagnosis
from excitant.analysis.diagnosis_result import Advice, key
from excitant.analysis.discrimination import Contest, Pair, Separation, along, needed
from excitant.analysis.discrimination_plan import described, discriminating_motions, plan
from excitant.analysis.thresholds import DISCRIMINATION, EVIDENCE
from excitant.design import Trajectory, check
from excitant.robots import Motion, Robot
from excitant.robots import effects as kinds
from excitant.robots.effects import EFFECTS, Effect, separating_experiment
from excitant.robots.effects.body import GivenInertias
from excitant.robots.effects.experiments import GENERAL

SIGMA, INFLATION = 0.05, 2.0
LAST = ("joint2",)  # of the planar arm
LINK = (0.3, 0.1, 0.0, 0.0, 0.03, 0.0, 0.03, 0.0, 0.0, 0.03)


def contest(
    robot: Robot, found: Effect, rival: Effect, *recorded: Motion, tolerance: float = 0.05
) -> Contest:
    weight, pairs = np.full(robot.nv, 1 / (SIGMA**2 * INFLATION)), (Pair(found, rival),)
    known = tuple(along(motion, 10.0) for motion in recorded)
    return Contest(robot, robot, pairs, weight, recorded=known, tolerance=(tolerance,) * 2)


def separation(contest: Contest, motion: Motion) -> Separation:
    [found] = contest.separations(contest.information(motion))
    return found


def swing(robot: Robot, amplitude: float = 0.5, hz: float = 0.25, seconds: float = 20.2) -> Motion:
    """Every joint on a sine at 100 Hz; the edges that preparing cuts off make whole periods."""
    t, w = np.arange(0, seconds, 0.01), 2 * np.pi * hz
    wave = amplitude * np.exp(1j * w * (t - 0.1))[:, None] * np.ones(robot.nv)
    return Motion(t, *(((1j * w) ** k * wave).imag for k in range(3)))


@pytest.mark.parametrize(
    ("kind", "cosine", "rel"),
    [(kinds.TorqueOffset, 0.0, 1e-3), (kinds.CoulombFriction, np.sqrt(8) / np.pi, 0.08)],
)
def test_a_cause_separates_by_what_its_rival_does_not_follow(planar, kind, cosine, rel):
    """⟨sign q̇, q̇⟩² / (‖sign q̇‖² ‖q̇‖²) is 8 / π² on a sine, to which a constant is orthogonal."""
    level, motion, bare = 0.2, swing(planar), planar.with_effects(())
    pair = contest(bare, kind(LAST, (level,)), kinds.ViscousFriction(LAST), tolerance=1e-9)
    whole = len(along(motion, 10.0).t) * level**2 / (SIGMA**2 * INFLATION)
    found = separation(pair, motion)
    assert found.delta == pytest.approx((1 - cosine**2) * whole, rel=rel)
    assert found.cosine == pytest.approx(cosine, abs=0.018)


def test_bodies_of_several_links_may_be_off_beside_a_pair(planar: Robot) -> None:
    both, motion = GivenInertias(planar.joints), swing(planar)
    found, rival = kinds.CoulombFriction(LAST, (0.2,)), kinds.ViscousFriction(LAST)
    alone = contest(planar, found, rival, motion, tolerance=EVIDENCE.tolerance)
    beside = replace(alone, pairs=(Pair(found, rival, (both,)),))
    assert len(beside.known) == max(at.stop for at in beside.causes.values())
    most = (1 + 1e-5) * separation(alone, motion).delta  # columns are held as a little dependent
    assert 0 < separation(beside, motion).delta <= most


def test_a_given_value_within_its_tolerance_costs_no_more_than_its_prior(planar: Robot) -> None:
    """Whatever the motion, η = added / tolerance explains the found cause at the price ‖η‖²."""
    given = next(e for e in planar.effects if e.name == "coulomb_friction").values or ()
    added, tolerance = 0.1, 0.05
    found, rival = kinds.CoulombFriction(LAST, (added,)), kinds.TimeDelay(LAST, trial=0.005)
    pair = contest(planar, found, rival, tolerance=tolerance)
    price = (added / (tolerance * given[-1])) ** 2
    assert 0 < separation(pair, swing(planar)).delta <= price * (1 + 1e-6)


def test_runs_that_the_prior_makes_useless_are_not_asked_for(planar: Robot) -> None:
    """Where given values within their tolerance explain the found cause, no repetition helps."""
    motion, rival = swing(planar), kinds.TimeDelay(LAST, trial=0.005)
    for added, enough in ((0.1, False), (0.4, True)):
        pair = contest(planar, kinds.CoulombFriction(LAST, (added,)), rival)
        [counted] = pair.counted(pair.information(motion))
        assert (counted.repetitions is not None) == enough
    shorter = [share * pair.information(motion) for share in np.geomspace(1.0, 1e-4, 15)]
    asked = [(part, counted.repetitions) for part in shorter for counted in pair.counted(part)]
    several = [(part, n) for part, n in asked if n is not None and n > 1]
    assert several
    for part, n in several:
        [enough], [less] = (pair.separations(k * part) for k in (n, n - 1))
        assert (enough.enough, less.enough) == (True, False)
        assert enough.delta > needed()


@pytest.mark.parametrize("rival", ["time_delay", "stribeck_friction"])
def test_a_further_motion_never_brings_rivals_together(planar: Robot, rival: str) -> None:
    pair = contest(planar, kinds.ViscousFriction(LAST, (0.2,)), EFFECTS[rival](LAST), swing(planar))
    [before] = pair.separations(np.zeros_like(pair.known))
    [after] = pair.separations(pair.information(swing(planar, 0.3, 1.0)))
    assert after.delta >= before.delta * (1 - 1e-6)


def test_runs_decide_with_the_power_that_is_promised() -> None:
    """The difference of squared errors, over its standard deviation, exceeds two-sided 5 %."""
    rng = np.random.default_rng(0)
    for delta in (3.0, 12.0, needed()):
        runs = np.ceil(needed() / delta)
        s = rng.normal(size=200)
        s *= np.sqrt(runs * delta) / np.linalg.norm(s)
        y = s + rng.normal(size=(4000, 200))
        difference = (y**2).sum(axis=1) - ((y - s) ** 2).sum(axis=1)
        decided = difference / (2 * np.linalg.norm(s)) > 1.96
        assert decided.mean() > 0.88


@pytest.mark.parametrize(
    ("found", "rival", "sine"),
    [
        (kinds.ViscousFriction(LAST, (0.3,)), kinds.TimeDelay(LAST, trial=0.005), (0.2, 0.2)),
        slow(kinds.PreslidingHysteresis(LAST, (0.06,)), kinds.CoulombFriction(LAST), (0.9, 0.1)),
        slow(kinds.StribeckFriction(LAST, (0.2,)), kinds.CoulombFriction(LAST), (0.9, 0.4)),
    ],
)
def test_the_motion_separates_what_a_poor_one_does_not(planar, found, rival, sine):
    poor, pair = swing(planar, *sine), contest(planar, found, rival)
    motions, highest = discriminating_motions(pair, np.random.default_rng(0))
    [best] = motions
    again = separation(pair, poor).delta
    assert best.deltas[0] > max(2 * again, DISCRIMINATION.hopeless)
    assert highest[0].delta >= best.deltas[0]
    report = check(planar, best.trajectory)
    assert report.hold, report.worst
    assert best.trajectory.at_rest
    motion = best.trajectory.at(pair.instants(best.trajectory.period))
    assert separation(pair, motion).delta == pytest.approx(best.deltas[0])


@pytest.mark.parametrize(
    ("found", "rival"),
    [
        (kinds.TorqueOffset(LAST, (0.3,)), kinds.AsymmetricFriction(LAST, viscous=False)),
        (kinds.Payload(LAST, LINK), kinds.InertialParameters(LAST)),
    ],
)
def test_no_motion_separates_what_is_the_same(planar: Robot, found: Effect, rival: Effect) -> None:
    pair = contest(planar, found, rival, swing(planar))
    motions, highest = discriminating_motions(pair, np.random.default_rng(0))
    assert (motions, highest[0].delta < DISCRIMINATION.hopeless) == ([], True)


@pytest.mark.slow
def test_unstated_limits_are_those_of_the_recording(planar: Robot) -> None:
    none = np.full(planar.nv, np.inf)
    limits = type(planar.limits)(np.column_stack([-none, none]), none, none, planar.limits.torque)
    free, shown = planar.with_limits(limits), swing(planar, 0.6, 0.4)
    rival = kinds.NonlinearViscousFriction(LAST, exponent=0.7)
    pair = contest(free, kinds.ViscousFriction(LAST, (0.3,)), rival, shown)
    [best, *_], _ = discriminating_motions(pair, np.random.default_rng(0))
    for order, reached in enumerate((shown.q, shown.dq, shown.ddq)):
        low, high = best.trajectory.extrema(order)
        assert (np.maximum(-low, high) <= np.abs(reached).max(axis=0) * (1 + 1e-6)).all()


def test_every_pair_of_effects_has_an_action() -> None:
    for one, other in itertools.combinations(EFFECTS.values(), 2):
        assert separating_experiment(one, other) == separating_experiment(other, one)
        assert separating_experiment(one, other) != GENERAL, (one, other)
    assert "without the load" in separating_experiment(kinds.Payload, kinds.InertialParameters)


@pytest.fixture(scope="module")
def undecided(planar: Robot, diagnosed: Diagnosed) -> Diagnosis:
    """A payload, which on a planar arm is a change of the last link."""
    return diagnosed(planar, 2, drawn(planar, "payload", 1))


@pytest.mark.slow
def test_an_action_is_named_where_no_motion_helps(undecided: Diagnosis) -> None:
    [lead, *_] = undecided.findings
    alike = {"payload", "inertial_parameters"}
    rival = next(r.candidate.effect for r in lead.rivals if r.candidate.effect.name in alike)
    assert lead.effect.name in alike
    found = plan(undecided, np.random.default_rng(0))
    settles = found.experiments[key(lead.effect, rival)]
    assert settles == Advice(settles.experiment)
    assert settles.experiment.startswith("both make the same torque in every motion: repeat the")
    assert "without the load" in settles.experiment
    entries = undecided.result(found)["findings"][0]["rivals"]
    assert settles.experiment in [entry["experiment"] for entry in entries]


def test_a_doubt_without_a_rival_ends_with_a_motion_of_all_joints(undecided: Diagnosis) -> None:
    lead = replace(undecided.findings[0], rivals=(), downgrade="its size is not known")
    for part, words in ((1.0, "run separate-1.csv (60 s, all joints move)"), (0.0099, "none is")):
        doubted = replace(undecided, findings=(replace(lead, part=part),))
        found = plan(doubted, np.random.default_rng(0))
        assert all(check(doubted.robot, motion).hold for motion in found.motions)
        assert len(found.motions) == (part == 1.0)
        assert doubted.result(found)["findings"][0]["experiment"].startswith(words)


def test_without_a_plan_actions_stand(undecided: Diagnosis) -> None:
    [entry, *_] = undecided.result()["findings"]
    last = [undecided.robot.joints[-1]]
    assert (entry["joints"], entry["verdict"]) == (last, "undecided")
    assert entry["experiment"] == entry["rivals"][0]["experiment"]
    for rival in entry["rivals"]:
        action = separating_experiment(EFFECTS[entry["effect"]], EFFECTS[rival["effect"]])
        assert (rival["experiment"], rival["file"], bool(rival["why"])) == (action, None, True)


def test_a_motion_is_described_by_what_moves(ur10: Robot) -> None:
    sine = np.outer((0.05, 0.05, -0.05), np.arange(ur10.nv) == 4)
    motion = Trajectory(np.vstack([np.zeros((4, ur10.nv)), sine]), 20.0)
    assert described(motion, ur10) == "20 s, wrist_2_joint moves"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "number"), [("viscous_friction", 0), ("nonlinear_viscous_friction", 13)]
)
def test_the_proposed_motion_settles_the_diagnosis(kind: str, number: int) -> None:
    asked = Asked(settle=True, kinds=(kind,), sizes=(0.01, 0.05), arms=("planar_2r",))
    pairs = run_case(77, number, asked)["settled"]
    by_motion = [pair for pair in pairs if pair["how"] == "motion" and pair["true"]]
    assert by_motion, pairs
    assert all(pair["became"] == "right" for pair in by_motion), pairs
