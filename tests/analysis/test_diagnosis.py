"""What a virtual arm hides is named where it is, in plain words; what it does not hide is not."""

import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from arms import truth
from known_arms import recorded, smooth_motion
from marks import slow
from planted import DRAWN, SCALAR, Case, Diagnosed, Runs, hidden

from excitant.analysis.confirmation import (
    Extender,
    Extension,
    Holdout,
    HoldoutScale,
    _cancelled,
    coefficients_of,
)
from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.evidence import are_placeholders
from excitant.analysis.explanation import at_rest, headline, reason_to_downgrade
from excitant.analysis.residuals import QUANTITIES, Residual
from excitant.analysis.selection import Rival
from excitant.analysis.thresholds import CONFIRMATION
from excitant.identify import model_files
from excitant.identify.preprocessing import away_from_rest
from excitant.identify.prior import placeholder_links
from excitant.reports.run import as_saved
from excitant.results import record_of
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.effects import EFFECTS, RotorInertia, TorqueGain
from excitant.robots.effects.body import GivenInertias
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors

PAN, LIFT, ELBOW = "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"
WRISTS = ("wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
FAST = ("coulomb_friction", "payload")
Pair = tuple[float, float]
Finding = SimpleNamespace  # that stands for one
FLOOR = 0.1
ACTS = (1.0, 0.0)  # torque of joint 1 alone
AS_FITTED = HoldoutScale(1.0, 0.0, 1.0)  # unseen data show as much of a cause
PLANTED = (
    hidden("gravity_direction", roll=0.1, pitch=-0.05),
    hidden("asymmetric_friction", ELBOW, Fc_plus=10.0, Fc_minus=2.0, Fv_plus=5.0, Fv_minus=0.0),
    hidden("stribeck_friction", PAN, Fs=15.0, velocity=0.1),
    hidden("nonlinear_viscous_friction", LIFT, Fn=8.0, exponent=2.0),
    hidden("load_dependent_friction", LIFT, Fl=0.1),
    hidden("presliding_hysteresis", PAN, Fh=10.0, distance=0.03),
    hidden("friction_coupling", *WRISTS[1:], Fv=1.0, Fc=2.0, ratio=1.0),
    hidden("thermal_friction_drift", LIFT, Fv=10.0, Fc=10.0, time=5.0),
    hidden("torque_gain", ELBOW, gain=1.1),
    hidden("torque_ripple", WRISTS[0], amplitude=3.0, order=20.0, phase=0.3),
    hidden("spring", LIFT, stiffness=20.0, rest=0.5),
    hidden("time_delay", ELBOW, delay=0.01),
    hidden("time_delay", delay=0.025),
    hidden("encoder_offset", ELBOW, offset=0.05),
    hidden("encoder_scale", ELBOW, scale=1.03),
    hidden("kinematic_error", ELBOW, dx=0.02, dy=0.02, dz=-0.01),
)


@pytest.fixture
def coulomb(case: Case) -> Diagnosis:
    return case("coulomb_friction")[1]


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=() if k in FAST else pytest.mark.slow) for k in DRAWN]
)
def test_what_is_hidden_is_found(kind: str, case: Case) -> None:
    effect, diagnosis = case(kind)
    leads = [(f.effect.name, f.effect.joints) for f in diagnosis.findings[:1]]
    assert leads == [(effect.effect, (effect.joint,))], diagnosis.headline
    lead = diagnosis.findings[0]
    assert lead.rms_after < lead.rms_before
    assert lead.explained > 0
    value, true = (lead.effect.values or ())[0], effect.parameters[0][1]
    if kind in SCALAR:
        # the truth's own friction is off its nominal value by up to 5 %
        given = lead.nominal[0]
        assert abs(value - given - true) <= 4 * lead.std[0] + 0.05 * given + 0.1 * abs(true)
    if kind == "payload":
        assert value == pytest.approx(dict(effect.parameters)["m"], rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("effect", PLANTED, ids=lambda e: "-".join((e.effect, *e.acts_on)))
def test_it_alone_is_named(effect: HiddenEffect, ur10: Robot, diagnosed: Diagnosed) -> None:
    result = diagnosed(ur10, 100 + PLANTED.index(effect), effect, duration=15.0).result()
    lead = result["findings"][0]
    assert (lead["effect"], lead["verdict"]) == (effect.effect, "named"), result["headline"]
    assert set(lead["joints"]) == set(effect.acts_on or ur10.joints)
    assert lead["holdout"]["rms_after"] < lead["holdout"]["rms_before"]
    assert not [f for f in result["findings"][1:] if f["verdict"] == "named"]


def test_a_delay_is_that_of_friction_too_which_the_model_lacks(diagnosed: Diagnosed) -> None:
    robot, late = load_robot("so100"), hidden("time_delay", delay=0.02)
    found = diagnosed(robot, 1, late, given=robot.with_effects(())).findings
    effects = {f.effect.name: f.effect for f in found if f.verdict == "named"}
    assert effects["time_delay"].values == pytest.approx((0.02,), abs=1e-3)
    assert "presliding_hysteresis" not in {f.effect.name for f in found}
    plain = [f for f in found if f.effect.search.standard]
    built = {"stribeck_friction", "load_dependent_friction", "presliding_hysteresis"}
    assert not built & {r.candidate.effect.name for f in plain for r in f.rivals}


@pytest.mark.slow
def test_what_no_candidate_describes_is_unknown(ur10: Robot, diagnosed: Diagnosed) -> None:
    """A torque that switches at random, as a sticking brake might."""
    brake = hidden("unknown", LIFT, amplitude=10.0, rate=1.0)
    switching = replace(brake, structure="telegraph_torque")
    result = diagnosed(ur10, 4, switching, duration=15.0).result()
    found = [(f["effect"], f["joints"]) for f in result["findings"]]
    assert found == [("unknown", [LIFT])], result["headline"]
    assert "remain unexplained" in result["headline"]


ARMS = [slow(name, seed) for name, seed in product(("ur10", "panda"), (200, 201))]


@pytest.mark.parametrize(("name", "seed"), [("planar_2r", 0), slow("ur10", 2), *ARMS])
def test_nothing_hidden_nothing_named(name: str, seed: int, diagnosed: Diagnosed) -> None:
    diagnosis = diagnosed(load_robot(name), seed)
    assert not [f for f in diagnosis.findings if f.verdict == "named"], diagnosis.headline
    if seed < 200:
        assert diagnosis.findings == ()
        assert diagnosis.headline.startswith("No cause stands out")


@pytest.mark.slow
@pytest.mark.parametrize("shares", [[1.0] * 6, [1.0, 1.0, 0.7, 0.3, 0.0, 0.0]])
def test_gravity_turns_for_all_joints_or_for_none(shares: list[float], ur10: Robot, runs: Runs):
    """Torque as if gravity came from elsewhere, joints by their shares."""
    turned, recordings = ur10.with_gravity((1.7, -1.0, -9.61)), []
    for run in runs(ur10, 8, (), industrial_sensors(ur10), 0.03):
        still = Motion(run.t, run.q, 0 * run.q, 0 * run.q)
        more = torque(turned, still) - torque(ur10, still)
        recordings.append(replace(run, tau=run.tau + more * shares))
    diagnosis = diagnose(ur10, recordings[:1], validate=recordings[1:])
    found = [f for f in diagnosis.findings if f.effect.name == "gravity_direction"]
    assert [f.verdict for f in found] == ["named" if min(shares) == 1 else "undecided"]
    assert ("wrist_2_joint" in found[0].downgrade) == (min(shares) < 1)
    for finding in found:
        np.testing.assert_allclose(finding.effect.values, [1.7, -1.0, 0.2], atol=0.15)


@pytest.mark.slow
def test_play_that_is_never_crossed_is_not_called_play(planar: Robot, diagnosed: Diagnosed) -> None:
    """A lever that always hangs to one side leans on one flank: its encoder may be off instead."""
    off = hidden("encoder_offset", "joint1", offset=0.08)
    lead = diagnosed(planar, 5, off, tolerance=0.0, duration=12.0).findings[0]
    rivals = {r.candidate.effect.name for r in lead.rivals}
    assert "encoder_offset" in {lead.effect.name, *rivals}
    assert lead.effect.name != "backlash"


def errors(diagnosis: Diagnosis, model: Robot) -> np.ndarray:
    """What a model leaves of the hold-out."""
    [segment] = diagnosis.data.validate
    left: np.ndarray = segment.tau - segment.filtered(torque(model, segment.motion))
    return left[segment.keep]


def test_gains_are_those_of_the_written_model(coulomb: Diagnosis, tmp_path: Path) -> None:
    for name, text in model_files(coulomb.extension.model, "extended", "extended.yaml").items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    written, [segment] = load_robot(tmp_path / "extended.yaml"), coulomb.data.validate
    tau, moves = segment.tau[segment.keep], away_from_rest([segment])
    for model, reported in ((coulomb.robot, coulomb.simulation), (written, coulomb.extended)):
        error = errors(coulomb, model)
        for j, rows in enumerate(moves.T):
            rms = np.sqrt((error[rows, j] ** 2).mean())
            assert reported.rms[j] == pytest.approx(rms, rel=1e-6)
            assert reported.nrmse[j] == pytest.approx(rms / tau[rows, j].std(), rel=1e-6)


def test_an_error_is_the_same_wherever_it_is_told(coulomb: Diagnosis) -> None:
    """Over rows at which the joint moves, after one filter: findings, tables, headline."""
    assert not coulomb.holdout.series.moves.all()
    result, lead = coulomb.result(), coulomb.findings[0]
    given = [row["rms"] for row in result["simulation"]["joints"]]
    extended = [row["rms"] for row in result["extended"]["joints"]]
    told = [row["rms"] for row in result["error"]["joints"]]
    assert told == pytest.approx(given, rel=1e-9)
    left = [residual.rms for residual in coulomb.residuals]
    assert left == pytest.approx(extended, rel=1e-9)
    assert lead.rms_after == pytest.approx(coulomb.extended.rms[lead.joint], rel=1e-9)
    assert result["findings"][0]["holdout"]["rms_after"] == pytest.approx(lead.rms_after)


def test_a_finding_is_the_extended_model_without_it(coulomb: Diagnosis) -> None:
    lead, model, without = coulomb.findings[0], coulomb.extension.model, []
    for effect in model.effects:
        values = list(effect.values or ())
        if effect.name == lead.effect.name:
            values[effect.joints.index(lead.effect.joints[0])] = lead.nominal[0]
        without.append(effect.with_values(values))
    error = errors(coulomb, model.with_effects(without))
    j = model.joint_index(lead.effect.joints[0])
    moves = away_from_rest(coulomb.data.validate)[:, j]
    assert lead.rms_before == pytest.approx(np.sqrt((error[moves, j] ** 2).mean()), rel=1e-6)


@pytest.mark.parametrize("kind", ["payload", "coulomb_friction"])
def test_the_result_is_its_record_and_names_every_joint(kind: str, case: Case) -> None:
    _, diagnosis = case(kind)
    result, robot = diagnosis.result(), diagnosis.robot
    record_of(as_saved(result, {})[0])
    for part in ("simulation", "extended", "error"):
        assert [row["name"] for row in result[part]["joints"]] == list(robot.joints)
    assert {f["verdict"] for f in result["findings"]} <= {"named", "undecided"}
    parameters = [p for f in result["findings"] for p in f["parameters"]]
    assert all({"std", "unit"} <= set(p) for p in parameters)
    explained = [f["explained"] for f in result["findings"]]
    assert explained == sorted(explained, reverse=True)
    spectra = result["error"]["joints"]
    assert all(set(part["shares"]) <= set(QUANTITIES) for part in spectra)
    shares = [row["share"] for row in result["unexplained"]]
    shares += [x for part in spectra for x in part["shares"].values()]
    assert all(0 <= share <= 1 for share in shares)
    rows = {len(values) for values in diagnosis.series().values()}
    assert rows == {len(diagnosis.holdout.series.t)}


def test_a_finding_lowers_the_error_while_joints_move(coulomb: Diagnosis) -> None:
    before, after = coulomb.before_and_after(coulomb.findings[:1])
    assert after < before
    assert f"{before:.2g} → {after:.2g}" in coulomb.headline
    arrays = coulomb.series()
    x, residual, fit = (arrays[f"finding0_{name}"] for name in ("x", "residual", "fit"))
    shown = np.isfinite(x)
    assert shown.any()
    before, after = (np.sqrt((e[shown] ** 2).mean()) for e in (residual, residual - fit))
    assert after < 0.5 * before


def cause(
    kind: str, explained: float = 0.5, joint: str = "joint1", torque: Pair | np.ndarray = ACTS,
    scale: HoldoutScale = AS_FITTED, nominal: tuple[float, ...] = (), **shape: float,
) -> Finding:  # fmt: skip
    """Its effect, and its torque at each of two joints."""
    shown = {"effect": EFFECTS[kind]((joint,), **shape), "explained": explained, "scale": scale}
    shown |= {"part": explained, "nominal": nominal}
    shown |= {"by_chance": lambda level: False, "is_open": False, "is_vague": False, "std": 0.0}
    return SimpleNamespace(**shown, torque=np.ones((100, 1)) * torque, share=1.0)


@pytest.mark.parametrize(
    ("rms", "left", "own", "rough", "said"),
    [
        # over a fifth of its square is left at its joint
        ((0.0, 1.0), (0.0, 0.4), 0.5, ("joint2", 0.0), ""),
        ((0.0, 1.0), (0.0, 0.5), 0.5, ("joint2", 0.0), "unexplained"),
        ((0.0, 1.0), (1.1, 0.0), 0.5, ("joint2", 0.0), ""),
        # at several joints, it has to explain them all
        ((1.0, 1.0), (0.0, 0.2), 0.5, ("joint2", 0.0), ""),
        ((1.0, 1.0), (0.0, 0.5), 0.5, ("joint2", 0.0), "several joints at once"),
        # a small cause beside a large one of rough shape
        ((0.0, 1.0), (0.0, 0.0), 0.05, ("joint2", 0.6), "shape"),
        ((0.0, 1.0), (0.0, 0.0), 0.05, ("joint1", 0.6), ""),
        ((0.0, 1.0), (0.0, 0.0), 0.05, ("joint2", 0.4), ""),
        ((0.0, 1.0), (0.0, 0.0), 0.6, ("joint2", 0.05), ""),
    ],
)
def test_why_a_cause_that_pays_is_not_decided(rms, left, own, rough, said):
    """Torque and slow structure left of this rms at each of two joints; what causes explain."""
    found = cause("viscous_friction", own, "joint2", rms)
    large = cause("viscous_friction", 0.6, "joint2", rms)
    others = (large, cause("stribeck_friction", rough[1], rough[0], rms))
    residuals = [
        Residual(f"joint{j}", np.hypot(x, FLOOR), FLOOR, 2 * x + FLOOR, 1.0, {})
        for j, x in enumerate(left, start=1)
    ]
    reason = reason_to_downgrade(load_robot("planar_2r"), found, others, residuals, 0.1)
    assert said in reason
    assert bool(said) == bool(reason)


def unseen(kind: str, size: float, error: float) -> Finding:
    return cause(kind, scale=HoldoutScale(size, error, 1.0))


CURVE, STRIBECK = "nonlinear_viscous_friction", "stribeck_friction"
SLOW, FAST_RIPPLE = (cause("torque_ripple", order=order) for order in (1.4, 20.0))
SPRING, ON_SPRING = cause("spring"), "shares the position curve"
SWING = np.sin(np.arange(100.0))[:, None] * ACTS
ELSEWHERE = cause(STRIBECK, 0.0, "joint2")
PLAIN = [cause(f"{kind}_friction", torque=way * SWING, nominal=(1.0,))
         for kind, way in (("viscous", 1.0), ("coulomb", -0.9))]  # fmt: skip
SWUNG, BACK, FAINT = cause("spring", 2.0, torque=SWING), "mostly cancel", "smaller than the 5 %"


def reason_among(*causes: Finding) -> str:
    """Why the first of all causes is not decided, where little is left."""
    robot = load_robot("planar_2r")
    left = [Residual(joint, FLOOR, FLOOR, 1.0, 0.01, {}) for joint in robot.joints]
    return reason_to_downgrade(robot, causes[0], causes, left, 0.1)


@pytest.mark.parametrize(
    ("found", "other", "said"),
    [
        # which of two that share a friction curve it is, is open
        (cause(CURVE, 0.6), cause(STRIBECK, 0.1), "friction curve"),
        (cause(CURVE, 0.1), cause(STRIBECK, 0.6), "friction curve"),
        (cause(CURVE, 0.6), cause(STRIBECK, 0.05), ""),
        (cause(CURVE, 0.6), cause(STRIBECK, 0.1, "joint2"), ""),
        # parts of what one encoder reads wrongly over a turn
        (cause("encoder_eccentricity", 0.05), cause("encoder_scale", 0.6), "encoder curve"),
        (cause("encoder_scale", 0.6), cause("encoder_eccentricity", 0.05), ""),
        # the misfit of larger causes
        (cause(CURVE, 0.0024), cause(STRIBECK, 0.0, "joint2"), f"{FAINT} uncertainty"),
        (cause(CURVE, 0.0026), cause(STRIBECK, 0.0, "joint2"), ""),
        # smooth curves of the position, as are a hose or a bumper, which are neither
        (SLOW, SPRING, ON_SPRING),
        (SPRING, SLOW, ON_SPRING),
        (FAST_RIPPLE, SPRING, ""),
        (SPRING, FAST_RIPPLE, ""),
        (SLOW, cause("spring", joint="joint2"), ""),
        (cause("spring", joint="joint2"), SLOW, ""),
        # a spring, and a torque gain that makes some of its torque, backward or forward
        (SWUNG, cause("torque_gain", 2.0, torque=-0.9 * SWING), BACK),
        (SWUNG, cause("torque_gain", 2.0, torque=-0.4 * SWING), ""),
        (SWUNG, cause("torque_gain", 2.0, torque=1.0 * SWING), ""),
        (SWUNG, cause("torque_gain", 2.0, "joint2", -0.9 * SWING), ""),
        (PLAIN[0], cause("coulomb_friction", torque=-0.9 * SWING), BACK),
        (*PLAIN, ""),  # given, both may be off
        # what unseen data take back, if by more than models are good to; friction may change
        (unseen("time_delay", 0.9, 0.04), ELSEWHERE, "is 0.90 ± 0.04 of the fitted one"),
        (unseen("time_delay", 0.9, 0.06), ELSEWHERE, ""),
        (unseen("time_delay", 0.96, 0.01), ELSEWHERE, ""),
        (unseen("time_delay", 1.4, 0.01), ELSEWHERE, ""),
        (unseen("coulomb_friction", 0.8, 0.01), ELSEWHERE, ""),
    ],
)
def test_causes_that_another_may_be_or_that_are_faint_are_not_decided(found, other, said):
    reason = reason_among(found, other)
    assert said in reason
    assert bool(said) == bool(reason)


@pytest.mark.parametrize(("kind", "said"), [("payload", ""), ("inertial_parameters", "sign")])
def test_a_link_may_be_lighter_than_given_a_payload_not_than_nothing(kind: str, said: str) -> None:
    body = cause(kind)
    vars(body)["is_open"] = True
    assert said in reason_among(body)
    assert bool(said) == bool(reason_among(body))


@pytest.mark.parametrize(
    ("joints", "left", "said"),
    [
        (["joint1"], 0.6, ""),
        (["joint1"], 0.4, "half of its given mass"),
        (["joint2"], 0.4, ""),
        (["joint1", "joint2"], 0.4, "half of its given mass"),
    ],
)
def test_no_link_but_that_of_the_tool_loses_half_of_its_mass(joints, left, said) -> None:
    body = cause("inertial_parameters")
    robot = load_robot("planar_2r")
    links = robot.phi.reshape(-1, 10)[[robot.joint_index(joint) for joint in joints]]
    vars(body)["effect"] = GivenInertias(tuple(joints)).with_values((left - 1) * links.ravel())
    reason = reason_among(body)
    assert said in reason
    assert bool(said) == bool(reason)


@pytest.mark.parametrize(("dry", "said"), [(700.0, ""), (-700.0, "would gain friction")])
def test_a_joint_that_warms_up_loses_friction(dry: float, said: str) -> None:
    drift = cause("thermal_friction_drift")
    vars(drift)["effect"] = drift.effect.with_values((50.0, dry))
    assert said in reason_among(drift)
    assert bool(said) == bool(reason_among(drift))


def test_a_rival_that_needs_the_link_too_is_none(coulomb: Diagnosis) -> None:
    robot, extender = coulomb.robot, coulomb.extension.extender
    link = EFFECTS["inertial_parameters"](robot.joints[:1])
    own = replace(extender, link_std=np.array([0.5, 0.05]))
    anew = own.as_given(link)
    assert anew.link_std.tolist() == [0.05, 0.05]
    for heavier, off in ((1.05, False), (1.3, True)):
        model = robot.with_parameters(robot.phi.reshape(-1, 10) * [[heavier], [1.0]])
        assert anew.is_off(link, model) == off
        assert not own.is_off(link, model)
    assert not anew.is_off(coulomb.findings[0].effect, model)


@pytest.mark.parametrize(("size", "open_"), [(0.12, True), (0.25, False)])
def test_a_common_gain_is_not_told_from_masses_that_are_all_off(size: float, open_: bool) -> None:
    common = cause("torque_gain", torque=(1.0, 1.0))
    vars(common)["effect"] = TorqueGain(("joint1", "joint2")).with_values([size])
    assert bool(reason_among(common)) == open_


@pytest.mark.parametrize(("coarse", "off"), [(0.1, (-0.05, 0.05)), (np.inf, (-0.3, -0.1))])
def test_coarse_positions_make_no_inertia_small(coarse: float, off: Pair, monkeypatch):
    """Steps of 6 mrad, 20 % noise of an acceleration, whose inertia least squares makes small."""
    used = replace(CONFIRMATION, coarse=coarse)
    monkeypatch.setattr("excitant.analysis.diagnosis.CONFIRMATION", used)
    known = truth("planar_2r")
    given = known.robot.with_effects([RotorInertia(known.robot.joints, tuple(8 * known.arm.Ia))])
    motion, step = smooth_motion(given, np.arange(0, 10, 1 / 125)), 6e-3
    runs = [recorded(known, motion, seed, encoder=1e-4) for seed in (13, 14)]
    fit, held = (replace(run, q=step * np.round(run.q / step)) for run in runs)
    found = diagnose(given, [fit], validate=[held]).extension.model.effects
    [Ia] = [e.values for e in found if e.name == "rotor_inertia"]
    assert (np.abs(Ia / known.arm.Ia - 1 - np.mean(off)) < np.ptp(off) / 2).all()


def test_of_effects_that_cancel_the_finer_is_not_published() -> None:
    plain, finer = (EFFECTS[kind](("joint1",)) for kind in ("viscous_friction", CURVE))
    chosen = [SimpleNamespace(effect=e, key=(e.name, e.joints)) for e in (plain, finer)]
    for size, gone in ((-0.7, chosen[1]), (-0.2, None), (0.7, None)):
        sizes = ((plain, 0.1, 1.0), (finer, 0.9, size))
        found = [Finding(effect=e, margin=x, torque=y * SWING) for e, x, y in sizes]
        assert _cancelled(SimpleNamespace(chosen=chosen, findings=found)) is gone


@pytest.mark.parametrize(
    ("resting", "moving", "turns"),
    [(0.0, 1.009, True), (0.9, 0.9, True), (0.0, 1.011, False), (1.1, 0.9, False), (1, 1, False)],
)
def test_friction_of_other_joints_turns_only_where_it_predicts(
    planar: Robot, resting: float, moving: float, turns: bool, monkeypatch: Any
) -> None:
    """Squared errors at rest and in motion, of two equal halves, over those of a jump."""
    moves = np.arange(100)[:, None] < [50, 50]
    rows = SimpleNamespace(measured=SWING + SWING[:, ::-1], moves=moves)
    holdout = Holdout(None, rows, *[None] * 7)
    plain: Any = {"model": planar.with_effects([]), "chosen": (), "findings": ()}
    jumps, turned = (
        SimpleNamespace(predicted=rows.measured - 0.1 * np.sqrt(error), **plain)
        for error in (1.0, np.where(moves, moving, resting))
    )
    monkeypatch.setattr(Extender, "__call__", lambda it, _: turned if it.turns else jumps)
    monkeypatch.setattr(Extender, "by_data", lambda it, _: it)
    train = SimpleNamespace(reversals=["one"])
    extender = Extender(None, train, None, holdout, None)
    fit = SimpleNamespace(**vars(jumps), extender=extender)
    assert (Extension.settled(fit) is turned) == turns


@pytest.mark.slow
@pytest.mark.parametrize(("name", "link"), [("ur10", 3), ("puma560", 3)])
def test_a_link_of_which_the_file_says_nothing_is_no_other_cause(name, link, diagnosed):
    robot = load_robot(name)
    bodies = robot.phi.reshape(-1, 10).copy()
    bodies[link] = 0
    given = robot.with_parameters(bodies)
    assert placeholder_links(given).tolist() == [k == link for k in range(robot.nv)]
    found = diagnosed(robot, 1, given=given, tolerance=0.02)
    assert [f.effect.role for f in found.findings] == ["link"]
    assert (found.extended.nrmse < 0.03).all()


def test_an_undecided_size_has_no_deviation(coulomb: Diagnosis) -> None:
    lead = coulomb.findings[0]
    for finding, known in ((lead, True), (replace(lead, downgrade="why"), False)):
        entry = replace(coulomb, findings=(finding,)).result()["findings"][0]
        values = [*entry["parameters"][:1], *entry["sizes"][:1]]
        assert [value["std"] is not None for value in values] == [known, known]
        assert ("±" in entry["sentence"]) == known
    change = np.array(lead.effect.values) - lead.nominal
    off = [replace(lead, covariance=(change / k)[:, None] ** 2) for k in (0.9, 1.1, 1.9, 2.1)]
    assert [each.is_vague for each in off] == [True, False, False, False]
    assert [each.is_open for each in off] == [True, True, True, False]
    # what it adds is an error of the others
    fit, effect = coulomb.extension, EFFECTS["viscous_friction"](lead.effect.joints)
    undecided = replace(lead, effect=effect.with_values((1.0,)), downgrade="why")
    [own], [other] = fit.places(lead.effect), fit.places(effect)
    shift = fit.covariance[own, other] / fit.covariance[other, other] * (1.0 - lead.nominal[0])
    found = fit.unsure_of(lead, [lead, undecided])
    assert found.std[0] == pytest.approx(np.hypot(lead.std[0], shift), rel=1e-9)
    # with a rival in its place it is what is fitted then, unless both are laws of one friction
    [here] = coefficients_of(fit.model, fit.model, lead.effect)
    model = fit.model.with_effects([lead.effect.with_values((here + 0.5,))])
    spring = replace(lead, effect=EFFECTS["spring"](lead.effect.joints), instead=model)
    for name, shift in (("torque_gain", 0.5), ("stribeck_friction", 0.0)):
        alike = [c for c in fit.evidence.candidates if c.effect.name == name]
        [rival] = [c for c in alike if c.effect.joints == lead.effect.joints][:1]
        found = fit.unsure_of(lead, [replace(spring, rivals=(Rival(rival, (), 0.0, 1.0),))])
        assert found.std[0] == pytest.approx(np.hypot(lead.std[0], shift), rel=1e-9)


@pytest.mark.parametrize(
    ("resting", "in_motion", "said"),
    [
        pytest.param(2.0, 0.1, "elbow has an error of 2 N·m at rest", id="at rest"),
        pytest.param(2 * FLOOR, 0.0, "", id="within the noise"),
        pytest.param(2.0, 2.0, "", id="no more than in motion"),
    ],
)
def test_an_error_at_rest_is_told(resting: float, in_motion: float, said: str) -> None:
    """One joint that rests for a while; nothing is found."""
    moves = np.ones((800, 1), bool)
    moves[300:500] = False
    diagnosis: Any = SimpleNamespace(unit=lambda joint: "N·m", ordered=[])
    diagnosis.holdout = SimpleNamespace(series=SimpleNamespace(moves=moves))
    diagnosis.error = np.where(moves, in_motion, resting)
    diagnosis.residuals = (SimpleNamespace(joint="elbow", floor=FLOOR),)
    assert at_rest(diagnosis).startswith(said)
    assert bool(at_rest(diagnosis)) == bool(said)
    assert headline(diagnosis).startswith("No cause stands out")
    assert headline(diagnosis).endswith(at_rest(diagnosis))


@pytest.mark.slow
def test_what_is_hidden_is_found_without_inertias(ur10: Robot, diagnosed: Diagnosed) -> None:
    """Links that all weigh the same say nothing: no axis is moved to make up for masses."""
    joint, body = ur10.joints[1], (1.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.01, 0.0, 0.0, 0.01)
    given = ur10.with_parameters(np.tile(body, ur10.nv))
    assert are_placeholders(given)
    assert not are_placeholders(ur10)
    offset = hidden("torque_offset", joint, offset=8.0)
    diagnosis = diagnosed(ur10, 2, offset, given=given, duration=15.0)
    [finding] = diagnosis.findings
    effects = [finding.effect, *(r.candidate.effect for r in finding.rivals)]
    assert "torque_offset" in {e.name for e in effects if e.joints == (joint,)}
    assert (diagnosis.extended.nrmse < 0.05).all()
    result = diagnosis.result()
    assert re.match("All links .* weigh 1 kg.*Besides inertias: ", result["headline"])
    assert any("fitted together with the causes" in note for note in result["notes"])
