"""Exports of calibrated arms, read by programs that are not ours, against the product of exponentials by scipy."""

import csv
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import yaml
import yourdfpy
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import floor

LIMIT_M = 1e-9
LIMIT_RAD = 1e-9
# How true a stated distance from the model is, and how large it may be: in mm over the trained ranges, and about a pose.
TRUE_TO = 0.01
LIMITS_MM = [0.35, 0.06]
POSES_JUDGED = 20_000
# By how much numpy's least squares may be nearer in the mean.
AS_NEAR_AS = 0.01
POSES_FITTED = 8_000
TABLES = ["dh", "mdh", "poe"]
BUILT_IN = ["abb-irb120", "abb-irb4400", "abb-irb4400-serial", "kuka-iiwa7", "ur5", "ur10"]


def pose(rotation, translation):
    out = np.eye(4)
    out[:3, :3] = rotation
    out[:3, 3] = translation
    return out


def from_rpy(xyz, rpy):
    """About the fixed axes x, y, z: scipy's lower case is extrinsic."""
    return pose(Rotation.from_euler("xyz", rpy).as_matrix(), xyz)


def numbers(header, name):
    body = re.search(rf"\b\w*{name}\b[^=]*= \{{(.*?)\}};", header, re.S).group(1)
    # A float of C is the nearest single, not the decimal number that is written.
    number = lambda x: float(np.float32(x[:-1])) if x.endswith("f") else float(x)
    return np.array([number(x) for x in re.findall(r"-?\d[\w.+-]*", body)])


class Chain:
    """The chain of a C header: fixed frames with a motion about or along z between them."""

    def __init__(self, header):
        frames = numbers(header, "parent_from_joint").reshape(-1, 3, 4)
        self.frames = []
        for frame in frames:
            u, _, v = np.linalg.svd(frame[:, :3])
            self.frames.append(pose(u @ v, frame[:, 3]))
        self.prismatic = numbers(header, "is_prismatic").astype(int)
        self.flange_from_target = pose(*self.split(numbers(header, "flange_from_target")))
        has_coupling = "_coupling[" in header
        n = len(self.prismatic)
        self.coupling = numbers(header, "coupling").reshape(n, n) if has_coupling else np.eye(n)

    @staticmethod
    def split(rows):
        rows = rows.reshape(3, 4)
        return rows[:, :3], rows[:, 3]

    def forward(self, q):
        """base_from_target; q of the chain."""
        out = self.frames[0]
        for value, prismatic, frame in zip(q, self.prismatic, self.frames[1:]):
            twist = np.zeros((4, 4))
            if prismatic:
                twist[2, 3] = 1
            else:
                twist[0, 1], twist[1, 0] = -1, 1
            out = out @ expm(twist * value) @ frame
        return out


def by_pinocchio(path, joints, base, tip):
    model = pinocchio.buildModelFromUrdf(str(path))
    data = model.createData()
    base, tip = model.getFrameId(base), model.getFrameId(tip)

    def forward(q):
        configuration = pinocchio.neutral(model)
        for name, value in zip(joints, q):
            joint = model.joints[model.getJointId(name)]
            configuration[joint.idx_q : joint.idx_q + joint.nq] = (
                [np.cos(value), np.sin(value)] if joint.nq == 2 else [value]
            )
        pinocchio.framesForwardKinematics(model, data, configuration)
        return (data.oMf[base].inverse() * data.oMf[tip]).homogeneous

    return forward


def by_mujoco(path, joints, site):
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    address = [model.joint(name).qposadr[0] for name in joints]
    site = model.site(site).id

    def forward(q):
        data.qpos[address] = q
        mujoco.mj_kinematics(model, data)
        return pose(data.site_xmat[site].reshape(3, 3), data.site_xpos[site].copy())

    return forward


def by_yourdfpy(path, joints, base, tip):
    robot = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)

    def forward(q):
        robot.update_cfg(dict(zip(joints, q)))
        return robot.get_transform(tip, base)

    return forward


def by_table(table):
    """A DH or POE table as read from JSON or TOML."""

    def frame(origin):
        return from_rpy(origin["xyz_m"], origin["rpy_rad"])

    joints = table.get("joints") or table["joint"]
    target = table.get("flange_from_target") or table["calibration"]["flange_from_target"]

    def forward(q):
        out = frame(table["base"]["origin"]) if table.get("base") else np.eye(4)
        for joint, value in zip(joints, q):
            z = np.array([0, 0, 1])
            along = joint["kind"] == "prismatic"
            move = pose(np.eye(3), value * z) if along else pose(Rotation.from_rotvec(value * z).as_matrix(), 0 * z)
            if table["convention"] == "poe":
                out = out @ frame(joint["origin"]) @ move
                continue
            about_z = pose(Rotation.from_euler("z", joint["theta_offset_rad"]).as_matrix(), [0, 0, joint["d_m"]])
            turned = Rotation.from_euler("XY", [joint["alpha_rad"], joint.get("beta_rad", 0.0)])
            about_x = pose(turned.as_matrix(), [joint["a_m"], 0, 0])
            # Distal rows have the joint first, Craig's have it after a, alpha and beta.
            factors = {"dh": [move, about_z, about_x], "modified-dh": [about_x, move, about_z]}
            for factor in factors[table["convention"]]:
                out = out @ factor
        return out @ frame(table["flange"]["origin"]) @ frame(target)

    return forward


def by_csv(path, convention):
    """The rows of a CSV file as a table."""
    with open(path) as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))

    def number(row, key):
        return float(row.get(key) or 0.0)

    def origin(row):
        return {"xyz_m": [number(row, f"{x}_m") for x in "xyz"], "rpy_rad": [number(row, f"{x}_rad") for x in ["roll", "pitch", "yaw"]]}

    keys = ["a_m", "d_m", "alpha_rad", "theta_offset_rad", "beta_rad"]
    fixed = {row["name"]: {"origin": origin(row)} for row in rows if row["kind"] == "fixed"}
    joints = [
        {"kind": row["kind"], "origin": origin(row), **{key: number(row, key) for key in keys}}
        for row in rows
        if row["kind"] != "fixed"
    ]
    return {
        "convention": {"dh": "dh", "mdh": "modified-dh", "poe": "poe"}[convention],
        "base": fixed.get("base"),
        "joints": joints,
        "flange": fixed["flange"],
        "flange_from_target": fixed["flange_from_target"]["origin"],
    }


def by_ur(path, tool0_from_target):
    """As ur_description's macro does it: six origins with axis z, tool0 where wrist_3 is."""
    with open(path) as file:
        kinematics = yaml.safe_load(file)["kinematics"]
    assert re.fullmatch(r"calib_\d+", kinematics["hash"])
    names = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]

    def forward(q):
        out = np.eye(4)
        for name, value in zip(names, q):
            k = kinematics[name]
            out = out @ from_rpy([k["x"], k["y"], k["z"]], [k["roll"], k["pitch"], k["yaw"]])
            out = out @ pose(Rotation.from_rotvec([0, 0, value]).as_matrix(), np.zeros(3))
        return out @ tool0_from_target

    return forward


def apart(a, b):
    angle = np.linalg.norm(a[:3, :3] - b[:3, :3]) / np.sqrt(2)
    return np.linalg.norm(a[:3, 3] - b[:3, 3]), angle


def nominal(path):
    """base_from_flange of a robot description with axes, all of them turning."""
    robot = tomllib.loads(path.read_text())
    flange = robot["flange"]["origin"]

    def forward(q):
        out = np.eye(4)
        for joint, value in zip(robot["joint"], q):
            origin = joint["origin"]
            assert joint["kind"] == "revolute" and set(origin) == {"xyz_m"}
            turned = Rotation.from_rotvec(value * np.array(joint["axis"])).as_matrix()
            out = out @ pose(turned, origin["xyz_m"])
        return out @ from_rpy(np.array(flange.get("xyz_m", [0, 0, 0])), np.radians(flange.get("rpy_deg", [0, 0, 0])))

    return forward


def joint_offsets(zeros, nominal):
    """A nominal chain, `base_from_flange`, with other joint zeros, base and tool: instrument_from_target."""
    offsets = np.array([joint["offset_rad"] for joint in zeros["joints"]])
    base, tool = (from_rpy(zeros[key]["xyz_m"], zeros[key]["rpy_rad"]) for key in ["instrument_from_base", "flange_from_target"])
    return lambda q: base @ nominal(q + offsets) @ tool


def evaluated(run, folder, blob, forward, joints):
    """A model at 5 kg, at a file's poses as if they had been measured: mean distance in mm, and its positions in mm."""
    names = [f"q{i + 1}_deg" for i in range(joints.shape[1])]
    rows = [",".join([*names, "payload_kg,x_mm,y_mm,z_mm,qw,qx,qy,qz"])]
    for q in joints:
        stands = forward(q)
        turned = Rotation.from_matrix(stands[:3, :3]).as_quat(scalar_first=True)
        row = [*np.degrees(q), 5.0, *(1e3 * stands[:3, 3]), *turned]
        rows.append(",".join(f"{x:.12f}" for x in row))
    (folder / "judged.csv").write_text("\n".join(rows) + "\n")
    run("evaluate", blob, "judged.csv", "--json", "judged.json", "--quiet", "--predictions", "predicted.csv")
    [judged] = json.loads((folder / "judged.json").read_text())["sets"]
    assert judged["poses"] == len(joints)
    with open(folder / "predicted.csv") as file:
        predicted = [[float(row[key]) for key in ["x_mm", "y_mm", "z_mm"]] for row in csv.DictReader(file)]
    return judged["position_mm"]["mean"], np.array(predicted)


def stated_distances(run, folder, data, robots):
    """What the exports of the wildest simulated arm state of their distance from its model, judged by what reads them."""
    rng = np.random.default_rng(2)
    arm = "abb-irb4400-serial"
    run("calibrate", "--robot", arm, data / "irb4400_wild_s0_train.csv", "--method", "elastic", "--out", "wild.blob")
    ranges = [j["trained"] for j in json.loads(run("inspect", "wild.blob", "--json", "-"))["robot"]["joints"]]
    pose_deg = [10, -10, 20, 30, 40, 0]
    about = [(np.radians(q - 15), np.radians(q + 15)) for q in pose_deg]
    regions = [([], ranges), (["--region", "15@" + ",".join(map(str, pose_deg))], about)]
    rows = []
    for (options, within), limit in zip(regions, LIMITS_MM):
        within = np.array([(max(a, lower), min(b, upper)) for (a, b), (lower, upper) in zip(within, ranges)])
        poses = rng.uniform(*within.T, (POSES_JUDGED, len(within)))
        chain = ["--out", "wild.urdf", "--target-link", "probe", "--mjcf", "wild.xml", "--poe", "wild.json"]
        run("export", "wild.blob", "--payload-kg", 5, *chain, "--joint-offsets", "zeros.json", *options, "--json", "said.json")
        said = json.loads((folder / "said.json").read_text())["distance"]
        table = json.loads((folder / "wild.json").read_text())
        joints = [joint["name"] for joint in table["joints"]]
        base = table["instrument_from_base"]
        instrument = from_rpy(base["xyz_m"], base["rpy_rad"])
        pin = by_pinocchio(folder / "wild.urdf", joints, "base_link", "probe")
        mjc = by_mujoco(folder / "wild.xml", joints, "target")
        zeros = json.loads((folder / "zeros.json").read_text())
        judges = {
            ("URDF", "Pinocchio", "chain"): lambda q: instrument @ pin(q),
            ("MJCF", "MuJoCo", "chain"): lambda q: instrument @ mjc(q),
            ("joint offsets", "scipy", "joint_offsets"): joint_offsets(zeros, nominal(robots / f"{arm}.toml")),
        }
        for (file, judge, key), forward in judges.items():
            stated = said[key]["position_mm"]["mean"]
            seen, _ = evaluated(run, folder, "wild.blob", forward, poses)
            rows.append((" ".join(options) or "trained ranges", file, judge, stated, seen))
            if abs(stated / seen - 1) > TRUE_TO:
                sys.exit(f"{file} {options}: {stated} mm stated, {seen} mm by {judge}")
        if said["chain"]["position_mm"]["mean"] > limit:
            sys.exit(f"{options}: {said['chain']['position_mm']['mean']} mm, at most {limit} allowed")
    print("\n| region, 5 kg | file | judged by | stated mean, mm | seen, mm |\n|---|---|---|---|---|")
    for region, file, judge, stated, seen in rows:
        print(f"| {region} | {file} | {judge} | {stated:.4f} | {seen:.4f} |")


def nearest_chains(run, folder, data):
    """Whether any chain of frames is nearer to a model than the exported one, over its trained ranges at 5 kg."""
    rng = np.random.default_rng(3)
    print("\n| arm | exported: mean, 95 % | least squares by numpy | smallest mean by numpy |\n|---|---|---|---|")
    for kind in ["paper", "rich", "wild"]:
        blob = f"{kind}.blob"
        train = data / f"irb4400_{kind}_s0_train.csv"
        run("calibrate", "--robot", "abb-irb4400-serial", train, "--method", "elastic", "--out", blob)
        ranges = [j["trained"] for j in json.loads(run("inspect", blob, "--json", "-"))["robot"]["joints"]]
        run("export", blob, "--payload-kg", 5, "--poe", f"{kind}.json")
        table = json.loads((folder / f"{kind}.json").read_text())
        chain = by_table(table)
        instrument = from_rpy(*[table["instrument_from_base"][key] for key in ["xyz_m", "rpy_rad"]])
        forward = lambda q: instrument @ chain(q)
        joints = rng.uniform(*np.array(ranges).T, (POSES_FITTED + POSES_JUDGED, len(ranges)))
        exported, wanted = evaluated(run, folder, blob, forward, joints)
        frames = [from_rpy(joint["origin"]["xyz_m"], joint["origin"]["rpy_rad"]) for joint in table["joints"]]
        ends = [table["flange"]["origin"], table["flange_from_target"]]
        frames[0] = instrument @ frames[0]
        frames.append(np.linalg.multi_dot([from_rpy(end["xyz_m"], end["rpy_rad"]) for end in ends]))
        start = [(1e3 * frame[:3, 3], frame[:3, :3]) for frame in frames]
        fitted = (joints[:POSES_FITTED], wanted[:POSES_FITTED])
        compared = (joints[POSES_FITTED:], wanted[POSES_FITTED:])
        left = [floor.distances(start, *compared), *floor.floors(start, fitted, compared)]
        said = " | ".join(f"{d.mean():.4f}, {np.percentile(d, 95):.4f}" for d in left)
        print(f"| `{kind}` | {said} |")
        assert abs(left[0].mean() / exported - 1) < 0.02
        if left[0].mean() > (1 + AS_NEAR_AS) * left[1].mean():
            sys.exit(f"{kind}: another chain is nearer")


def main():
    trainer, root, folder = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    urdfs = root / "tests/data/urdf"

    def run(*words):
        done = subprocess.run([trainer, *map(str, words)], cwd=folder, capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(f"{words}: {done.stdout}{done.stderr}")
        return done.stdout

    rng = np.random.default_rng(1)
    worst = (0.0, 0.0)
    rows = []
    for name in BUILT_IN + sorted(urdfs.glob("*.urdf")):
        robot, name = str(name), Path(name).stem
        run("simulate", "--robot", robot, "--poses", 60, "--test-sets", 0, "--seed", 3, "--out", name)
        run("calibrate", "--robot", robot, f"{name}/train.csv", "--method", "poe", "--out", f"{name}.blob")
        nominal = ["--urdf", robot] if robot.endswith(".urdf") else []
        urdf = folder / f"{name}.urdf"
        for kind in ["json", "toml", "csv"]:
            tables = [word for table in TABLES for word in [f"--{table}", f"{name}-{table}.{kind}"]]
            others = ["--target-link", "probe", "--mjcf", f"{name}.xml"]
            run("export", f"{name}.blob", *nominal, "--out", urdf, *others, *tables)
        run("export", f"{name}.blob", "--c-header", f"{name}.h")
        chain = Chain((folder / f"{name}.h").read_text())
        joints = [j["name"] for j in json.loads((folder / f"{name}-poe.json").read_text())["joints"]]
        base = {"workbench": "table", "no_tool0": "base"}.get(name, "base_link")
        readers = {
            "Pinocchio": by_pinocchio(urdf, joints, base, "probe"),
            "yourdfpy": by_yourdfpy(urdf, joints, base, "probe"),
            "MuJoCo": by_mujoco(folder / f"{name}.xml", joints, "target"),
        }
        for kind in TABLES:
            readers[f"{kind}, JSON"] = by_table(json.loads((folder / f"{name}-{kind}.json").read_text()))
            readers[f"{kind}, TOML"] = by_table(tomllib.loads((folder / f"{name}-{kind}.toml").read_text()))
            readers[f"{kind}, CSV"] = by_table(by_csv(folder / f"{name}-{kind}.csv", kind))
        if name.startswith("ur"):
            said = run("export", f"{name}.blob", "--ur-kinematics", f"{name}.yaml")
            told = re.search(r"tool0 to target: (\S+) (\S+) (\S+) mm, roll pitch yaw (\S+) (\S+) (\S+)°", said).groups()
            told = [float(x) for x in told]
            near = from_rpy(np.array(told[:3]) / 1e3, np.radians(told[3:]))
            # The TCP is printed to 0.1 µm: the exact one is what is left at one pose, and must fit all others.
            zero = np.zeros(6)
            exact = np.linalg.inv(by_ur(folder / f"{name}.yaml", np.eye(4))(zero)) @ chain.forward(zero)
            assert apart(near, exact)[0] < 1e-6
            readers["UR kinematics"] = by_ur(folder / f"{name}.yaml", exact)
        poses = rng.uniform(-2.5, 2.5, (300, len(joints)))
        wanted = [chain.forward(q) for q in poses]
        for reader, forward in readers.items():
            errors = np.array([apart(forward(q), w) for q, w in zip(poses, wanted)])
            largest = errors.max(axis=0)
            rows.append((name, reader, *largest))
            worst = np.maximum(worst, largest)
    print("| arm | read by | largest error, nm | nrad |\n|---|---|---|---|")
    for name, reader, position, angle in rows:
        print(f"| {name} | {reader} | {1e9 * position:.6f} | {1e9 * angle:.6f} |")
    if worst[0] > LIMIT_M or worst[1] > LIMIT_RAD:
        sys.exit(f"beyond a nanometre: {1e9 * worst[0]:.3f} nm, {1e9 * worst[1]:.3f} nrad")
    stated_distances(run, folder, root / "tests/data/simulated", root / "calibration/robots")
    nearest_chains(run, folder, root / "tests/data/simulated")
    print(f"\nall within {1e9 * worst[0]:.6f} nm and {1e9 * worst[1]:.6f} nrad over 300 poses each")


main()
