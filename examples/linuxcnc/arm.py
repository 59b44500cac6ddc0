"""The true arm of the example: an independent simulation in numpy that shares no code with the project.

An ABB IRB 4400 as in calibration/robots/abb-irb4400-serial.toml, with what is wrong with a real one: fixed frames that are off,
joints and links that give way under the gravity of links and payload, gears that stiffen with load, transmission errors,
backlash, repeatability, and payloads that are not what the operator knows. A tracker of 30 um and 50 urad measures it.

    arm.py measure TRAIN.csv [--seed N] [--poses N]     measurements for `trainer calibrate`
    arm.py tool [--seed N]                              target_from_tool for `loadrt poegpkins tool=`
"""

import argparse
import pathlib
import tomllib

import numpy as np

ROBOT = pathlib.Path(__file__).resolve().parents[2] / "calibration/robots/abb-irb4400-serial.toml"
PAYLOADS_KG = (1.0, 2.5, 3.5, 5.0, 7.5)
# The payload that the cell works with: half of the poses are measured with it.
WORKING_KG = 5.0
CELL_DEG = np.array([(-60, 60), (-40, 60), (-40, 45), (-60, 60), (-75, 75), (-90, 90)], float)
GRAVITY = np.array([0, 0, -9.81])

FRAME_ERROR = 1.1 * 0.78e-3  # m and rad for each component
COMPLIANCE = 1.1 * np.array([6.7, 12.5, 14.3, 12.5, 16.7, 20.0]) * 1e-6  # rad/(N m)
BENDING_SHARE = 0.25  # of the compliance, about the transverse axes of joints 1 to 3
STIFFENING_NM = 150.0
LINK_GRAVITY_SHARE = 0.06  # the controller compensates the rest
LINK_MASSES_KG = (0.0, 31.0, 20.0, 17.0, 1.2, 0.42)  # the column turns about the vertical
BACKLASH = 15e-6  # rad
REPEATABILITY = 5e-6  # rad
NOISE_M, NOISE_RAD = 30e-6, 50e-6


def rotations(axis, angles):
    """Rotations about a unit axis, one for each angle: (n, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angles = np.asarray(angles, float)[..., None, None]
    return np.eye(3) + np.sin(angles) * cross + (1 - np.cos(angles)) * (cross @ cross)


def turns(vectors):
    """Rotations by vectors (axis times angle): (n, 3) to (n, 3, 3)."""
    vectors = np.asarray(vectors, float)
    angle = np.linalg.norm(vectors, axis=-1)
    out = np.empty(vectors.shape[:-1] + (3, 3))
    for index in np.ndindex(angle.shape):
        unit = vectors[index] / angle[index] if angle[index] > 0 else np.array([0, 0, 1.0])
        out[index] = rotations(unit, angle[index])
    return out


def small_turns(vectors):
    """The same for angles below a milliradian, to 1e-12."""
    x, y, z = np.moveaxis(np.asarray(vectors, float), -1, 0)
    o = np.zeros_like(x)
    cross = np.moveaxis(np.array([[o, -z, y], [z, o, -x], [-y, x, o]]), (0, 1), (-2, -1))
    return np.eye(3) + cross + 0.5 * cross @ cross


def rpy(angles):
    """Rotation by roll, pitch and yaw (rad) about the fixed x, y and z axes; also for (n, 3)."""
    roll, pitch, yaw = np.moveaxis(np.asarray(angles, float), -1, 0)
    return rotations((0, 0, 1), yaw) @ rotations((0, 1, 0), pitch) @ rotations((1, 0, 0), roll)


def rpy_of(rotation):
    """Roll, pitch and yaw in rad."""
    r = np.asarray(rotation)
    pitch = np.arctan2(-r[..., 2, 0], np.hypot(r[..., 0, 0], r[..., 1, 0]))
    return np.stack([np.arctan2(r[..., 2, 1], r[..., 2, 2]), pitch, np.arctan2(r[..., 1, 0], r[..., 0, 0])], -1)


def pose(rotation, translation):
    """A transform, or many: (..., 4, 4)."""
    rotation, translation = np.asarray(rotation, float), np.asarray(translation, float)
    shape = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    out = np.zeros(shape + (4, 4))
    out[..., :3, :3] = rotation
    out[..., :3, 3] = translation
    out[..., 3, 3] = 1
    return out


def from_quaternion(w, x, y, z):
    n = np.array([w, x, y, z], float)
    w, x, y, z = n / np.linalg.norm(n)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def to_quaternion(r):
    """w, x, y, z of one rotation: the eigenvector that belongs to it."""
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], 0, 0, 0],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], 0, 0],
            [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0],
            [r[1, 0] - r[0, 1], r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    q = np.linalg.eigh(k)[1][:, -1]
    return q if q[0] >= 0 else -q


class NominalArm:
    """The nominal arm."""

    def __init__(self):
        described = tomllib.loads(ROBOT.read_text(encoding="utf-8"))
        joints = described["joint"]
        self.axes = [np.array(joint["axis"], float) for joint in joints]
        self.origins = [pose(np.eye(3), joint["origin"]["xyz_m"]) for joint in joints]
        flange = described["flange"]["origin"]
        self.flange = pose(rpy(np.radians(flange["rpy_deg"])), flange["xyz_m"])
        self.limits = np.radians([joint["limits_deg"] for joint in joints])

    def base_from_flange(self, joints):
        """For (n, 6) joints in rad."""
        at = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        for i, (origin, axis) in enumerate(zip(self.origins, self.axes)):
            at = at @ origin @ pose(rotations(axis, joints[:, i]), np.zeros(3))
        return at @ self.flange


# The tool that the cell works with, on the flange. As on a milling machine its z axis leads from the tip back to the flange.
FLANGE_FROM_TOOL = pose(rotations((0, 1, 0), np.pi), (0.030, -0.045, 0.210))


class TrueArm:
    """The arm as it is, drawn by `seed`."""

    def __init__(self, seed):
        random = np.random.default_rng(seed)
        self.nominal = NominalArm()
        count = len(self.nominal.axes)
        errors = FRAME_ERROR * random.standard_normal((count + 1, 2, 3))
        frames = [*self.nominal.origins, self.nominal.flange]
        self.frames = [frame @ pose(turns(turn), shift) for frame, (shift, turn) in zip(frames, errors)]
        self.compliance = COMPLIANCE * (1 + 0.25 * random.uniform(-1, 1, count))
        self.phases = random.uniform(0, 2 * np.pi, (count, 3))
        centre = np.array([0.020, -0.010, 0.120]) + 0.010 * random.standard_normal(3)
        self.payloads = {
            kg: (kg * (1 + 0.02 * random.standard_normal()), centre + 0.03 * random.standard_normal(3)) for kg in PAYLOADS_KG
        }
        self.instrument_from_base = self.arbitrary(2.5, random)
        self.flange_from_target = self.arbitrary(0.12, random)
        self.target_from_tool = np.linalg.inv(self.flange_from_target) @ FLANGE_FROM_TOOL
        self.approach = REPEATABILITY * random.standard_normal(count)

    @staticmethod
    def arbitrary(distance, random):
        """Any orientation, `distance` m away."""
        direction = random.standard_normal(3)
        return pose(from_quaternion(*random.standard_normal(4)), distance * direction / np.linalg.norm(direction))

    def instrument_from_target(self, joints, payload_kg, repeat=None):
        """Where the target is at (n, 6) joints in rad, with one payload as the operator knows it.

        `repeat`: (n, 6) rad by which the joints come elsewhere this time; without it, always the same amounts."""
        axes, count = self.nominal.axes, len(self.nominal.axes)
        q, (a, b, c) = joints, self.phases.T
        serial = q + 60e-6 * np.sin(q + a) + 30e-6 * np.sin(2 * q + b) + 8e-6 * np.sin(60 * q + c)
        serial += self.approach if repeat is None else repeat
        serial[:, 2] += 100e-6 * np.sin(q[:, 2] - q[:, 1] + a[2])
        kg, centre = self.payloads[payload_kg]
        deflected, bending = serial, np.zeros((len(q), count, 3))
        for _ in range(2):  # the torque changes the angles that change the torque
            torques = self.torques(deflected, kg, centre)
            deflected, bending = serial.copy(), np.zeros_like(bending)
            for i in range(count):
                about = torques[i] @ axes[i]
                deflected[:, i] += self.compliance[i] / (1 + np.abs(about) / STIFFENING_NM) * about + BACKLASH * np.sign(about)
                if i < 3:
                    bending[:, i] = self.compliance[i] * BENDING_SHARE * (torques[i] - about[:, None] * axes[i])
        return self.instrument_from_base @ self.chain(deflected, bending)[-1] @ self.flange_from_target

    def chain(self, joints, bending):
        """Poses in the base of every joint's frame before it turns, and of the flange."""
        at, out = np.broadcast_to(np.eye(4), (len(joints), 4, 4)), []
        for i, axis in enumerate(self.nominal.axes):
            at = at @ self.frames[i] @ pose(small_turns(bending[:, i]), np.zeros(3))
            out.append(at)
            at = at @ pose(rotations(axis, joints[:, i]), np.zeros(3))
        return [*out, at @ self.frames[-1]]

    def torques(self, joints, payload_kg, centre):
        """Gravity torque about the origin of each joint, in its own axes, N m."""
        frames = self.chain(joints, np.zeros((len(joints), len(self.nominal.axes), 3)))
        at = [frame[:, :3, 3] for frame in frames]
        payload = at[-1] + frames[-1][:, :3, :3] @ centre
        out = []
        for i in range(len(joints[0])):
            torque = np.cross(payload - at[i], payload_kg * GRAVITY)
            for link in range(i, len(joints[0])):
                middle = (at[link] + at[link + 1]) / 2
                torque += LINK_GRAVITY_SHARE * np.cross(middle - at[i], LINK_MASSES_KG[link] * GRAVITY)
            out.append(np.einsum("nji,nj->ni", frames[i][:, :3, :3], torque))
        return out


def measure(file, seed, poses):
    """Random poses of the cell, half of them with the payload of its work and half with others, as the tracker sees them."""
    arm, random = TrueArm(seed), np.random.default_rng((seed, 1))
    others = [kg for kg in PAYLOADS_KG if kg != WORKING_KG]
    low, high = np.radians(CELL_DEG).T
    lines = ["# " + f"arm.py measure, seed {seed}", "payload_kg,q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x_mm,y_mm,z_mm,qw,qx,qy,qz"]
    for _ in range(poses):
        joints = random.uniform(low, high)[None]
        kg = WORKING_KG if random.random() < 0.5 else random.choice(others)
        seen = arm.instrument_from_target(joints, kg, REPEATABILITY * random.standard_normal((1, 6)))[0]
        where = 1e3 * (seen[:3, 3] + NOISE_M * random.standard_normal(3))
        turned = to_quaternion(turns(NOISE_RAD * random.standard_normal(3)) @ seen[:3, :3])
        numbers = [f"{kg}", *(f"{x:.10f}" for x in np.degrees(joints[0])), *(f"{x:.6f}" for x in where)]
        lines.append(",".join([*numbers, *(f"{x:.12f}" for x in turned)]))
    pathlib.Path(file).write_text("\n".join(lines) + "\n", encoding="utf-8")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["measure", "tool"])
    parser.add_argument("file", nargs="?")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--poses", type=int, default=600)
    arguments = parser.parse_args()
    if arguments.what == "measure":
        measure(arguments.file or parser.error("measure needs a file to write"), arguments.seed, arguments.poses)
    else:
        tool = TrueArm(arguments.seed).target_from_tool
        print(",".join(f"{x:.12f}" for x in [*(1e3 * tool[:3, 3]), *to_quaternion(tool[:3, :3])]))


if __name__ == "__main__":
    main()
