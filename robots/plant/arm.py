"""Time stepping of the plant: forward dynamics with stiction under a tracking controller.

Equation of motion, with M including the rotor inertia and b the Coriolis, centrifugal and gravity
torque:

    M(q) q̈ + b(q, q̇) + D q̇ + λ = τ,    λ_j ∈ L_j(q̇_j) · Sign(q̇_j),

where Sign is set-valued at zero, so that a joint at rest holds any torque up to L_j, and
L(v) = F_c + F_s exp(−(v / v_s)²) plus what further laws add. A step of length h is a midpoint
rule, implicit in the velocity for friction, controller, bristles and elastic gears (Moreau time
stepping): no regularisation, hence neither creep nor chatter, and no instability of light joints.

Coordinates x are the link positions q, and behind them the motor angle (at the joint side) of
every joint with an elastic gear. That motor carries the joint's rotor, friction and encoder.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import scipy
from scipy.linalg.lapack import dgesv

from excitant.exceptions import BadInput, BadRobot
from excitant.robots.motion import Array
from excitant.robots.plant.physics import Truth
from excitant.robots.plant.sensors import Run
from excitant.robots.robot import Robot

Trajectory = Callable[[Array, int], Array]
"""Motion as a function of time, shape (n,) [s], and derivative order: shape (n, nv)."""
State = tuple[Array, Array, Array]
"""Coordinates x, their velocity, and their mean acceleration over the step before."""
Progress = Callable[[float], None]
"""Told from time to time which fraction is done."""

BANDWIDTH = 40.0  # of the closed position loop [rad/s]
LONGEST_STEP = 5e-4  # s: a fiftieth of the controller's time constant
REPORT_STEPS = 2000  # integration steps between two reports of progress
REST_SPEED = 1e-3  # rad/s: the fastest start that counts as at rest


@dataclass(frozen=True, eq=False)
class Controller:
    """Feed-forward of a model and a critically damped position loop, at ``n`` instants.

    τ = τ_ff + B (ω² (q_d − q) + 2ω (q̇_d − q̇)), saturated at the torque limits.
    """

    position: Array  # desired q_d, shape (n, nv)
    velocity: Array  # desired q̇_d, shape (n, nv)
    feedforward: Array  # τ_ff of the model for the desired motion, shape (n, nv)
    gain: (
        Array  # B, the mass matrix with a floor on its diagonal, shape (n, nv, nv)
    )
    limit: Array  # largest torque of each motor, shape (nv,)

    def __call__(self, k: int, q: Array, dq: Array) -> Array:
        """Torque at instant k in a state, shape (nv,)."""
        return np.clip(self.demand(k, q, dq), -self.limit, self.limit)

    def demand(self, k: int, q: Array, dq: Array) -> Array:
        """Torque at instant k in a state before saturation, shape (nv,)."""
        position = self.position[k] - q
        velocity = self.velocity[k] - dq
        error = BANDWIDTH**2 * position + 2 * BANDWIDTH * velocity
        return self.feedforward[k] + self.gain[k] @ error


def rigid_torque(model: pin.Model, q: Array, dq: Array, ddq: Array) -> Array:
    """Torque of rigid bodies in some states, each of shape (n, nv)."""
    data = model.createData()
    states = zip(q, dq, ddq, strict=True)
    return np.array([pin.rnea(model, data, *state) for state in states])


def tracking_controller(
    robot: Robot,
    believed: Truth,
    trajectory: Trajectory,
    t: Array,
) -> Controller:
    """Controller that would follow a trajectory exactly if what it believes were the arm.

    A joint that moves little inertia still gets the stiffness to bear 5 % of its torque limit
    at 0.01 rad. The controller will be asked at instants t, shape (n,) [s].
    """
    q, dq, ddq = (
        np.ascontiguousarray(trajectory(t, order), dtype=float)
        for order in range(3)
    )
    model = believed.model
    limit = robot.limits.torque
    data = model.createData()
    gain = np.array([pin.crba(model, data, pose).copy() for pose in q])
    feedforward = believed.drives.friction(dq) + rigid_torque(model, q, dq, ddq)
    floor = np.where(np.isfinite(limit), 0.05 * limit / 0.01, 0.0) / BANDWIDTH**2
    diagonal = np.einsum("kjj->kj", gain)
    np.maximum(diagonal, floor, out=diagonal)
    return Controller(q, dq, feedforward, gain, limit)


def simulate(
    robot: Robot,
    believed: Truth,
    truth: Truth,
    trajectory: Trajectory,
    duration: float,
    rate_hz: float,
    progress: Progress | None = None,
) -> Run:
    """Let the true arm follow a trajectory under a controller that believes another one.

    Args:
        robot: The arm, for its names and torque limits.
        believed: What the controller takes for the physics.
        truth: The physics of the arm.
        trajectory: Desired motion; starts at rest, where the arm starts too.
        duration: Length of the run [s].
        rate_hz: Rate at which the state is kept, every step where the recorder is late [Hz].
        progress: Called with the fraction done.

    Raises:
        BadInput: The trajectory starts in motion, or the arm could not follow it at all.
        BadRobot: A joint moves nothing that has mass.
    """
    start, speed = (trajectory(np.zeros(1), order)[0] for order in range(2))
    if np.abs(speed).max() > REST_SPEED:
        j = int(np.argmax(np.abs(speed)))
        raise BadInput(
            f"trajectory: joint {robot.joints[j]} starts at {speed[j]:.3g} rad/s; "
            "a virtual arm starts at rest, so lead in from rest"
        )
    substeps = int(np.ceil(1 / (rate_hz * LONGEST_STEP) - 1e-9))
    steps = substeps * int(np.floor(duration * rate_hz + 1e-6))
    if not steps:
        raise BadInput(f"virtual arm: {duration:g} s is shorter than one sample")
    h = 1 / (rate_hz * substeps)
    every = 1 if truth.recorder.delay.any() else substeps
    arm = Arm(truth, h)
    samples = []
    x = arm.at_rest(start)
    _require_mass(robot, arm.inertia(x))
    state = (x, np.zeros(len(x)), np.zeros(len(x)))
    for first in range(0, steps, REPORT_STEPS):
        count = min(REPORT_STEPS, steps - first)
        t = np.minimum((first + np.arange(2 * count + 1) / 2) * h, duration)
        control = tracking_controller(robot, believed, trajectory, t)
        for k in range(count):
            if (first + k) % every == 0:
                samples.append(arm.seen(state, control, 2 * k))
            state = arm.step(state, control, 2 * k + 1, (first + k + 0.5) * h)
        if not np.isfinite(state[0]).all():
            raise BadInput(
                f"trajectory: {robot.name} went unstable before t = {t[-1]:.3g} s; "
                "the motion asks more than its torque limits"
            )
        if progress is not None:
            progress((first + count) / steps)
    samples.append(arm.seen(state, control, 2 * count))
    channels = (
        np.array(values).reshape(-1, robot.nv)
        for values in zip(*samples, strict=True)
    )
    return Run(np.arange(len(samples)) / rate_hz * every / substeps, *channels)


def _require_mass(robot: Robot, M: Array) -> None:
    values, vectors = np.linalg.eigh(M)
    if values[0] <= 1e-12 * values[-1]:
        joint = robot.joints[int(np.argmax(np.abs(vectors[: robot.nv, 0])))]
        raise BadRobot(
            robot.source,
            f"joint {joint} moves nothing that has inertia; give its link a mass",
        )


class Arm:
    """The true arm, constants of its time step of length h [s], and the state of its bristles."""

    def __init__(self, truth: Truth, h: float) -> None:
        n = truth.nv
        self.truth = truth
        self.drives = truth.drives
        self.h = h
        self.n = n
        self.size = n + len(truth.gears)
        self.motor = np.arange(n)
        rotors = np.zeros(self.size)
        armature = np.array(truth.drives.rotor)
        for i, gear in enumerate(truth.gears, start=n):
            self.motor[gear.joint] = i
            rotors[i] = truth.drives.rotor[gear.joint] + gear.inertia
            armature[gear.joint] = 0.0
        # as an index: slices are faster
        self.driven = self.motor if truth.gears else slice(n)
        self.grid: Any = (self.driven, self.driven)
        if truth.gears:
            self.grid = np.ix_(self.motor, self.motor)
        self.model = truth.model.copy()
        self.model.armature = self.armature = armature
        self.data = self.model.createData()
        self.rotors = np.diag(rotors)
        self.rotors[self.grid] += truth.rotors
        shafts = np.zeros((len(truth.shafts), self.size))
        for row, shaft in zip(shafts, truth.shafts, strict=True):
            row[self.motor[list(shaft.joints)]] = 1.0, shaft.ratio
        self.G = np.vstack([np.eye(self.size), shafts])
        self.drag = shafts.T @ (
            np.array([s.viscous for s in truth.shafts])[:, None] * shafts
        )
        self.constant = self.rotors + h / 2 * self.drag
        self.constant[self.motor, self.motor] += h / 2 * truth.drives.viscous
        self.shaft_friction = h * np.array(
            [shaft.coulomb for shaft in truth.shafts]
        )
        self.bristles = [0.0] * len(truth.presliding)

    def inertia(self, x: Array) -> Array:
        """Mass matrix of the coordinates, shape (N, N) [kg·m²]."""
        M = self.rotors.copy()
        M[: self.n, : self.n] += pin.crba(self.model, self.data, x[: self.n])
        return M

    def at_rest(self, reading: Array) -> Array:
        """Coordinates where the encoders read this and elastic gears hold gravity."""
        motor = self.truth.encoder.position(reading)
        q = motor.copy()
        for _ in range(20 if self.truth.gears else 0):
            g = pin.computeGeneralizedGravity(self.model, self.data, q)
            for gear in self.truth.gears:
                q[gear.joint] = motor[gear.joint] - gear.deflection(
                    float(g[gear.joint])
                )
        return np.concatenate([q, [motor[gear.joint] for gear in self.truth.gears]])

    def read(self, x: Array, v: Array) -> tuple[Array, Array]:
        """Encoder readings."""
        return self.truth.encoder.reading(x[self.driven], v[self.driven])

    def seen(
        self, state: State, control: Controller, k: int
    ) -> tuple[Array, Array, Array, Array]:
        """Readings, their derivative, motor torque and link positions in a state."""
        x, v, _ = state
        q, dq = self.read(x, v)
        return q, dq, control(k, q, dq), x[: self.n]

    def step(self, state: State, control: Controller, k: int, t: float) -> State:
        """The state one step later."""
        h = self.h
        x, v, a = state
        middle = x + (h / 2) * v
        speed = v + (h / 2) * a
        demand = control.demand(k, *self.read(middle, v))
        K, passive, load = self._resistance(middle, speed, v, a, t)
        reaction = (BANDWIDTH + h / 4 * BANDWIDTH**2) * control.gain[k]
        reaction *= self.truth.encoder.scale
        bounds = self._dry(speed, t, load)

        def solved() -> Array:
            """Velocity change under motor torques that react to it."""
            mass = K.copy()
            impulse = -passive
            mass[self.grid] += h * reaction
            impulse[self.driven] += demand
            return velocity_change(mass, h * impulse, v, *bounds, self.G)

        dv = solved()
        torque = demand - reaction @ dv[self.driven]
        saturated = np.abs(torque) > control.limit
        if np.count_nonzero(saturated):
            reaction[saturated] = 0.0
            demand[saturated] = np.copysign(control.limit, torque)[saturated]
            dv = solved()
        for i, contact in enumerate(self.truth.presliding):
            moved = h * (v + dv / 2)[self.motor[contact.joint]]
            self.bristles[i] = contact.after(self.bristles[i], float(moved))
        return x + h * v + (h / 2) * dv, v + dv, dv / h

    def _resistance(
        self, x: Array, speed: Array, v: Array, a: Array, t: float
    ) -> tuple[Array, Array, Array]:
        """Mass matrix with damping, torque to overcome, and torque that the gears transmit."""
        n = self.n
        h = self.h
        truth = self.truth
        b = pin.nonLinearEffects(self.model, self.data, x[:n], speed[:n])
        M = pin.crba(self.model, self.data, x[:n])
        K = self.constant.copy()
        passive = np.zeros(self.size)
        K[:n, :n] += M
        passive[:n] = b
        passive[self.driven] += self.drives.viscous * v[self.driven]
        if truth.shafts:
            passive += self.drag @ v
        load = b + M @ a[:n] - self.armature * a[:n] if truth.dry else b.copy()
        if truth.loads:
            outer = self._outside(x, t)
            passive += outer
            load += outer[:n]
        for m, gear in enumerate(truth.gears, start=n):
            j = gear.joint
            torque, stiffness, damping = gear.torque(
                float(x[m] - x[j]), float(v[m] - v[j])
            )
            implicit = h * (h / 4 * stiffness + damping / 2)
            passive[m] += torque
            passive[j] -= torque
            K[[m, j], [m, j]] += implicit
            K[[m, j], [j, m]] -= implicit
            load[j] = torque
        for contact, force in zip(truth.presliding, self.bristles, strict=True):
            m = self.motor[contact.joint]
            ahead = contact.after(force, h / 2 * float(v[m]))
            passive[m] += ahead
            K[m, m] += h * h / 4 * contact.stiffness(ahead, float(v[m]))
        return K, passive, load

    def _outside(self, x: Array, t: float) -> Array:
        """Torque that loads take."""
        torque = np.zeros(self.size)
        for load in self.truth.loads:
            i = self.motor[load.joint] if load.on_motor else load.joint
            torque[i] += load.torque(float(x[i]), t)
        return torque

    def _dry(self, speed: Array, t: float, load: Array) -> tuple[Array, Array]:
        """Largest impulse of dry friction against either direction."""
        forward = np.zeros(self.size)
        forward[self.driven] = self.h * self.drives.level(speed[self.driven])
        backward = forward.copy()
        for law in self.truth.dry:
            m = self.motor[law.joint]
            v = abs(float(speed[m]))
            torque = float(load[law.joint])
            forward[m] += self.h * law.level(v, t, torque)
            backward[m] += self.h * law.level(-v, t, torque)
        if self.truth.dry:
            forward = np.maximum(forward, 0.0)
            backward = np.maximum(backward, 0.0)
        if self.truth.shafts:
            forward, backward = (
                np.append(x, self.shaft_friction) for x in (forward, backward)
            )
        return forward, backward


def velocity_change(
    K: Array, impulse: Array, v: Array, forward: Array, backward: Array, G: Array
) -> Array:
    """Solution of K δ = impulse − Gᵀλ, at once where nothing stops; see `stick_or_slip`."""
    w = G @ v
    sign = np.sign(w)
    friction = sign * np.where(w < 0, backward, forward)
    delta = dgesv(K, impulse - friction @ G)[2]  # without NumPy's overhead
    if np.count_nonzero((w + G @ delta) * sign <= 0):
        return stick_or_slip(K, impulse, v, forward, backward, G)
    return delta


def stick_or_slip(
    K: Array, impulse: Array, v: Array, forward: Array, backward: Array, G: Array
) -> Array:
    """Velocity change of one step with set-valued friction, by active sets.

    Solves K δ = impulse − Gᵀλ with −backward ≤ λ ≤ forward, where λ is at the bound that opposes
    motion for every contact i whose velocity (G (v + δ))_i is not zero.

    Args:
        K: Mass matrix with implicit damping, shape (N, N) [kg·m²].
        impulse: Impulse of everything but dry friction, shape (N,) [N·m·s].
        v: Velocity before, shape (N,) [rad/s].
        forward: Largest impulse of friction against positive motion, shape (c,) [N·m·s].
        backward: The same against negative motion.
        G: Velocity of each contact, of the N coordinates first, per v, shape (c, N).
    """
    A = np.linalg.inv(K)
    w = G @ v
    GA = G @ A
    S = GA @ G.T
    slip = np.sign(w)
    dry = np.maximum(forward, backward) > 0
    stuck = (slip == 0) & dry

    def balanced() -> tuple[Array, Array]:
        """Friction with which stuck contacts stay and the others slip, and the velocity change."""
        friction = np.where(slip < 0, -backward, forward * slip)
        friction[stuck] = 0.0
        if stuck.any():
            free = GA @ (impulse - friction @ G)
            among = S[np.ix_(stuck, stuck)]
            stopping = (free + w)[stuck]
            if len(w) == len(v):
                friction[stuck] = np.linalg.solve(among, stopping)
            else:  # redundant with shafts: the smallest impulses then
                friction[stuck] = np.linalg.lstsq(among, stopping)[0]
        delta = A @ (impulse - friction @ G)
        own = stuck[: len(v)]
        delta[own] = -v[own]
        return friction, delta

    for _ in range(4 * len(w)):
        friction, delta = balanced()
        excess = np.where(
            stuck, np.maximum(friction - forward, -backward - friction), -np.inf
        )
        worst = int(np.argmax(excess))
        if excess[worst] > 1e-12 * (1.0 + max(forward[worst], backward[worst])):
            stuck[worst] = False
            slip[worst] = np.sign(friction[worst])
            continue
        reversed_ = ~stuck & dry & ((w + G @ delta) * slip < 0)
        if not reversed_.any():
            return delta
        stuck |= reversed_
    # the sets alternate: those of the same friction as a bounded least-squares problem
    C = np.linalg.cholesky((A + A.T) / 2)
    momentum = C.T @ (impulse + K @ v)
    room = 1e-15 + 1e-12 * (forward + backward)
    side = scipy.optimize.lsq_linear(
        C.T @ G.T, momentum, (-backward - room, forward + room), "bvls"
    ).active_mask
    stuck = (side == 0) & dry
    slip = side
    return balanced()[1]
