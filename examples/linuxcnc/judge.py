"""Judges a record of the servo thread against the true arm of arm.py, which shares no code with the project.

    judge.py RECORD.txt INSPECTED.json --seed N --payload-kg KG     prints JSON; INSPECTED.json is `trainer inspect --json` of the blob

The wanted pose of every cycle is the one that LinuxCNC commanded, X Y Z A B C in the base of the blob. The true arm shows where its
tool is at the joints that were sent. Of the blob only its base is used.
"""

import argparse
import json
import pathlib

import numpy as np

from arm import TrueArm, pose, rpy

PERIOD_S = 1e-3
# Joints leave motmod this many cycles after the pose that they belong to.
LAG = 2
# Cycles beside a change of the path's acceleration that tell nothing about noise.
NEAR = 8
# Half the width of the mean that a joint's acceleration is compared with, cycles.
SMOOTH = 5


def read(file):
    """The record by its columns. An error where cycles were lost."""
    lines = pathlib.Path(file).read_text(encoding="utf-8").splitlines()
    if any("overrun" in line for line in lines):
        raise ValueError(f"{file}: cycles were lost: the reader of the samples was not run in time")
    # The last line may be cut off at the end of the run.
    rows = np.array([[float(x) for x in line.split()] for line in lines if len(line.split()) == 18][:-1])
    if not len(rows) or not (np.diff(rows[:, 0]) == 1).all():
        raise ValueError(f"{file}: cycles were lost: the samples are not numbered one after the other")
    return {
        "wanted": rows[:, 1:7],
        "joints": np.radians(1e-6 * rows[:, 7:13]),
        "inverse_us": 1e-3 * rows[:, 13],
        "status": rows[:, 14].astype(int),
        "singular": rows[:, 15].astype(int),
        "coordinated": rows[:, 16] > 0,
        "on_path": rows[:, 17] > 0,
    }


def aligned(record):
    """Poses and joints that belong together, in coordinated mode (homing is over), on the path and before a stop."""
    valid = record["coordinated"] & record["on_path"] & (record["singular"] == 0)
    valid = valid[:-LAG] & valid[LAG:]
    return record["wanted"][:-LAG][valid], record["joints"][LAG:][valid]


def acceleration_noise(wanted, joints):
    """What joints have in their acceleration beside its mean over neighbours where the path's own is smooth, rad/s^2 rms."""
    position = wanted[:, :3]
    jerk = np.linalg.norm(np.diff(position, 3, axis=0), axis=1) / PERIOD_S**3
    rough = np.convolve(jerk > JERK_SMOOTH_MM_S3, np.ones(2 * (SMOOTH + NEAR) + 1), "same") > 0
    acceleration = np.diff(joints, 2, axis=0)[:-1] / PERIOD_S**2
    width = 2 * SMOOTH + 1
    mean = np.stack([np.convolve(a, np.ones(width) / width, "same") for a in acceleration.T], 1)
    smooth = ~rough
    smooth[:width], smooth[-width:] = False, False
    return float(np.sqrt(np.mean((acceleration - mean)[smooth] ** 2, axis=0)).max()), int(smooth.sum())


# The record has the pose to 1e-6 mm, which is noise of 1e3 mm/s^3 in third differences.
JERK_SMOOTH_MM_S3 = 2e4


def errors(arm, wanted, joints, inspected, payload_kg):
    """Distance in mm and rotation in mrad between the wanted pose and the tool of the true arm."""
    base = np.array(inspected["instrument_from_base"]).reshape(3, 4)
    ideal = pose(base[:, :3], base[:, 3]) @ pose(rpy(np.radians(wanted[:, 3:])), 1e-3 * wanted[:, :3])
    real = arm.instrument_from_target(joints, payload_kg) @ arm.target_from_tool
    between = np.swapaxes(ideal[:, :3, :3], 1, 2) @ real[:, :3, :3]
    skew = between - np.swapaxes(between, 1, 2)
    sine = np.linalg.norm(skew[:, (2, 0, 1), (1, 2, 0)], axis=1) / 2
    return 1e3 * np.linalg.norm(real[:, :3, 3] - ideal[:, :3, 3], axis=1), 1e3 * np.arcsin(np.minimum(sine, 1))


def homed(record):
    """The cycle in which homing sets all joints to where they stand: the only step there may be."""
    before = record["joints"][: int(np.argmax(record["coordinated"]))]
    return int(np.argmax(np.abs(np.diff(before, axis=0)).max(1))) + 1


def largest_step(record):
    """Of a joint in one cycle, after homing, degrees."""
    return float(np.degrees(np.abs(np.diff(record["joints"][homed(record) :], axis=0)).max()))


def start(record):
    """Pose and joints as homing leaves them, and the largest step of a joint in the cycles after, rad.

    The pose is that of the forward kinematics. LinuxCNC then asks the inverse for its joints: others than before are a step."""
    at = homed(record)
    step = np.abs(np.diff(record["joints"][at : at + 10], axis=0)).max()
    return record["wanted"][at + 1 : at + 2], record["joints"][at : at + 1], float(step)


def judge(record, inspected, seed, payload_kg):
    arm = TrueArm(seed)
    wanted, joints = aligned(record)
    error, turned = errors(arm, wanted, joints, inspected, payload_kg)
    *standing, step = start(record)
    speed = np.linalg.norm(np.diff(wanted[:, :3], axis=0), axis=1) / PERIOD_S
    noise, cycles = acceleration_noise(wanted, joints)
    inverse = record["inverse_us"][record["coordinated"] & record["on_path"]]
    return {
        "cycles": len(error),
        "mean_mm": error.mean(),
        "p95_mm": np.percentile(error, 95),
        "largest_mm": error.max(),
        "forward_mm": errors(arm, *standing, inspected, payload_kg)[0][0],
        "start_step_rad": step,
        "largest_step_deg": largest_step(record),
        "mean_mrad": turned.mean(),
        "largest_speed_mm_s": speed.max(),
        "inverse_median_us": np.median(inverse),
        "inverse_p99_us": np.percentile(inverse, 99),
        "acceleration_noise_rad_s2": noise,
        "smooth_cycles": cycles,
        "status": int(np.bitwise_or.reduce(record["status"])),
        "joints_deg": [np.degrees(joints.min(0)).round(1).tolist(), np.degrees(joints.max(0)).round(1).tolist()],
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record")
    parser.add_argument("inspected")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--payload-kg", type=float, required=True)
    a = parser.parse_args()
    inspected = json.loads(pathlib.Path(a.inspected).read_text(encoding="utf-8"))
    print(json.dumps(judge(read(a.record), inspected, a.seed, a.payload_kg), indent=2))


if __name__ == "__main__":
    main()
