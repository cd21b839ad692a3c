"""Thresholds of the analysis: the settings by which a name, a verdict or an advice changes.

One record per stage. The docstring of a field states the unit, the inequality that the value enters
and where the value comes from; "convention" marks one for which no derivation is recorded. What
those of a diagnosis do is measured by ``benchmarks/diagnosis.py``, those of discrimination by its
``--settle``, those of resolution by ``tests/analysis/test_structure.py``.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class EvidenceThresholds:
    """Comparison of candidate causes on the fitted rows."""

    tolerance: float = 0.05
    """Relative std of nominal values: they are taken as correct to ±10 %, two std."""

    wrong_link: float = 1.0
    """Relative std of a link that is a candidate for wrong ``inertial_parameters``."""

    false_alarm: float = 0.05
    """Probability that any candidate enters, fall of J > λ F(1 − p / trials), with none present.

    The level of a test, divided among candidates and shapes (Bonferroni); for identified models
    the share of false discoveries instead (Benjamini and Gavrilov 2009).
    """

    least_dispersion: float = 0.5
    """λ ≥ this, also where correlation of the noise favours a candidate. Convention."""

    block_s: float = 0.5
    """Blocks last at least this [s]: longer than the correlation time of filtered torque noise."""

    fewest_blocks: int = 16
    """Blocks ≥ this: from fewer, the variance of λ would be too large. Convention."""

    most_blocks: int = 40
    """Blocks ≤ this: more are no gain. Convention."""

    determined: float = 25.0
    """Data over prior information > this in the directions that judge the tolerance.

    Their deviation is then known to a fifth of the tolerance.
    """

    fewest_directions: int = 4
    """Such directions ≥ this, or the tolerance stays as it is: it follows from a median."""

    many_directions: int = 8
    """Such directions ≥ this, or the tolerance does not shrink. Convention."""

    least_off: float = 0.02
    """Tolerance, relative to ±10 %, ≥ this where there are many directions. Convention."""

    most_off: float = 8.0
    """Tolerance, relative to ±10 %, ≤ this: published inertias are known to ±80 % at worst."""

    placeholder: float = 400.0
    """Tolerance, relative to ±10 %, of a link without a mass of its own.

    It may be twenty times as heavy as the placeholder.
    """


@dataclass(frozen=True)
class SelectionThresholds:
    """Selection of causes, and of the rivals of each; documented in how-diagnosis-decides.md."""

    largest_set: int = 60
    """Causes at most, so that the search ends. Convention."""

    chance_tail: float = 0.1
    """Causes are ranked by their fall of J less what the best of their shapes exceeds by chance
    with this probability. Convention."""

    identical: float = 0.9999
    """|cos| > this: a shape that the motion does not show gives way to a cause without shape."""

    faded: float = 0.5
    """Fall of J ≤ this times that when last tested: a cause is tested again. Saves time only."""

    cancelled: float = 4.0
    """Squared torque of a cause > this times the squared residual: others must cancel it."""

    common_share: float = 0.05
    """Fall of J by separate joints < this times that of a common cause: the joints agree."""

    common_chance: float = 1e-3
    """Probability that joints which agree are taken to disagree (Cochran 1954)."""

    tie: float = 2.0
    """Difference of squared errors < this many standard errors: two causes tie (Vuong 1989), at
    the usual level of 5 %."""

    tie_alike: float = 3.3
    """The same, at a level of 0.1 %, where signatures are alike."""

    alike: float = 0.9
    """|cos| > this: signatures are alike."""

    contained: float = 0.999
    """|cos| > this: a cause with more coefficients only contains the other one."""

    rival_share: float = 0.5
    """A rival explains > this share of what the cause explains, and leaves less than it."""

    unseen: float = 2.0
    """Error of unseen parts falls by ≥ this many standard errors with an effect that is chosen
    for an identification, at the usual level of 5 %."""

    parts: int = 4
    """Parts of the rows, each predicted from the others (Stone 1974). Convention."""


@dataclass(frozen=True)
class ConfirmationThresholds:
    """Confirmation of causes on the hold-out; documented in how-diagnosis-decides.md."""

    blocks: int = 10
    """Blocks of time of the hold-out that give the standard error of a gain. Convention."""

    deviations: float = 2.0
    """A gain exceeds zero, a value the nominal one, by > this many standard errors (5 %)."""

    contradicted: float = 3.0
    """The error of a joint grows by > this many standard errors with a cause common to all.
    Convention."""

    floor: float = 0.05
    """Gain ≥ this share of a joint's squared error: dry friction is never an ideal sign function,
    and clean recordings give spurious gains of 2 to 6 %."""

    plain: float = 0.1
    """Gain > this share of a joint's squared error: it counts even below the noise. Convention."""

    faint: float = 0.005
    """Rms torque of a cause ≥ this share of its joint's: no model is right to so little."""

    ideal: float = 0.01
    """Rms torque of a named cause ≥ this share of its joint's: what ideal friction, filters and
    samples miss."""

    coarse: float = 0.1
    """Noise of an acceleration over its rms > this: least squares loses its square, 1 % of an
    inertia, to bias, and even against odd samples do not. A smaller bias is part of the ±."""

    payload_std: float = 100.0
    """Relative std of a payload, which is left free."""

    payload_share: float = 0.05
    """Mass of the payload at which its std is relative, over that of the arm. Convention."""

    payload_radius: float = 0.1
    """Radius of gyration of that payload [m]. Convention."""


@dataclass(frozen=True)
class VerdictThresholds:
    """Downgrading of confirmed causes to *undecided*; documented in how-diagnosis-decides.md."""

    minor: float = 0.1
    """A cause explains < this share of what a searched shape, or another curve of friction or
    position of its joint, explains: their misfit looks like it."""

    residual_share: float = 0.05
    """Squared residual > this share of the squared torque of a cause on several joints: it does
    not explain them all."""

    same_torque: float = 0.01
    """Squared change by a rival ≤ this share of the cause's: another name of the same torque.
    Of MuJoCo arms an offset and asymmetric friction differ by 0.0001 to 0.0006, of a real servo a
    spring and a gain by 0.04."""

    own_residual_share: float = 0.2
    """The same of a cause on one joint: another may be the true one. In 192 worlds, 99 names of
    hidden effects were right below it, none above; two of four wrong names were above."""

    main_joint: float = 0.3
    """Torque of a cause > this share of that at its main joint: the joint counts. Convention."""

    cancelling: float = 0.5
    """Squared sum of two effects < this share of either's: they cancel each other."""

    common_masses: float = 2.0
    """Relative gain < this many std of the nominal masses, which may all be off alike (5 %)."""

    lost_mass: float = 0.5
    """Share of its given mass that a link inside the arm lacks: other links, or what is not in the
    vocabulary, are as likely. Convention."""

    lacking_friction: float = 0.5
    """Rms of nominal friction < this share of that found: the model lacks it. Convention."""

    minor_kind: float = 0.05
    """A kind of friction explains ≤ this share of all friction: its rivals do not count for the
    whole. Convention."""

    at_rest: float = 0.5
    """Squared error at rest > this share of a joint's: a note says so."""

    above_noise: float = 3.0
    """Rms error at rest > this many times the noise, for the same note. Convention."""

    listed: int = 7
    """Findings; slight ones beyond are in a note instead. Convention."""

    chance: float = 0.05
    """Values as far off come by chance this often, or more: a cause is undecided. Of all values
    that the data correct within their tolerance, the probability that one of them is chance."""


@dataclass(frozen=True)
class SearchThresholds:
    """Repeated search with the model found, and drive gains by nominal bodies."""

    rounds: int = 5
    """Searches at most, as effects may depend on the model that they find. Convention."""

    gain: float = 0.01
    """Squared error falls by less than this share: the round is the last, or nothing is added. By
    no more may friction that turns over a range of speeds, which predicts rest, raise that of
    motion. Convention."""

    own_scale: float = 0.5
    """Variance of the common scale of drive gains over that which the nominal bodies leave, at
    least: the nominal friction, of which nothing is surer, may say as much again as they do."""

    drive_std: float = 1.0
    """Std of the logarithm of a drive gain from bodies alone: a factor of e."""

    least_drive: float = 0.2
    """New over assumed drive gain ≥ this, so that a step of the search stays one. Convention."""

    close_drive: float = 0.5
    """New over assumed drive gain > this at all joints: the search has converged. Convention."""


@dataclass(frozen=True)
class StructuredThresholds:
    """Structure of a residual."""

    visible: float = 2.0
    """Rms beyond noise > this many times the noise floor: an effect can be seen."""

    share: float = 0.1
    """Squared residual > this share of the nominal model's: it is material. Convention."""

    explains: float = 0.1
    """Power explained by the best quantity ≥ this, or none is named. Convention."""

    nearly: float = 0.05
    """A simpler quantity that explains less than the best by ≤ this is preferred. Convention."""

    correlation_s: float = 0.1
    """Correlation time of a residual < this [s]: it looks like noise; half of it for one that is
    visible otherwise. Convention."""

    trend_periods: float = 3.0
    """Recorded periods of the slowest motion ≥ this, or a trend cannot be told from it."""

    least_direction: float = 0.005
    """Speed ≤ this share of a joint's top speed has no direction. Convention."""

    measurable: float = 1e-3
    """Noise ≤ this share of the error comes from a filter, not from a sensor. Convention."""


@dataclass(frozen=True)
class ResolutionThresholds:
    """Practical identifiability by a motion."""

    torque_noise: float = 0.01
    """Std of the torque noise over a joint's limit where no recording gives it. Convention."""

    well: float = 0.1
    """Relative std ≤ this: *well* determined."""

    roughly: float = 0.3
    """Relative std ≤ this: *roughly* determined."""

    repeats: float = 10.0
    """A longer recording is proposed up to this many lengths of the present one. Convention."""

    sensor_noise: float = 0.01
    """Noise of a sensor under the base over its largest force and torque. Convention."""

    rests: float = 0.01
    """Range of a joint < this [rad or m]: it rests. Convention."""

    flat: float = 1e-3
    """Second moment of a body < this share of its prior's: at the limit of consistency."""


@dataclass(frozen=True)
class DiscriminationThresholds:
    """Motions that separate rival causes."""

    power: float = 0.9
    """Probability that a difference which is there is found: Δ ≥ 4 (z_{α/2} + z_{1−power})²."""

    level: float = 0.05
    """α of that inequality, as `SelectionThresholds.tie`."""

    alike_level: float = 0.001
    """α where signatures are alike, as `SelectionThresholds.tie_alike`."""

    most_runs: int = 10
    """Runs of one motion at most. Convention."""

    hopeless: float = 4.0
    """Δ ≤ this: no motion is worth running; two standard deviations."""

    plenty: float = 6.0
    """Δ > this many times what is required is of no use. Convention."""

    matters: float = 0.01
    """Share of its joints' squared error explained ≥ this, or no experiment is told. Convention."""

    nearest: float = 0.01
    """Distance of collision shapes along the recording > this [m], or they are too rough."""


EVIDENCE = EvidenceThresholds()
SELECTION = SelectionThresholds()
CONFIRMATION = ConfirmationThresholds()
VERDICT = VerdictThresholds()
SEARCH = SearchThresholds()
STRUCTURED = StructuredThresholds()
RESOLUTION = ResolutionThresholds()
DISCRIMINATION = DiscriminationThresholds()
