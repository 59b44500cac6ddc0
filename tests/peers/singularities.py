"""How well a continuous correction with bounded slope can do near singularities, and which closed-form law comes close.

The corrected command is q + Δ(q) with J(q) Δ = e(q), e the pose error between the nominal and the true arm. Near a singularity the exact Δ grows without bound. This study asks two things of every built-in arm and each of its
singularities, on paths through and along them:

- the oracle: what constrained least squares (Clarabel) leave over a whole path when the slope |dΔ|/|dq| is bounded.
  It knows the path ahead, so no law of the joints alone can do better in its cost. Nothing of the product is used.
- the laws: what closed forms, functions of one pose only, leave on the same paths, and their largest slope.

The true arms are drawn: every fixed frame of the chain is moved by a random twist, joints deflect smoothly, and base and
tool are fitted as the product's gauge does. Kinematics, fit and laws are this file's own.

    python3 -m venv venv && venv/bin/pip install numpy scipy clarabel
    OMP_NUM_THREADS=1 venv/bin/python tests/peers/singularities.py > tables.md

prints Markdown tables, in four minutes on one core; --parts laws takes one.
"""

import argparse
import pathlib
import sys
import time
import tomllib
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

ROBOTS = pathlib.Path(__file__).parents[2] / "calibration" / "robots"
ARMS = ["abb-irb120", "abb-irb4400", "abb-irb4400-serial", "kuka-iiwa7", "ur5", "ur10"]

# The true arms.
DRAWS = 3
FRAME_SIGMA = 0.78e-3  # m and rad, per component
DEFLECTION = 0.5e-3  # rad, about the largest
TOOL_LENGTH = 0.12  # m

# Paths.
POINTS = 301
HALF_LENGTH = 0.5  # rad of the joint that makes the arm singular
NEAREST, FARTHEST = np.radians(0.5), np.radians(6.0)
THROUGH, ALONG = 20, 10

# What is asked of a law.
MAX_CHANGE = 0.1  # rad
EXACT_FROM = 0.15  # smallest singular value, 1 m = 1 rad
SLOPES = [0.15, 0.5, 1.0, 50.0]
ORACLE_WEIGHT = 0.02  # m per rad
ROTATION_SLACK = 1e-4  # rad
POSITION_SLACK = 1e-6  # m


# Kinematics, for many poses at once.


def skew(v):
    zero = np.zeros(v.shape[:-1])
    x, y, z = np.moveaxis(v, -1, 0)
    rows = [np.stack(row, -1) for row in ([zero, -z, y], [z, zero, -x], [-y, x, zero])]
    return np.stack(rows, -2)


def rotation(vector):
    """Rotation by a rotation vector (…, 3), Rodrigues."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    k = skew(vector)
    # The limits of sin(x)/x and (1 − cos x)/x² at zero: numpy's sinc is of πx.
    return np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (k @ k)


def rotation_vector(r):
    """The inverse for small angles: exact to third order."""
    vee = 0.5 * np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], -1)
    sine = np.linalg.norm(vee, axis=-1, keepdims=True)
    return vee * (1 + sine**2 / 6)


def frame(rotation_part=None, translation=(0, 0, 0)):
    pose = np.eye(4)
    if rotation_part is not None:
        pose[:3, :3] = rotation_part
    pose[:3, 3] = translation
    return pose


def origin_of(table):
    roll, pitch, yaw = np.radians(table.get("rpy_deg", [0, 0, 0]))
    turn = rotation(np.array([0, 0, yaw])) @ rotation(np.array([0, pitch, 0])) @ rotation(np.array([roll, 0, 0]))
    return frame(turn, table.get("xyz_m", [0, 0, 0]))


@dataclass
class Chain:
    """Fixed frames before each joint and one behind the last; a joint turns about its axis."""

    frames: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray

    def places(self, joints):
        """(pose of the tool, axes, points on the axes) at the controller's joints (…, n), in the base frame."""
        serial = joints @ self.coupling.T
        pose = np.broadcast_to(self.frames[0], (*joints.shape[:-1], 4, 4))
        axes, points = [], []
        for i, axis in enumerate(self.axes):
            axes.append(pose[..., :3, :3] @ axis)
            points.append(pose[..., :3, 3])
            turn = np.zeros((*joints.shape[:-1], 4, 4))
            turn[..., :3, :3] = rotation(serial[..., i, None] * axis)
            turn[..., 3, 3] = 1
            pose = pose @ turn @ self.frames[i + 1]
        return pose, np.stack(axes, -2), np.stack(points, -2)

    def jacobian(self, joints):
        """Linear part first, of the tool point, of the controller's joints."""
        pose, axes, points = self.places(joints)
        linear = np.cross(axes, pose[..., None, :3, 3] - points)
        return np.swapaxes(np.concatenate([linear, axes], -1), -1, -2) @ self.coupling

    def with_tool(self, tool):
        return Chain(np.concatenate([self.frames[:-1], [self.frames[-1] @ tool]]), self.axes, self.coupling)


def read(name):
    """(chain, lower limits, upper limits) of a built-in arm; more than a turn is a turn."""
    table = tomllib.loads((ROBOTS / f"{name}.toml").read_text())
    joints = table["joint"]
    pending = origin_of(table.get("base", {}).get("origin", {}))
    frames, axes = [], []
    for joint in joints:
        assert joint["kind"] == "revolute"
        if table["convention"] == "poe":
            frames.append(pending @ origin_of(joint["origin"]))
            axis = np.array(joint["axis"], float)
            axes.append(axis / np.linalg.norm(axis))
            pending = np.eye(4)
        else:
            assert table["convention"] == "dh" and "beta_deg" not in joint
            offset = np.radians(joint.get("theta_offset_deg", 0))
            frames.append(pending @ frame(rotation(np.array([0, 0, offset]))))
            axes.append(np.array([0.0, 0, 1]))
            alpha = np.radians(joint["alpha_deg"])
            pending = frame(rotation(np.array([alpha, 0, 0])), [joint["a_m"], 0, joint["d_m"]])
    frames.append(pending @ origin_of(table.get("flange", {}).get("origin", {})))
    limits = np.radians([joint["limits_deg"] for joint in joints]).T
    coupling = np.array(table.get("coupling", np.eye(len(joints))), float)
    return Chain(np.array(frames), np.array(axes), coupling), *np.clip(limits, -np.pi, np.pi)


@dataclass
class Pair:
    """A nominal arm and a true one, base and tool of the nominal one fitted."""

    nominal: Chain
    true: Chain
    waves: tuple

    def deflected(self, joints):
        gains, phases, amplitudes = self.waves
        return joints + np.sin(np.einsum("...j,ikj->...ik", joints, gains) + phases) @ amplitudes

    def error(self, joints, change=0.0):
        """Twist that takes the true arm at q + change to the nominal arm at q."""
        wanted = self.nominal.places(joints)[0]
        found = self.true.places(self.deflected(joints + change))[0]
        turn = wanted[..., :3, :3] @ np.swapaxes(found[..., :3, :3], -1, -2)
        return np.concatenate([wanted[..., :3, 3] - found[..., :3, 3], rotation_vector(turn)], -1)

    def jacobian(self, joints):
        return self.true.jacobian(self.deflected(joints))


def draw(chain, lower, upper, random):
    """A true arm whose base and tool are fitted to the nominal one's, as the gauge does."""
    direction = random.normal(size=3)
    nominal = chain.with_tool(frame(None, TOOL_LENGTH * direction / np.linalg.norm(direction)))
    moved = []
    for before in nominal.frames:
        twist = FRAME_SIGMA * random.normal(size=6)
        moved.append(before @ frame(rotation(twist[3:]), twist[:3]))
    true = Chain(np.array(moved), nominal.axes, nominal.coupling)
    # Three waves of the second to fourth joint for each joint: gravity's loads are of that kind.
    joints = len(lower)
    gains = np.zeros((joints, 3, joints))
    gains[:, :, 1:4] = random.integers(-1, 2, size=(joints, 3, 3))
    phases = random.uniform(0, 2 * np.pi, (joints, 3))
    pair = Pair(nominal, true, (gains, phases, DEFLECTION / 3 * np.ones(3)))
    sample = random.uniform(lower, upper, (500, joints))
    for _ in range(3):
        error = pair.error(sample)
        pose = pair.nominal.places(sample)[0]
        # A twist of the base frame at the origin and one at the tool: how they move tool point and rotation.
        base = np.zeros((500, 6, 6))
        base[:, :3, :3] = base[:, 3:, 3:] = np.eye(3)
        base[:, :3, 3:] = -skew(pose[:, :3, 3])
        tool = np.zeros((500, 6, 6))
        tool[:, :3, :3] = tool[:, 3:, 3:] = pose[:, :3, :3]
        both = np.concatenate([base, tool], -1).reshape(-1, 12)
        fitted = np.linalg.lstsq(both, -error.reshape(-1), rcond=None)[0]
        frames = pair.nominal.frames.copy()
        frames[0] = frame(rotation(fitted[3:6]), fitted[:3]) @ frames[0]
        frames[-1] = frames[-1] @ frame(rotation(fitted[9:]), fitted[6:9])
        pair.nominal = Chain(frames, nominal.axes, nominal.coupling)
    return pair


# Singularities.


def wrist(chain, serial, name):
    """Zero where the wrist is singular."""
    return np.sin(serial[..., 4])


def elbow(chain, serial, name):
    """Triple product of the shoulder's and elbow's axes and what is carried: zero when stretched or folded."""
    if name == "kuka-iiwa7":
        return np.sin(serial[..., 3])
    _, axes, points = chain.places(serial @ np.linalg.inv(chain.coupling).T)
    carried = 3 if name.startswith("ur") else 4
    upper, fore = points[..., 2, :] - points[..., 1, :], points[..., carried, :] - points[..., 2, :]
    return np.sum(np.cross(upper, fore) * axes[..., 1, :], -1) / (
        np.linalg.norm(np.cross(upper, axes[..., 1, :]), axis=-1)
        * np.linalg.norm(np.cross(fore, axes[..., 1, :]), axis=-1)
    )


def shoulder(chain, serial, name):
    """Distance of the wrist centre from the plane of axis 1 and the direction of axis 2."""
    _, axes, points = chain.places(serial @ np.linalg.inv(chain.coupling).T)
    normal = np.cross(axes[..., 0, :], axes[..., 1, :])
    return np.sum((points[..., 5, :] - points[..., 0, :]) * normal, -1)


# Function and the serial joint that is turned to make it zero.
KINDS = {"wrist": (wrist, 4), "elbow": (elbow, 2), "shoulder": (shoulder, 1)}
# Seven joints: two of the three need two joints to be right, (joint, value).
PINNED = {
    "elbow": ([], 3),
    "shoulder": ([(1, 0.0), (2, np.pi / 2)], 1),
    "wrist": ([(5, 0.0), (4, np.pi / 2)], 5),
}


def onto(function, chain, name, serial, turned):
    """The nearest zero of a singularity's function, by secants in one serial joint; NaN where none is found."""
    grid = np.linspace(-np.pi, np.pi, 181)
    many = np.repeat(serial[..., None, :], len(grid), -2)
    many[..., turned] = serial[..., turned, None] + grid
    values = function(chain, many, name)
    crossing = np.signbit(values[..., 1:]) != np.signbit(values[..., :-1])
    distance = np.where(crossing, np.abs(grid[1:] + grid[:-1]), np.inf)
    at = np.argmin(distance, -1)
    there = np.isfinite(np.min(distance, -1))
    low, high = grid[at], grid[at + 1]
    out = serial.copy()

    def value(shift):
        out[..., turned] = serial[..., turned] + shift
        return function(chain, out, name)

    at_low = value(low)
    for _ in range(45):
        middle = 0.5 * (low + high)
        same = np.signbit(value(middle)) == np.signbit(at_low)
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    out[..., turned] = np.where(there, serial[..., turned] + low, np.nan)
    return out


@dataclass
class Path:
    kind: str
    through: bool
    pair: int
    joints: np.ndarray  # (points, n), the controller's


def smallest_singular_value(jacobian):
    return np.linalg.svd(jacobian, compute_uv=False)[..., -1]


def paths(name, chain, lower, upper, pairs, kind, random, through, along):
    """Paths of one kind: straight ones through the singularity, and ones that keep a distance of it."""
    function, turned = KINDS[kind]
    pinned = []
    if len(lower) == 7:
        pinned, turned = PINNED[kind]
    n, inverse = len(lower), np.linalg.inv(chain.coupling)
    parameter = np.linspace(-1, 1, POINTS)[:, None]

    def settled(joints):
        serial = joints @ chain.coupling.T
        if pinned:
            for joint, value in pinned:
                serial[..., joint] = value
        else:
            serial = onto(function, chain, name, serial, turned)
        return serial @ inverse.T

    middles = settled(random.uniform(lower, upper, (3000, n)))
    inside = (middles > lower).all(-1) & (middles < upper).all(-1)
    found = []
    for middle in middles[inside]:
        if len(found) == through + along:
            break
        direction = HALF_LENGTH * random.uniform(-1, 1, n)
        is_through = sum(p.through for p in found) < through
        if is_through:
            serial_direction = chain.coupling @ direction
            serial_direction[turned] = HALF_LENGTH * random.choice([-1, 1])
            joints = middle + parameter * (inverse @ serial_direction)
        else:
            joints = middle + parameter * direction
            few = settled(joints[:: POINTS // 6])
            if np.isnan(few).any() or (few < lower).any() or (few > upper).any():
                continue
            joints = settled(joints)
            distance = random.uniform(NEAREST, FARTHEST) * random.choice([-1, 1])
            joints = joints + inverse[:, turned] * distance
            if not pinned and np.max(np.abs(np.diff(joints, axis=0))) > 0.02:
                continue
        if np.isnan(joints).any() or (joints < lower).any() or (joints > upper).any():
            continue
        pair = len(found) % DRAWS
        singular = smallest_singular_value(pairs[pair].jacobian(joints))
        if is_through and singular.min() > 0.01:
            continue
        found.append(Path(kind, is_through, pair, joints))
    return found


# Laws: (J, e, limits, usual) of many poses to Δ. J is of metres and radians; limits are the 95th percentiles of the
# arms' rotation without correction, usual ones its root mean square.


def gain_linear(sigma, threshold):
    return np.where(sigma >= threshold, 1 / np.maximum(sigma, threshold), sigma / threshold**2)


def bounded(change):
    return change * np.minimum(1, MAX_CHANGE / np.maximum(np.abs(change).max(-1, keepdims=True), 1e-12))


def solved_damped(j, e, damping):
    n = j.shape[-1]
    if n > 6:
        return np.swapaxes(j, -1, -2) @ np.linalg.solve(
            j @ np.swapaxes(j, -1, -2) + damping[..., None, None] * np.eye(6), e[..., None]
        )
    gram = np.swapaxes(j, -1, -2) @ j + damping[..., None, None] * np.eye(n)
    return np.linalg.solve(gram, np.swapaxes(j, -1, -2) @ e[..., None])


def weighted(j, e, weight):
    rows = np.ones((*e.shape[:-1], 6))
    rows[..., 3:] = np.asarray(weight)[..., None]
    return rows[..., None] * j, rows * e


def today(j, e, limits, usual):
    """λ = 1e-6; where a joint would change by more than allowed, or the position gets worse, nothing."""
    change = solved_damped(j, e, np.full(e.shape[:-1], 1e-6))[..., 0]
    left = residual(j, e, change)
    worse = np.linalg.norm(left[..., :3], axis=-1) > np.linalg.norm(e[..., :3], axis=-1)
    refused = worse | (np.abs(change).max(-1) > MAX_CHANGE)
    return np.where(refused[..., None], 0, change)


def damping_only(threshold, most):
    def law(j, e, limits, usual):
        sigma = smallest_singular_value(j)
        damping = most * np.maximum(0, 1 - (sigma / threshold) ** 2) ** 2
        return bounded(solved_damped(j, e, damping)[..., 0])

    return law


def smoothstep(x):
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def fading_weight(threshold, most, high, low):
    def law(j, e, limits, usual):
        sigma = smallest_singular_value(j)
        weight = low * (high / low) ** smoothstep((sigma - 0.10) / 0.05)
        damping = most * np.maximum(0, 1 - (sigma / threshold) ** 2) ** 2
        jw, ew = weighted(j, e, weight)
        return bounded(solved_damped(jw, ew, damping * (weight / 1.0) ** 2)[..., 0])

    return law


def spectral(weight, threshold):
    def law(j, e, limits, usual):
        jw, ew = weighted(j, e, np.full(e.shape[:-1], weight))
        u, sigma, vt = np.linalg.svd(jw, full_matrices=False)
        parts = gain_linear(sigma, threshold) * (np.swapaxes(u, -1, -2) @ ew[..., None])[..., 0]
        return bounded((np.swapaxes(vt, -1, -2) @ parts[..., None])[..., 0])

    return law


def filtered_inverse(j, threshold):
    u, sigma, vt = np.linalg.svd(j, full_matrices=False)
    return np.swapaxes(vt, -1, -2) @ (gain_linear(sigma, threshold)[..., None] * np.swapaxes(u, -1, -2))


def priority(position_threshold, rotation_threshold):
    def law(j, e, limits, usual):
        jp, jr = j[..., :3, :], j[..., 3:, :]
        first = (filtered_inverse(jp, position_threshold) @ e[..., :3, None])[..., 0]
        u, sigma, vt = np.linalg.svd(jp)
        free = np.swapaxes(vt[..., 3:, :], -1, -2)
        rest = e[..., 3:] - (jr @ first[..., None])[..., 0]
        second = free @ (filtered_inverse(jr @ free, rotation_threshold) @ rest[..., None])
        return bounded(first + second[..., 0])

    return law


def residual(j, e, change):
    return e - (j @ change[..., None])[..., 0]


def oblique(length, threshold, share):
    """Each direction of J inverted; what the small singular values cannot bring is left where it hurts least.

    A radian counts `length`. With h the filter, S = 1 − h and u·e = c, any r with u·r = S c may be left over: `share`
    gives the metric M by which it is chosen, r = M u S c / (u·M u). Functions of J Jᵀ, so directions may cross."""

    def law(j, e, limits, usual):
        weights = np.repeat([1.0, length], 3)
        e = weights * e
        u, sigma, vt = np.linalg.svd(weights[:, None] * j, full_matrices=False)
        ut = np.swapaxes(u, -1, -2)
        gain = gain_linear(sigma, threshold(j, u, (ut @ e[..., None])[..., 0], length))
        shares = 1 - sigma * gain
        metric = share(u[..., -1], e, limits * length)
        root = (u * np.sqrt(shares)[..., None, :]) @ ut
        middle = root @ (metric[..., None] * root)
        size = np.trace(middle, axis1=-2, axis2=-1) / np.maximum(shares.sum(-1), 1e-12)
        middle = middle + np.maximum(size, 1e-9)[..., None, None] * ((u * (1 - shares)[..., None, :]) @ ut)
        left = metric * (root @ np.linalg.solve(middle + 1e-12 * np.eye(6), root @ e[..., None]))[..., 0]
        parts = gain * ((ut @ (e - left)[..., None])[..., 0] + shares * (ut @ e[..., None])[..., 0])
        return bounded((np.swapaxes(vt, -1, -2) @ parts[..., None])[..., 0])

    return law


def constant(threshold):
    return lambda j, u, c, length: threshold


def by_lever(slope, error):
    """√(error · lever / slope): where an error over t², times what σ changes by in a radian, is the slope."""

    def threshold(j, u, c, length):
        lever = np.linalg.norm(j[..., :3, :], axis=-2).max(-1)
        return np.sqrt(error * lever / slope)[..., None]

    return threshold


def halves(u, e, limits):
    """(|e_p|, the largest rotation that may be left, |u_p|, |u_r|)"""
    def norm(v):
        return np.maximum(np.linalg.norm(v, axis=-1), 1e-9)

    return norm(e[..., :3]), np.maximum(norm(e[..., 3:]), limits), norm(u[..., :3]), norm(u[..., 3:])


def as_metric(position, turn):
    most = np.maximum(position, turn)
    return np.repeat(np.stack([position / most, turn / most], -1), 3, -1)


def balanced_share(u, e, limits):
    """Position and rotation lose the same part of what they may."""
    position, turn, up, ur = halves(u, e, limits)
    return as_metric(position / up, turn / ur)


def rotation_first_share(part):
    """Rotation loses first, up to `part` of what it may; the position only what is beyond."""

    def share(u, e, limits):
        position, turn, up, ur = halves(u, e, limits)
        c = np.abs(np.sum(u * e, -1))
        lost = np.minimum(c, part * turn * ur)
        return as_metric((c - lost) / up**2 + 1e-9, lost / ur**2 + 1e-9)

    return share


def guarded(law):
    """Δ scaled down, continuously, until neither part of the error is above what it may be."""

    def scaled(j, e, limits, usual):
        change = law(j, e, limits, usual)
        moved = -(j @ change[..., None])[..., 0]
        out = np.ones(e.shape[:-1])
        allowed = [np.linalg.norm(e[..., :3], axis=-1), np.maximum(np.linalg.norm(e[..., 3:], axis=-1), limits)]
        for part, most in zip((slice(0, 3), slice(3, 6)), allowed):
            # |e + α d|² = most², the larger root.
            d, at = moved[..., part], e[..., part]
            a, b = np.sum(d * d, -1), np.sum(d * at, -1)
            c = np.sum(at * at, -1) - most**2
            root = (-b + np.sqrt(np.maximum(b * b - a * c, 0))) / np.maximum(a, 1e-18)
            out = np.minimum(out, np.where(a > 1e-18, np.maximum(root, 0), 1))
        return out[..., None] * change

    return scaled


# The law that is built: runtime/src/correct/step_limit.rs, and the later step of runtime/src/correct/mod.rs at the same J.

SHIFT_LIMIT, TURN_DAMPING, SHIFT_DAMPING, HELD, LEAST_USUAL = 0.3, 20.0, 0.8, 2.0, 5e-4
POSITION_FLOOR, ROTATION_FLOOR = 5e-5, 2e-5
HOLD, SHIFT_ROUNDS, TAKEN, LEAST_PUSH, ROOM, LEAST_ROOM = 1e-4, 3, 0.9, 0.5e-6, 1.15, 8e-5


def across(matrix, vector):
    return (matrix @ vector[..., None])[..., 0]


def transposed(matrix):
    return np.swapaxes(matrix, -1, -2)


def norm(vector):
    return np.linalg.norm(vector, axis=-1)


def plus(matrix, damping):
    return matrix + np.asarray(damping)[..., None, None] * np.eye(3)


def solved(matrix, damping, vector):
    return np.linalg.solve(plus(matrix, damping), vector[..., None])[..., 0]


def least_eigenvalue(matrix, damping):
    """Between a third of it and itself."""
    return 1 / np.trace(np.linalg.inv(plus(matrix, damping)), axis1=-2, axis2=-1)


def largest_share(before, left, most):
    """The largest share of a step, up to 1, after which the error is at most `most`, if the whole step leaves `left`."""
    motion = left - before
    square, along = np.sum(motion**2, -1), np.sum(motion * before, -1)
    slack = np.maximum(most**2 - np.sum(before**2, -1), 0)
    share = slack / np.maximum(along + np.sqrt(np.maximum(along**2 + square * slack, 0)), 1e-300)
    return np.where(norm(left) > most, np.minimum(share, 1), 1)[..., None]


def damping_at(matrix, floor, largest):
    """The damping at a pose where the arm moves its target as the matrix says."""
    lacks = np.maximum(1 - least_eigenvalue(matrix, np.full(largest.shape, floor)) / (HELD * largest), 0)
    return floor + largest * lacks**2


def position_first(j, e, limits, usual):
    gram = j @ transposed(j)
    a, b, c = gram[..., :3, :3], gram[..., :3, 3:], gram[..., 3:, 3:]
    p, r = e[..., :3], e[..., 3:]
    lever = np.trace(a, axis1=-2, axis2=-1)
    # The rotation's damping follows from how well the arm turns its target while it holds the position.
    turning = c - transposed(b) @ np.linalg.solve(plus(a, HOLD * lever), b)
    usual_error = np.maximum(usual, LEAST_USUAL)
    rotation = damping_at(turning, ROTATION_FLOOR, TURN_DAMPING * usual_error * np.ones(lever.shape))
    along = np.linalg.solve(plus(c, rotation), transposed(b))
    shifting = a - b @ along
    most = np.maximum(ROOM * usual, norm(r)) + LEAST_ROOM
    rest = p - across(transposed(along), r)
    # A small error is damped as the usual one, where the arm can hardly move its target.
    position = damping_at(shifting, POSITION_FLOOR, SHIFT_DAMPING * usual_error * lever)
    for _ in range(SHIFT_ROUNDS):
        x = solved(shifting, position, rest)
        excess = np.maximum(norm(x) * np.sqrt(lever) / SHIFT_LIMIT, norm(across(along, x)) * rotation / most) - 1
        form = np.sum(x * solved(shifting, position, x), -1)
        position = position + np.maximum(np.sum(x * x, -1) / np.maximum(form, 1e-300) * excess, 0)

    def turn(y):
        held = solved(shifting, position, across(transposed(along), y))
        return -held, solved(c, rotation, y) + across(along, held)

    damping = rotation[..., None]
    shift = solved(shifting, position, p)
    turned = across(along, shift)
    back, back_turn = turn(-damping * turned)
    turn_shift, first_turn = turn(r)
    again, last_turn = turn(damping * first_turn)
    turn_shift, turns = turn_shift + again, first_turn + last_turn
    shift, shift_turn = shift + back, back_turn - turned

    def leaves(shift_share, turn_share):
        return (1 - turn_share) * r + damping * (shift_share * back_turn + turn_share * last_turn)

    shift_share = largest_share(leaves(0, 1), leaves(1, 1), most)
    left = p - shift_share * (p - position[..., None] * shift)
    brought = (TAKEN * np.maximum(norm(p) - norm(left), 0) + LEAST_PUSH)[..., None]
    turn_share = brought / (brought + norm((position - POSITION_FLOOR)[..., None] * turn_shift)[..., None])
    taken = largest_share(r, leaves(shift_share, turn_share), most)
    x = shift_share * np.concatenate([shift, shift_turn], -1) + turn_share * np.concatenate([turn_shift, turns], -1)
    x = taken * x
    # What the floor left is brought by the later step.
    later = solved(shifting, position, POSITION_FLOOR * x[..., :3])
    later = np.concatenate([later, -across(along, later)], -1)
    return bounded(across(transposed(j), x + later))


LAWS = {
    "as of 2026-11": today,
    "(a) damping, σ0 0.1, λ0 0.01": damping_only(0.1, 0.01),
    "(a) damping, σ0 0.15, λ0 0.005": damping_only(0.15, 0.005),
    "(a) damping, σ0 0.25, λ0 0.0625": damping_only(0.25, 0.0625),
    "(b) weight fading to 0.02 m, σ0 0.15": fading_weight(0.15, 0.0225, 0.3, 0.02),
    "(c) spectral, weight 0.02 m, threshold 0.003": spectral(0.02, 0.003),
    "(c) spectral, weight 0.3 m, threshold 0.015": spectral(0.3, 0.015),
    "(c) spectral, weight 0.3 m, threshold 0.045": spectral(0.3, 0.045),
    "(c) spectral, weight 1 m, threshold 0.15": spectral(1.0, 0.15),
    "(d) priority, 0.05, 0.15": priority(0.05, 0.15),
    "(d) priority, 0.15, 0.15": priority(0.15, 0.15),
    "(e) shared loss, threshold 0.015": oblique(0.3, constant(0.015), balanced_share),
    "(e) shared loss, threshold 0.03": oblique(0.3, constant(0.03), balanced_share),
    "(e) shared loss, threshold 0.045": oblique(0.3, constant(0.045), balanced_share),
    "(e) shared loss, threshold 0.06": oblique(0.3, constant(0.06), balanced_share),
    "(e) shared loss, threshold 0.09": oblique(0.3, constant(0.09), balanced_share),
    "(e) by lever, slope 0.5": oblique(0.3, by_lever(0.5, 2e-3), balanced_share),
    "(e) by lever, slope 0.5, guarded": guarded(oblique(0.3, by_lever(0.5, 2e-3), balanced_share)),
    "(e) by lever, slope 0.15, guarded": guarded(oblique(0.3, by_lever(0.15, 2e-3), balanced_share)),
    "(f) rotation first, threshold 0.03, guarded": guarded(oblique(0.3, constant(0.03), rotation_first_share(0.9))),
    "(g) position first (built)": position_first,
}


@dataclass
class Measured:
    """On the points of all paths of a kind."""

    position: np.ndarray
    rotation: np.ndarray
    position_excess: float
    rotation_excess: float
    slope: np.ndarray  # of each path


class Study:
    """An arm: its true draws, its errors without correction and its paths."""

    def __init__(self, name, seed, through, along):
        self.name = name
        self.chain, self.lower, self.upper = read(name)
        random = np.random.default_rng([seed, ARMS.index(name)])
        self.pairs = [draw(self.chain, self.lower, self.upper, random) for _ in range(DRAWS)]
        poses = random.uniform(self.lower, self.upper, (2000, len(self.lower)))
        errors = np.array([pair.error(poses) for pair in self.pairs])
        self.position = np.linalg.norm(errors[..., :3], axis=-1)
        self.rotation = np.linalg.norm(errors[..., 3:], axis=-1)
        self.limits = np.percentile(self.rotation, 95, axis=1)
        self.usual = np.sqrt(np.mean(self.rotation**2, axis=1))
        self.singular = smallest_singular_value(self.pairs[0].nominal.jacobian(poses))
        self.errors = errors
        self.random_jacobians = self.pairs[0].jacobian(poses)
        self.random_limits = np.full(len(poses), self.limits[0])
        self.random_usual = np.full(len(poses), self.usual[0])
        self.paths = {}
        for kind in KINDS:
            found = paths(name, self.chain, self.lower, self.upper, self.pairs, kind, random, through, along)
            if found:
                self.paths[kind] = found
        self.prepared = {
            kind: (
                np.array([self.pairs[p.pair].jacobian(p.joints) for p in found]),
                np.array([self.pairs[p.pair].error(p.joints) for p in found]),
                np.array([np.full(len(p.joints), self.limits[p.pair]) for p in found]),
                np.array([p.joints for p in found]),
                np.array([np.full(len(p.joints), self.usual[p.pair]) for p in found]),
            )
            for kind, found in self.paths.items()
        }

    def measure(self, kind, change):
        j, e, limits, joints, _ = self.prepared[kind]
        left = residual(j, e, change)
        position, rotated = np.linalg.norm(left[..., :3], axis=-1), np.linalg.norm(left[..., 3:], axis=-1)
        before = np.linalg.norm(e[..., :3], axis=-1)
        allowed = np.maximum(np.linalg.norm(e[..., 3:], axis=-1), limits)
        slope = np.abs(np.diff(change, axis=1)).max(-1) / np.abs(np.diff(joints, axis=1)).max(-1)
        return Measured(position, rotated, (position - before).max(), (rotated - allowed).max(), slope.max(1))


def percentiles(values, scale, digits):
    return [f"{scale * v:.{digits}f}" for v in (np.median(values), np.percentile(values, 99), values.max())]


def table(header, rows):
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print(flush=True)


def describe(studies):
    rows = []
    for s in studies:
        rows.append(
            [
                s.name,
                f"{1e3 * s.position.mean():.2f}, {1e3 * np.percentile(s.position, 95):.2f}",
                f"{1e3 * s.rotation.mean():.2f}, {1e3 * np.percentile(s.rotation, 95):.2f}",
                f"{100 * np.mean(s.singular < EXACT_FROM):.1f}",
                f"{100 * np.mean(s.singular < 0.05):.1f}",
                ", ".join(
                    f"{kind} {sum(p.through for p in found)} + {sum(not p.through for p in found)}"
                    for kind, found in s.paths.items()
                ),
            ]
        )
    table(
        [
            "arm",
            "position error without correction, mm: mean, 95 %",
            "rotation, mrad",
            "% of poses with σ < 0.15",
            "σ < 0.05",
            "paths through + along",
        ],
        rows,
    )


def law_rows(studies, laws):
    """Of each law and kind: the median arm and the worst one; of random poses those that are not exact."""
    rows = []
    for title, law in laws.items():
        inexact = []
        for s in studies:
            change = law(s.random_jacobians, s.errors[0], s.random_limits, s.random_usual)
            left = residual(s.random_jacobians, s.errors[0], change)
            inexact.append(100 * np.mean(np.linalg.norm(left[:, :3], axis=-1) > 20e-6))
        for kind in KINDS:
            measured = []
            for s in studies:
                if kind in s.paths:
                    j, e, limits, _, usual = s.prepared[kind]
                    measured.append(s.measure(kind, law(j, e, limits, usual)))

            def worst(function):
                return max(function(m) for m in measured)

            rows.append(
                [
                    title,
                    kind,
                    f"{1e6 * worst(lambda m: np.median(m.position)):.0f}",
                    f"{1e6 * worst(lambda m: np.percentile(m.position, 99)):.0f}",
                    f"{1e6 * worst(lambda m: m.position.max()):.0f}",
                    f"{1e3 * worst(lambda m: np.percentile(m.rotation, 99)):.2f}",
                    f"{1e3 * worst(lambda m: m.rotation.max()):.2f}",
                    f"{1e6 * worst(lambda m: m.position_excess):.0f}",
                    f"{1e3 * worst(lambda m: m.rotation_excess):.2f}",
                    f"{worst(lambda m: np.median(m.slope)):.2f}",
                    f"{worst(lambda m: m.slope.max()):.2f}",
                    f"{min(inexact):.0f} to {max(inexact):.0f}" if kind == "wrist" else "",
                ]
            )
    return rows


LAW_HEADER = ["law", "kind", "position µm: median", "99 %", "largest", "rotation mrad: 99 %", "largest"]
LAW_HEADER += ["above uncorrected, µm", "above allowed, mrad", "slope: median path", "largest"]
LAW_HEADER += ["% of random poses off by > 20 µm"]


def random_rows(studies, titles):
    """What stays of the position at random poses, by arm."""
    rows = []
    for s in studies:
        row = [s.name]
        for title in titles:
            change = LAWS[title](s.random_jacobians, s.errors[0], s.random_limits, s.random_usual)
            left = norm(residual(s.random_jacobians, s.errors[0], change)[:, :3])
            row += [f"{1e6 * np.median(left):.0f}", f"{100 * np.mean(left > 20e-6):.0f}"]
        rows.append(row)
    return rows


# The oracle: a convex problem over a whole path. Changes in mrad, residuals in mm and mrad.


def oracle(j, e, joints, slope, limit=None):
    """Δ of every point: least squares of position, then rotation, with |ΔΔ| ≤ slope · max|Δq| and |Δ| ≤ MAX_CHANGE.

    With `limit`, in rad, neither part of the error may be larger than without correction; rotation up to `limit`."""
    count, n = e.shape[0], j.shape[-1]
    weights = np.repeat([1.0, ORACLE_WEIGHT], 3)
    jw, ew = weights[:, None] * j, weights * 1e3 * e
    size = count * n
    difference = sparse.kron(sparse.diags([-np.ones(count), np.ones(count - 1)], [0, 1], (count - 1, count)), sparse.eye(n))
    blocks = sparse.block_diag(list(np.swapaxes(jw, -1, -2) @ jw + 1e-7 * np.eye(n)))
    cost = sparse.triu(2 * (blocks + 1e-6 * difference.T @ difference), format="csc")
    linear = -2 * (np.swapaxes(jw, -1, -2) @ ew[..., None]).reshape(-1)
    step = np.repeat(1e3 * slope * np.abs(np.diff(joints, axis=0)).max(1), n)
    matrices = [difference, -difference, sparse.eye(size), -sparse.eye(size)]
    sides = [step, step, np.full(2 * size, 1e3 * MAX_CHANGE)]
    cones = [clarabel.NonnegativeConeT(2 * len(step) + 2 * size)]
    if limit is not None:
        before = np.linalg.norm(e.reshape(count, 2, 3), axis=-1)
        radii = np.stack([before[:, 0] + POSITION_SLACK, np.maximum(before[:, 1], limit) + ROTATION_SLACK], -1)
        padded = np.zeros((count, 8, n))
        padded[:, 1:4], padded[:, 5:8] = j[:, :3], j[:, 3:]
        side = np.zeros((count, 8))
        side[:, 0], side[:, 4] = 1e3 * radii.T
        side[:, 1:4], side[:, 5:8] = 1e3 * e[:, :3], 1e3 * e[:, 3:]
        matrices.append(sparse.block_diag(list(padded)))
        sides.append(side.reshape(-1))
        cones += [clarabel.SecondOrderConeT(4)] * (2 * count)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    solution = clarabel.DefaultSolver(
        cost, linear, sparse.vstack(matrices, format="csc"), np.concatenate(sides), cones, settings
    ).solve()
    if "Solved" not in str(solution.status):
        print(f"oracle: {solution.status}", file=sys.stderr)
    return 1e-3 * np.array(solution.x).reshape(count, n)


def oracle_rows(study, kind, slopes, with_limits, every):
    j, e, limits, joints, _ = study.prepared[kind]
    rows = []
    for slope in slopes:
        change = np.zeros(joints.shape)
        solved = []
        for i in range(0, len(joints), every):
            limit = limits[i, 0] if with_limits else None
            change[i] = oracle(j[i], e[i], joints[i], slope, limit)
            solved.append(i)
        m = study.measure(kind, change)
        rows.append(
            [
                study.name,
                kind,
                "yes" if with_limits else "no",
                f"{slope:g}",
                *percentiles(m.position[solved], 1e6, 0),
                *percentiles(m.rotation[solved], 1e3, 2),
            ]
        )
    return rows


ORACLE_HEADER = ["arm", "kind", "limits", "slope", "position µm: median", "99 %", "largest"]
ORACLE_HEADER += ["rotation mrad: median", "99 %", "largest"]


def nonlinear(study):
    """Largest difference, in µm and mrad, of linearised and true residuals of the oracle on the first path through."""
    rows = []
    for kind, found in study.paths.items():
        j, e, limits, joints, _ = (part[0] for part in study.prepared[kind])
        change = oracle(j, e, joints, 0.5, limits[0])
        off = study.pairs[found[0].pair].error(joints, change) - residual(j, e, change)
        p, r = np.linalg.norm(off[:, :3], axis=-1).max(), np.linalg.norm(off[:, 3:], axis=-1).max()
        rows.append([study.name, kind, f"{1e3 * np.abs(change).max():.0f}", f"{1e6 * p:.1f}", f"{1e3 * r:.3f}"])
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--arms", default=",".join(ARMS))
    parser.add_argument("--parts", default="laws,oracle")
    parser.add_argument("--through", type=int, default=THROUGH)
    parser.add_argument("--along", type=int, default=ALONG)
    parser.add_argument("--every", type=int, default=1, help="the oracle solves each so manieth path")
    arguments = parser.parse_args()
    studies = [Study(name, arguments.seed, arguments.through, arguments.along) for name in arguments.arms.split(",")]
    describe(studies)
    if "laws" in arguments.parts:
        table(LAW_HEADER, law_rows(studies, LAWS))
        titles = ["(e) shared loss, threshold 0.03", list(LAWS)[-1]]
        header = [name for title in titles for name in (f"{title}: median µm", "% of random poses off by > 20 µm")]
        table(["arm", *header], random_rows(studies, titles))
    if "oracle" in arguments.parts:
        table(
            ["arm", "kind", "largest change, mrad", "linearisation, µm", "mrad"],
            [row for study in studies for row in nonlinear(study)],
        )
        rows = []
        for study in studies:
            for kind in study.paths:
                for with_limits in (False, True):
                    start = time.time()
                    rows += oracle_rows(study, kind, SLOPES, with_limits, arguments.every)
                    print(f"{study.name} {kind}: {time.time() - start:.0f} s", file=sys.stderr, flush=True)
        table(ORACLE_HEADER, rows)


if __name__ == "__main__":
    main()
