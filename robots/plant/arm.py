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

from __future__ import annotations

import numpy as np
import pinocchio as pin

from excitant.robots.motion import Array
from excitant.robots.plant.controller import BANDWIDTH, Controller
from excitant.robots.plant.physics import Truth


class Arm:
    """The true arm, what its time step of length h needs, and what its hystereses remember.

    Args:
        truth: The physics of the arm.
        h: Length of a step [s].
    """

    def __init__(self, truth: Truth, h: float) -> None:
        n, gears = truth.nv, truth.gears
        self.truth, self.drives, self.h, self.n = truth, truth.drives, h, n
        self.size = n + len(gears)
        self.elastic = bool(gears)
        self.motor = np.arange(n)
        rotors, armature = np.zeros(self.size), np.array(truth.drives.rotor)
        for i, gear in enumerate(gears, start=n):
            self.motor[gear.joint] = i
            rotors[i] = truth.drives.rotor[gear.joint] + gear.inertia
            armature[gear.joint] = 0.0
        self.grid = np.ix_(self.motor, self.motor)
        self.model = truth.model.copy()
        self.model.armature = self.armature = armature
        self.data = self.model.createData()
        self.rotors = np.diag(rotors)
        self.rotors[self.grid] += truth.rotors
        self.constant = self.rotors.copy()
        self.constant[self.motor, self.motor] += h / 2 * truth.drives.viscous
        shafts = np.zeros((len(truth.shafts), self.size))
        for row, shaft in zip(shafts, truth.shafts, strict=True):
            row[self.motor[list(shaft.joints)]] = 1.0, shaft.ratio
        self.G = np.vstack([np.eye(self.size), shafts]) if truth.shafts else None
        self.drag = shafts.T @ (np.array([[s.viscous] for s in truth.shafts] or [[0.0]]) * shafts)
        self.constant += h / 2 * self.drag
        self.loaded = any(law.loaded for law in truth.dry)
        self.bristles = [0.0] * len(truth.presliding)
        self.memory = [0.0] * len(truth.forces)
        self.tip: Array | None = None

    def inertia(self, x: Array) -> Array:
        """Mass matrix of the coordinates, shape (N, N) [kg·m²]."""
        M = self.rotors.copy()
        M[: self.n, : self.n] += pin.crba(self.model, self.data, x[: self.n])
        return M

    def at_rest(self, reading: Array) -> Array:
        """Coordinates where the encoders read this and elastic gears hold gravity."""
        motor = self.truth.encoder.position(reading) if self.truth.distorted else reading
        q = np.array(motor)
        for _ in range(20 if self.elastic else 0):
            g = pin.computeGeneralizedGravity(self.model, self.data, q)
            for gear in self.truth.gears:
                q[gear.joint] = motor[gear.joint] - gear.deflection(float(g[gear.joint]))
        return np.concatenate([q, [motor[gear.joint] for gear in self.truth.gears]])

    def read(self, x: Array, v: Array) -> tuple[Array, Array]:
        """What the encoders read."""
        if self.elastic:
            x, v = x[self.motor], v[self.motor]
        return self.truth.encoder.reading(x, v) if self.truth.distorted else (x, v)

    def seen(
        self, state: tuple[Array, Array, Array], control: Controller, k: int
    ) -> tuple[Array, Array, Array, Array]:
        """Readings, their derivative, motor torque and link positions in a state."""
        q, dq = self.read(state[0], state[1])
        return q, dq, control(k, q, dq), state[0][: self.n]

    def step(
        self, x: Array, v: Array, a: Array, control: Controller, k: int, t: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Position, velocity and mean acceleration one step later."""
        h = self.h
        middle, speed = x + (h / 2) * v, v + (h / 2) * a
        wanted = control.wanted(k, *self.read(middle, v))
        K, passive, load = self._resistance(middle, speed, v, a, t)
        reaction: Array = (BANDWIDTH + h / 4 * BANDWIDTH**2) * control.gain[k]
        if self.truth.distorted:
            reaction = reaction * self.truth.encoder.scale
        forward, backward = self._dry(speed, t, load)
        dv = self._solve(K, passive, wanted, reaction, forward, v, backward)
        torque: Array = wanted - reaction @ (dv[self.motor] if self.elastic else dv)
        saturated = np.abs(torque) > control.limit
        if saturated.any():
            reaction[saturated] = 0.0
            wanted[saturated] = np.copysign(control.limit, torque)[saturated]
            dv = self._solve(K, passive, wanted, reaction, forward, v, backward)
        for i, contact in enumerate(self.truth.presliding):
            moved = h * (v + dv / 2)[self.motor[contact.joint]]
            self.bristles[i] = contact.after(self.bristles[i], float(moved))
        return x + h * v + (h / 2) * dv, v + dv, dv / h

    def _solve(
        self,
        K: Array,
        passive: Array,
        wanted: Array,
        reaction: Array,
        forward: Array,
        v: Array,
        backward: Array | None,
    ) -> Array:
        """Velocity change under motor torques that react to it."""
        h = self.h
        if not self.elastic:
            return velocity_change(
                K + h * reaction, h * (wanted - passive), forward, v, backward, self.G
            )
        K, impulse = K.copy(), -h * passive
        K[self.grid] += h * reaction
        impulse[self.motor] += h * wanted
        return velocity_change(K, impulse, forward, v, backward, self.G)

    def _resistance(
        self, x: Array, speed: Array, v: Array, a: Array, t: float
    ) -> tuple[Array, Array, Array]:
        """Mass matrix with implicit parts, torque but for dry friction, and transmitted torque."""
        n = self.n
        b = pin.nonLinearEffects(self.model, self.data, x[:n], speed[:n])
        M = pin.crba(self.model, self.data, x[:n])
        if not self.elastic:
            K, passive = M + self.constant, self.drives.viscous * v + b
        else:
            K, passive = self.constant.copy(), np.zeros(self.size)
            K[:n, :n] += M
            passive[:n] = b
            passive[self.motor] += self.drives.viscous * v[self.motor]
        if self.G is not None:
            passive += self.drag @ v
        load = np.array(b) if self.elastic else b
        if self.loaded:
            load = b + M @ a[:n] - self.armature * a[:n]
        outer = self._outside(x, v, t)
        if outer is not None:
            passive += outer
            load = load + outer[:n]
        self._gears(x, v, K, passive, load)
        self._bristle(v, K, passive)
        return K, passive, load

    def _outside(self, x: Array, v: Array, t: float) -> Array | None:
        """Torque that loads and forces on the tip take."""
        truth = self.truth
        if not (truth.loads or truth.forces):
            return None
        torque = np.zeros(self.size)
        for load in truth.loads:
            i = self.motor[load.joint] if load.on_motor else load.joint
            torque[i] += load.torque(float(x[i]), t)
        if truth.forces:
            torque[: self.n] -= self._tip_torque(x[: self.n], v[: self.n])
        return torque

    def _tip_torque(self, q: Array, dq: Array) -> Array:
        """Joint torque of the forces on the tip; their memory moves on."""
        frame = self.truth.tip
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacement(self.model, self.data, frame)
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.getFrameJacobian(self.model, self.data, frame, world)[:3]
        place = np.array(self.data.oMf[frame].translation)
        before, self.tip = (place if self.tip is None else self.tip), place
        total, velocity = np.zeros(3), J @ dq
        for i, force in enumerate(self.truth.forces):
            self.memory[i] = force.remember(self.memory[i], before, place)
            total += force.force(place, velocity, self.memory[i])
        torque: Array = J.T @ total
        return torque

    def _gears(self, x: Array, v: Array, K: Array, passive: Array, load: Array) -> None:
        """Torque of elastic gears, between motor m and link j, added in place."""
        for m, gear in enumerate(self.truth.gears, start=self.n):
            j = gear.joint
            torque, stiffness, damping = gear.torque(float(x[m] - x[j]), float(v[m] - v[j]))
            implicit = self.h * (self.h / 4 * stiffness + damping / 2)
            passive[m] += torque
            passive[j] -= torque
            for row, column, sign in ((m, m, 1), (j, j, 1), (m, j, -1), (j, m, -1)):
                K[row, column] += sign * implicit
            load[j] = torque

    def _bristle(self, v: Array, K: Array, passive: Array) -> None:
        """Torque of presliding, half a step ahead, added in place."""
        h = self.h
        for contact, force in zip(self.truth.presliding, self.bristles, strict=True):
            m = self.motor[contact.joint]
            ahead = contact.after(force, h / 2 * float(v[m]))
            passive[m] += ahead
            K[m, m] += h * h / 4 * contact.stiffness(ahead, float(v[m]))

    def _dry(self, speed: Array, t: float, load: Array) -> tuple[Array, Array | None]:
        """Largest impulse of dry friction against either direction; None where both are equal."""
        if self.elastic:
            forward = np.zeros(self.size)
            forward[self.motor] = self.h * self.drives.level(speed[self.motor])
        else:
            forward = self.h * self.drives.level(speed)
        backward = forward.copy() if self.truth.dry else None
        for law in self.truth.dry:
            m = self.motor[law.joint]
            v, torque = abs(float(speed[m])), float(load[law.joint])
            forward[m] += self.h * law.level(v, t, torque)
            if backward is not None:
                backward[m] += self.h * law.level(-v, t, torque)
        if backward is not None:
            np.maximum(forward, 0.0, out=forward)
            np.maximum(backward, 0.0, out=backward)
        if self.truth.shafts:
            further = self.h * np.array([shaft.coulomb for shaft in self.truth.shafts])
            forward = np.concatenate([forward, further])
            backward = None if backward is None else np.concatenate([backward, further])
        return forward, backward


def velocity_change(
    K: Array,
    impulse: Array,
    forward: Array,
    v: Array,
    backward: Array | None = None,
    G: Array | None = None,
) -> Array:
    """Solution of K δ = impulse − Gᵀλ, at once where nothing stops; see `stick_or_slip`."""
    w = v if G is None else G @ v
    sign = np.sign(w)
    dry = forward * sign if backward is None else np.where(w < 0, -backward, forward * sign)
    delta = np.asarray(
        np.linalg.solve(K, impulse - (dry if G is None else dry @ G)), dtype=np.float64
    )
    stops = (w + (delta if G is None else G @ delta)) * sign <= 0
    return stick_or_slip(K, impulse, forward, v, backward, G) if stops.any() else delta


def stick_or_slip(
    K: Array,
    impulse: Array,
    forward: Array,
    v: Array,
    backward: Array | None = None,
    G: Array | None = None,
) -> Array:
    """Velocity change of one step with set-valued friction, by active sets.

    Solves K δ = impulse − Gᵀλ with −backward ≤ λ ≤ forward, where λ is at the bound that opposes
    motion for every contact i whose velocity (G (v + δ))_i is not zero.

    Args:
        K: Mass matrix with implicit damping, shape (N, N) [kg·m²].
        impulse: Impulse of everything but dry friction, shape (N,) [N·m·s].
        forward: Largest impulse of friction against positive motion, shape (c,) [N·m·s].
        v: Velocity before, shape (N,) [rad/s].
        backward: The same against negative motion; ``forward`` when not given.
        G: Velocity of each contact per velocity of the arm, shape (c, N), where the first N
            contacts are those of the coordinates; these alone when not given.

    Returns:
        δ, shape (N,).
    """
    backward = forward if backward is None else backward
    A: Array = np.asarray(np.linalg.inv(K), dtype=np.float64)
    w, S, GA = (v, A, A) if G is None else (G @ v, G @ A @ G.T, G @ A)
    slip = np.sign(w)
    dry = np.maximum(forward, backward) > 0
    stuck = (slip == 0) & dry
    for _ in range(4 * len(w)):
        friction = np.where(slip < 0, -backward, forward * slip)
        friction[stuck] = 0.0
        if stuck.any():
            free = GA @ (impulse - (friction if G is None else friction @ G))
            friction[stuck] = _holding(S[np.ix_(stuck, stuck)], (free + w)[stuck], G is None)
        delta: Array = A @ (impulse - (friction if G is None else friction @ G))
        own = stuck[: len(v)]
        delta[own] = -v[own]
        excess = np.where(stuck, np.maximum(friction - forward, -backward - friction), -np.inf)
        worst = int(np.argmax(excess))
        if excess[worst] > 1e-12 * (1.0 + max(forward[worst], backward[worst])):
            stuck[worst], slip[worst] = False, np.sign(friction[worst])
            continue
        after = w + (delta if G is None else G @ delta)
        reversed_ = ~stuck & dry & (after * slip < 0)
        if not reversed_.any():
            break
        stuck |= reversed_
    return delta


def _holding(S: Array, velocity: Array, regular: bool) -> Array:
    """Impulses that stop these contacts; the smallest where they are not unique."""
    solve = np.linalg.solve(S, velocity) if regular else np.linalg.lstsq(S, velocity)[0]
    return np.asarray(solve, dtype=np.float64)
