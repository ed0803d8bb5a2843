"""Recordings of a simulated arm, by code of its own: products of 4x4 matrices, play sample by sample, clocks apart."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import lfilter

from cellapp.estimation.motion.streams import JointStream, PointStream, Recording
from tests.arms import UR10


@dataclass(frozen=True)
class Arm:
    """A true arm: rows (N, 5) with beta, tool (3,), base (4, 4), half play (N,), and its own joint error."""

    rows: np.ndarray
    tool: np.ndarray
    base: np.ndarray
    half_play: np.ndarray
    reach: float = 0.0
    """Travel over which gears take up their play [rad]: at once where it is zero."""
    cycles: float = 0.0
    amplitude: np.ndarray = field(default_factory=lambda: np.zeros(7))
    phase: np.ndarray = field(default_factory=lambda: np.zeros(7))
    lag_s: np.ndarray = field(default_factory=lambda: np.zeros(7))
    drag: np.ndarray = field(default_factory=lambda: np.zeros(7))
    """Most that grease holds each joint back, nearly reached beyond ``drag_speed`` [rad/s]."""
    drag_speed: float = 0.2
    time_constant: np.ndarray = field(default_factory=lambda: np.zeros(7))
    springs: dict[int, tuple[float, float]] = field(default_factory=dict)  # joint: natural frequency [Hz], damping

    def twist(self, motion, when):
        """What the load of a motion turns the joints by (m, N) at times (m,): nothing in a rigid arm."""
        return np.zeros_like(motion.at(when))

    def points(self, q):
        """SMR (n, 3) of the output angles ``q`` (n, N)."""
        T = np.broadcast_to(self.base, (len(q), 4, 4))
        for joint, (theta, d, a, alpha, beta) in enumerate(self.rows):
            T = T @ _turn_z(q[:, joint] + theta) @ _fixed(a, d, alpha, beta)
        return T[:, :3, :3] @ self.tool + T[:, :3, 3]


def _turn_z(angle):
    c, s, o, e = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([c, -s, o, o, s, c, o, o, o, o, e, o, o, o, o, e], axis=1).reshape(-1, 4, 4)


def _fixed(a, d, alpha, beta):
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    shift, x, y = np.eye(4), np.eye(4), np.eye(4)
    shift[:3, 3] = (a, 0.0, d)
    x[1:3, 1:3] = ((ca, -sa), (sa, ca))
    y[0, 0], y[0, 2], y[2, 0], y[2, 2] = cb, sb, -sb, cb
    return shift @ x @ y


def true_arm(rng, nominal=UR10, *, tool=(0.05, 0.03, 0.08), length=3e-4, angle=6e-4, half_play=None):
    """A nominal chain with errors, its base turned and shifted at random."""
    n = len(nominal)
    rows = np.column_stack([nominal, np.zeros(n)])
    rows[:, [0, 3]] += rng.normal(0.0, angle, (n, 2))
    rows[:, [1, 2]] += rng.normal(0.0, length, (n, 2))
    for joint in range(n - 1):
        if abs(np.sin(nominal[joint, 3])) < 0.1:
            rows[joint, 4] = rng.normal(0.0, angle)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    base = np.eye(4)
    base[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    base[:3, 3] = rng.normal(0.0, 2.0, 3)
    play = np.zeros(n) if half_play is None else np.asarray(half_play)
    return Arm(rows, np.asarray(tool), base, play)


@dataclass(frozen=True)
class Sweep:
    """A periodic trajectory: a few harmonics of a base frequency about a middle, by joint."""

    middle: np.ndarray
    frequency: np.ndarray  # (H,) [Hz]
    sine: np.ndarray  # (H, N) [rad]
    cosine: np.ndarray

    def at(self, t):
        angle = 2 * np.pi * np.outer(t, self.frequency)
        return self.middle + np.sin(angle) @ self.sine + np.cos(angle) @ self.cosine

    def speed(self, t):
        w = 2 * np.pi * self.frequency
        angle = np.outer(t, w)
        return np.cos(angle) @ (self.sine * w[:, None]) - np.sin(angle) @ (self.cosine * w[:, None])


def sweep(rng, joints, *, base_hz=0.02, harmonics=8, reach=1.0, speed=0.5):
    """A sweep with joint speeds up to ``speed`` [rad/s] and reach about ``reach`` [rad]."""
    frequency = base_hz * np.arange(1, harmonics + 1)
    sine = rng.normal(size=(harmonics, joints)) / np.arange(1, harmonics + 1)[:, None]
    cosine = rng.normal(size=(harmonics, joints)) / np.arange(1, harmonics + 1)[:, None]
    found = Sweep(rng.uniform(-1.0, 1.0, joints), frequency, sine, cosine)
    t = np.linspace(0.0, 1.0 / base_hz, 2000)
    scale = np.minimum(
        speed / np.abs(found.speed(t)).max(axis=0), reach / np.abs(found.at(t) - found.middle).max(axis=0)
    )
    return replace(found, sine=sine * scale, cosine=cosine * scale)


@dataclass(frozen=True)
class Corners:
    """From point to point (m, N), each way of the same time: a third of it speeding up, a third slowing down."""

    way: np.ndarray
    each_s: float

    def at(self, t):
        number, share = self._part(t)
        a = np.minimum(share, 1 / 3)
        done = 2.25 * a**2 + 1.5 * np.clip(share - 1 / 3, 0.0, 1 / 3)
        late = np.maximum(share - 2 / 3, 0.0)
        done += 1.5 * late - 2.25 * late**2
        return self.way[number] + done[:, None] * (self.way[number + 1] - self.way[number])

    def speed(self, t):
        number, share = self._part(t)
        rate = 4.5 * np.minimum(np.minimum(share, 1 / 3), 1 - share) / self.each_s
        return rate[:, None] * (self.way[number + 1] - self.way[number])

    def _part(self, t):
        place = np.clip(np.asarray(t) / self.each_s + 10.0, 0.0, len(self.way) - 1.001)
        number = place.astype(int)
        return number, place - number


def corners(rng, joints, seconds, *, each_s=1.5, reach=0.3):
    """Ways about a posture, each from rest to rest."""
    count = int(seconds / each_s) + 24
    return Corners(rng.uniform(-1.0, 1.0, joints) + rng.uniform(-reach, reach, (count, joints)), each_s)


def answered(arm, motion, when):
    """What time constants and springs add to the joints (m, N) at times (m,), by small steps."""
    dt = 5e-4
    t = np.arange(when[0] - 2.0, when[-1] + 2 * dt, dt)
    q = motion.at(t)
    found = np.zeros_like(q)
    middle = 0.5 * (q[1:] + q[:-1])
    for joint, T in enumerate(arm.time_constant[: q.shape[1]]):
        if T:  # x += (middle - x) (1 - exp(-dt / T))
            stays, x = np.exp(-dt / T), q[0, joint] - T * motion.speed(t[:1])[0, joint]
            late, _ = lfilter([1.0 - stays], [1.0, -stays], middle[:, joint], zi=[stays * x])
            found[1:, joint] += late - q[1:, joint]
    for joint, (hz, damping) in arm.springs.items():
        w, qdd = 2 * np.pi * hz, np.gradient(motion.speed(t)[:, joint], dt)
        slows = 1.0 - 2 * damping * w * dt  # v += dt (-qdd - 2 damping w v - w^2 y), then y += dt v
        found[1:, joint] += lfilter([-(dt**2)], [1.0, (w * dt) ** 2 - 1.0 - slows, slows], qdd[1:])
    return np.column_stack([np.interp(when, t, column) for column in found.T])


def lost_motion(q, half_play):
    """Output of gears with play (n, N): it stays until the input has crossed the gap."""
    out = q.copy()
    position = q[0].copy()
    for i in range(len(q)):
        position = np.minimum(np.maximum(position, q[i] - half_play), q[i] + half_play)
        out[i] = position
    return out


def gradual(q, half_play, reach):
    """Output of gears (n, N) that take their play up gradually: 20 plays in parallel, half of them wider than 1.7 times
    the reach, as the gamma distribution of two degrees has them."""
    shares = (np.arange(20) + 0.5) / 20
    x = np.linspace(0.0, 12.0, 4000)
    widths = reach * np.interp(shares, 1.0 - (1.0 + x) * np.exp(-x), x)
    many = np.repeat(q, len(widths), axis=1)
    gaps = np.tile(widths, q.shape[1])
    return q + half_play * ((lost_motion(many, gaps) - many) / gaps).reshape(len(q), q.shape[1], -1).mean(axis=2)


def correlated(rng, t, sigma, time_constant):
    """Noise (n, 3) with an exponential autocorrelation, at times ``t`` (n,)."""
    if sigma == 0.0:
        return np.zeros((len(t), 3))
    keep = np.exp(-np.diff(t, prepend=t[0] - 10 * time_constant) / time_constant)
    fresh = rng.normal(0.0, sigma, (len(t), 3)) * np.sqrt(1 - keep**2)[:, None]
    noise = np.zeros((len(t), 3))
    last = np.zeros(3)
    for i in range(len(t)):
        last = noise[i] = keep[i] * last + fresh[i]
    return noise


def record(
    rng,
    arm,
    motion,
    *,
    seconds=120.0,
    joint_hz=125.0,
    point_hz=100.0,
    offset=0.0178,
    rate_ppm=-18.0,
    white=15e-6,
    slow=40e-6,
    slow_s=0.3,
    with_speeds=True,
    name="sweep",
    joint_epoch=0.0,
    start_s=0.0,
):
    """One recording: stamps of the tracker are ``u + offset + rate (u - middle)``, u the controller's time."""
    u = np.arange(start_s - 2.0, start_s + seconds + 2.0, 1.0 / joint_hz)
    q, qd = motion.at(u), motion.speed(u)
    when = np.arange(start_s, start_s + seconds, 1.0 / point_hz)
    fine = np.unique(np.concatenate([u, when]))
    n = q.shape[1]
    speed = motion.speed(fine)
    q_fine = motion.at(fine) - speed * arm.lag_s[:n] - arm.drag[:n] * np.tanh(speed / arm.drag_speed)
    out = q_fine
    if arm.reach:
        out = gradual(q_fine, arm.half_play, arm.reach)
    elif arm.half_play.any():
        out = lost_motion(q_fine, arm.half_play)
    out = out[np.searchsorted(fine, when)]
    if arm.springs or arm.time_constant.any():
        out = out + answered(arm, motion, when)
    if arm.cycles:
        q_when = motion.at(when)
        out = out + arm.amplitude[:n] * np.sin(arm.cycles * q_when + arm.phase[:n])
    out = out + arm.twist(motion, when)
    p = arm.points(out) + rng.normal(0.0, white, (len(when), 3)) + correlated(rng, when, slow, slow_s)
    middle = (when[0] + when[-1]) / 2.0
    stamps = when + offset + 1e-6 * rate_ppm * (when - middle)
    joints = JointStream(time_s=u + joint_epoch, q=q, qd=qd if with_speeds else None)
    return Recording(name=name, arm="left", joints=joints, points=PointStream(time_s=stamps, p_M=p))
