"""The most probable arm for touches by scipy's least squares, beside the trainer's: another program of the same model.

The kinematics, the equations of every kind of row, the priors and the derivatives (by differences) are this file's own. From the
trainer's JSON come what was fitted and what the peer should find: the nominal model, the scales of the priors, the noise. Balls, balls on
bars and wires are known; files with outliers are refused.
"""

import csv
import json
import tomllib

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

GRAVITY = np.array([0.0, 0.0, -9.81])
ANYWHERE = 3.0
# Most difference of a parameter, in its standard deviations after the touches, and of such a standard deviation, as a part of it.
MOST_MEAN, MOST_DEVIATION = 0.02, 0.02
# Most difference of a predicted tip, mm.
MOST_TIP = 0.002


def frame(rows):
    pose = np.eye(4)
    pose[:3] = np.reshape(rows, (3, 4))
    return pose


def small(v, w):
    """The pose exp(v, w) of a twist."""
    out = np.eye(4)
    angle = np.linalg.norm(w)
    out[:3, :3] = Rotation.from_rotvec(w).as_matrix()
    k = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    left = np.eye(3) + 0.5 * k + k @ k / 6.0
    if angle > 1e-4:
        left = np.eye(3) + (1 - np.cos(angle)) / angle**2 * k + (angle - np.sin(angle)) / angle**3 * k @ k
    out[:3, 3] = left @ v
    return out


def turns(angles):
    """Rotations about z, one for each row."""
    out = np.zeros((len(angles), 4, 4))
    c, s = np.cos(angles), np.sin(angles)
    out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = c, -s, s, c
    out[:, 2, 2] = out[:, 3, 3] = 1.0
    return out


class Arm:
    def __init__(self, record, tip):
        self.nominal = [frame(rows) for rows in record["nominal"]]
        self.parameters = record["parameters"]
        self.joints = len(self.nominal) - 1
        self.tip = np.asarray(tip)

    def tips(self, theta, q):
        """Where the tip is in the base frame, for rows of joint angles."""
        n = self.joints
        twists = np.zeros((n + 1, 6))
        position = {}
        levers, tip = np.zeros((n, n)), self.tip.copy()
        for value, parameter in zip(theta, self.parameters):
            group, i = parameter["group"], parameter["index"]
            at = position[group, i] = position.get((group, i), -1) + 1
            if group == "length":
                twists[i, at] = value
            elif group == "tilt":
                twists[i, 3 + at] = value
            elif group == "zero":
                twists[i, 5] = value
            elif group == "tip":
                tip[at] += value
            elif group == "links":
                levers[i, i + at] = value
            else:
                raise SystemExit(f"a parameter of {group}: this peer does not know it")
        frames = [d @ small(t[:3], t[3:]) for d, t in zip(self.nominal, twists)]

        def chain(angles):
            out = [np.broadcast_to(frames[0], (len(q), 4, 4))]
            for i in range(n):
                out.append(out[-1] @ turns(angles[:, i]) @ frames[i + 1])
            return out

        # Before joint i stands poses[i]; the mass of a link hangs at the far end of it, nominal.
        poses = chain(q)
        deflected = q.copy()
        for c in range(n):
            pull = np.cross(GRAVITY, poses[c][:, :3, 2])
            ends = np.zeros((len(q), 3))
            for end in range(c, n):
                lever = self.nominal[end + 1][:3, :3].T @ self.nominal[end + 1][:3, 3]
                ends = ends + poses[end + 1][:, :3, :3] @ lever
                deflected[:, c] += levers[c, end] * np.sum(pull * ends, axis=1)
        flange = chain(deflected)[n]
        return flange[:, :3, :3] @ tip + flange[:, :3, 3]


def table(path):
    with open(path) as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def angles(rows):
    names = sorted(k for k in rows[0] if k.startswith("q"))
    return np.radians([[float(row[name]) for name in names] for row in rows])


class Problem:
    """Residuals in standard deviations of the arm's parameters and of what was touched."""

    def __init__(self, folder, document):
        with open(folder / "touches.toml", "rb") as file:
            toml = tomllib.load(file)
        rows = table(folder / "touches.csv")
        self.record = document["arm"]
        if document["touches"]["outliers"]:
            raise SystemExit("outliers: this peer knows none")
        self.arm = Arm(self.record, 1e-3 * np.array(toml["target"][0]["tip_mm"]))
        self.q = angles(rows)
        self.prior = np.array([p["prior"] for p in self.record["parameters"]])
        noise = {n["kind"]: 1e-3 * np.hypot(n["stated"], n["beyond"]) for n in document["touches"]["noise"]}
        self.features, first = [], len(self.prior)
        drawn = self.arm.tips(np.zeros(len(self.prior)), self.q)
        start, width = [], []
        for feature in toml["feature"]:
            own = np.array([k for k, row in enumerate(rows) if row["feature"] == feature["name"]])
            kind = feature["kind"]
            values = [float(rows[k].get("value_mm") or 0) for k in own]
            entry = {"kind": kind, "rows": own, "first": first, "value": 1e-3 * np.array(values)}
            entry["sigma"] = noise[kind]
            if kind == "point":
                at, sd = [*drawn[own].mean(axis=0)], [ANYWHERE] * 3
            elif kind == "sphere":
                radius = 1e-3 * feature["radius_mm"]
                centre = least_squares(
                    lambda c: np.linalg.norm(drawn[own] - c, axis=1) - radius, drawn[own].mean(axis=0) - [0, 0, radius]
                ).x
                at, sd = [*centre, radius], [ANYWHERE] * 3 + [1e-3 * feature["radius_sigma_mm"]]
                # The centre is unknown, the radius nearly known: about what was said, not about what was found.
            elif kind == "anchor":
                at = [*(1e-3 * np.array(feature["position_mm"])), 0.0]
                sd = [1e-3 * feature["position_sigma_mm"]] * 3 + [1e-3 * feature["zero_sigma_mm"]]
            else:
                raise SystemExit(f"{kind}: this peer does not know it")
            self.features.append(entry)
            start += at
            width += sd
            first += len(at)
        self.start, self.width = np.array(start), np.array(width)
        names = [feature["name"] for feature in toml["feature"]]
        self.distances = [
            ([self.features[names.index(name)]["first"] for name in d["between"]], 1e-3 * d["mm"], 1e-3 * d["sigma_mm"])
            for d in toml.get("distance", [])
        ]

    def split(self, u):
        p = len(self.prior)
        return u[:p] * self.prior, np.concatenate([np.zeros(p), self.start + u[p:] * self.width])

    def residuals(self, u):
        theta, y = self.split(u)
        x = self.arm.tips(theta, self.q)
        out = [u]
        for f in self.features:
            at, own = x[f["rows"]], y[f["first"] :]
            if f["kind"] == "point":
                missed = (at - own[:3]).ravel()
            else:
                # Of a sphere the radius and what the gauge reads, of a wire the reading and its zero.
                missed = np.linalg.norm(at - own[:3], axis=1) - own[3] - f["value"]
            out.append(missed / f["sigma"])
        for (a, b), length, sigma in self.distances:
            out.append([(np.linalg.norm(y[a : a + 3] - y[b : b + 3]) - length) / sigma])
        return np.concatenate(out)


def compare(folder, document):
    """(parameters, largest difference of one in its standard deviations, of these as a part of them, of a tip in mm)."""
    problem = Problem(folder, document)
    count = len(problem.prior)
    found = least_squares(
        problem.residuals, np.zeros(count + len(problem.start)), method="trf", x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12
    )
    step = 1e-4
    jacobian = np.column_stack(
        [
            (problem.residuals(found.x + step * e) - problem.residuals(found.x - step * e)) / (2 * step)
            for e in np.eye(len(found.x))
        ]
    )
    covariance = np.linalg.inv(jacobian.T @ jacobian)[:count, :count]
    theirs = np.array([p["value"] for p in problem.record["parameters"]]) / problem.prior
    lower = np.zeros((count, count))
    lower[np.tril_indices(count)] = problem.record["covariance"]
    deviations = np.sqrt(np.diag(covariance))
    means = np.abs(found.x[:count] - theirs) / deviations
    spreads = np.abs(np.sqrt(np.diag(lower)) / deviations - 1)
    truth = angles(table(folder / "truth.csv"))
    tips = [problem.arm.tips(u * problem.prior, truth) for u in (found.x[:count], theirs)]
    apart = 1e3 * np.linalg.norm(tips[0] - tips[1], axis=1)
    return count, means.max(), spreads.max(), apart.max()


def check(programs):
    """The table, and whether every row is within what is demanded."""
    print("| touched | parameters | of a parameter, σ | of its σ, % | of a tip, mm |\n|---|---|---|---|---|")
    good = True
    for kinds, touches in (("socket2", 40), ("wire1", 60), ("ballbar4", 80), ("socket2,wire1", 20)):
        folder = programs.folder / f"touched_{kinds.replace(',', '_')}"
        programs.run("simulate", "--robot", "abb-irb120", "--touch", kinds, "--touches", touches, "--seed", 3, "--out", folder)
        programs.run(
            "calibrate", "--robot", "abb-irb120", folder / "touches.csv", "--out", folder / "arm.blob", "--json", folder / "arm.json"
        )
        document = json.loads((folder / "arm.json").read_text())
        count, mean, spread, tip = compare(folder, document)
        print(f"| {kinds}, {touches} of each | {count} | {mean:.4f} | {100 * spread:.2f} | {tip:.5f} |")
        good &= mean <= MOST_MEAN and spread <= MOST_DEVIATION and tip <= MOST_TIP
    if not good:
        raise SystemExit(f"more than {MOST_MEAN} σ, {100 * MOST_DEVIATION:.0f} % or {MOST_TIP} mm apart")
