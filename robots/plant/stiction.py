"""Set-valued dry friction: which joints stick in a time step, and which slip."""

from __future__ import annotations

import numpy as np

from excitant.robots.motion import Array


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
