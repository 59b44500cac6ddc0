#!/usr/bin/env python3
"""Writes gp_likelihood.json and gp_optimum.json: what scikit-learn says about the paper's Gaussian process (eq. 5).

The kernel is ConstantKernel * RBF + ConstantKernel + ConstantKernel * DotProduct(sigma_0 = 0) + WhiteKernel; theta_1 of
the paper is 1/length_scale**2. Outputs are divided by their RMS first. Nothing of this repository is used: the residuals
of gp_optimum.json come from the base-tool fit and the step 1 below, in numpy, on ../simulated.

    python make_gp.py        # Python 3.11, numpy 2.4.6, scipy 1.17.1, scikit-learn 1.9.1; seeded; under a minute
"""

import json
import pathlib
import warnings

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct, WhiteKernel

FOLDER = pathlib.Path(__file__).parent
TRAIN = FOLDER.parent / "simulated" / "irb4400_paper_s0_train.csv"


def kernel(theta, noise, bounds):
    return (
        ConstantKernel(theta[0], bounds) * RBF(theta[1] ** -0.5, bounds)
        + ConstantKernel(theta[2], bounds)
        + ConstantKernel(theta[3], bounds) * DotProduct(0.0, "fixed")
        + WhiteKernel(noise, bounds)
    )


def hyperparameters(fitted):
    """theta_0 .. theta_3 and the noise variance of a kernel as above."""
    signal, length, constant, slope, noise = np.exp(fitted.theta)
    return [signal, length**-2, constant, slope, noise]


def likelihoods(rng):
    """Value, gradient and predictions at fixed hyperparameters, for synthetic residuals of 80 poses."""
    x = np.column_stack([rng.uniform(-1.4, 1.4, (80, 6)), rng.choice([1, 2.5, 3.5, 5, 7.5], 80)])
    x_test = np.column_stack([rng.uniform(-1.6, 1.6, (20, 6)), rng.uniform(0, 9, 20)])
    smooth = np.sin(x @ rng.normal(0, 0.5, (7, 6))) + 0.1 * x @ rng.normal(0, 1, (7, 6))
    y = (smooth + rng.normal(0, 0.1, (80, 6))) * [9e-4, 7e-4, 6e-4, 4e-4, 3e-4, 5e-4]
    scale = np.sqrt((y**2).mean(axis=0))
    cases = []
    for theta, noise in [([1, 0.1, 0.1, 0.01], 0.05), ([2.5, 0.6, 1e-3, 0.3], 0.004), ([30, 0.02, 5, 1e-4], 0.3)]:
        per_output, gradients, means, variances = [], [], [], []
        for c in range(6):
            gp = GaussianProcessRegressor(kernel(theta, noise, (1e-5, 1e5)), alpha=0.0, optimizer=None)
            gp.fit(x, y[:, c] / scale[c])
            value, gradient = gp.log_marginal_likelihood(gp.kernel_.theta, eval_gradient=True)
            gradient[1] *= -0.5  # by log theta_1 = -2 log length_scale
            mean, std = gp.predict(x_test, return_std=True)
            # The variance of the latent function, without the noise that scikit-learn adds: not by subtraction.
            latent = gp.kernel_.k1
            solved = solve_triangular(gp.L_, latent(x, x_test), lower=True)
            variance = latent.diag(x_test) - (solved**2).sum(axis=0)
            assert np.allclose(variance + noise, std**2, rtol=1e-9, atol=0)
            per_output.append(value)
            gradients.append(gradient.tolist())
            means.append(mean * scale[c])
            variances.append(variance * scale[c] ** 2)
        cases.append(
            {
                "theta": [float(t) for t in theta],
                "noise_variance": noise,
                "log_likelihood": per_output,
                "log_likelihood_sum": float(np.sum(per_output)),
                "gradient": gradients,
                "gradient_sum": np.sum(gradients, axis=0).tolist(),
                "mean": np.column_stack(means).tolist(),
                "std": np.sqrt(np.column_stack(variances)).tolist(),
            }
        )
    return {"X": x.tolist(), "Y": y.tolist(), "X_test": x_test.tolist(), "cases": cases}


def homogeneous(rotation, translation):
    out = np.tile(np.eye(4), rotation.shape[:-2] + (1, 1))
    out[..., :3, :3] = rotation
    out[..., :3, 3] = translation
    return out


def nominal_frames():
    """The IRB 4400's fixed frames with every joint about z, and the flange."""
    about_y = Rotation.from_euler("x", -90, degrees=True).as_matrix()  # its z axis is the parent's y axis
    about_x = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    axes = [np.eye(3), about_y, about_y, about_x, about_y, about_x]
    origins = [[0, 0, 0], [0.2, 0, 0.68], [0, 0, 0.89], [0, 0, 0.15], [0.88, 0, 0], [0, 0, 0]]
    frames, before = [], np.eye(3)
    for axis, origin in zip(axes, origins):
        frames.append(homogeneous(before.T @ axis, before.T @ np.array(origin, dtype=float)))
        before = axis
    flange = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    frames.append(homogeneous(before.T @ flange, before.T @ np.array([0.14, 0, 0])))
    return np.array(frames)


def skew(w):
    zero = np.zeros_like(w[..., 0])
    rows = [[zero, -w[..., 2], w[..., 1]], [w[..., 2], zero, -w[..., 0]], [-w[..., 1], w[..., 0], zero]]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def series(matrix, factorials):
    return sum(np.linalg.matrix_power(matrix, k) / f for k, f in enumerate(factorials))


def exp(twist):
    """exp of a small twist (v, w) by its series."""
    hat = np.zeros((4, 4))
    hat[:3, :3], hat[:3, 3] = skew(twist[3:]), twist[:3]
    return series(hat, np.cumprod([1.0] + list(range(1, 20))))


def log(pose):
    """Twists (v, w) of poses."""
    w = Rotation.from_matrix(pose[:, :3, :3]).as_rotvec()
    jacobian = series(skew(w), np.cumprod(range(1, 21), dtype=float))
    return np.column_stack([np.linalg.solve(jacobian, pose[:, :3, 3:])[..., 0], w])


def inverse(pose):
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    return homogeneous(rotation, -(rotation @ pose[..., :3, 3:])[..., 0])


def prefixes(frames, q):
    """Where each fixed frame begins, and the target, k x 8 of them."""
    at, out = np.tile(np.eye(4), (len(q), 1, 1)), []
    for i in range(7):
        out.append(at)
        at = at @ frames[i]
        if i < 6:
            zero = np.zeros((len(q), 3))
            at = at @ homogeneous(Rotation.from_rotvec(q[:, i : i + 1] * [0, 0, 1]).as_matrix(), zero)
    return out, at


def adjoint(pose):
    rotation = pose[:, :3, :3]
    out = np.zeros((len(pose), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = rotation
    out[:, :3, 3:] = skew(pose[:, :3, 3]) @ rotation
    return out


def base_tool(q, measured):
    """instrument_from_base and flange_from_target of the nominal arm: metres and radians alike, rotation at the tool."""
    nominal = nominal_frames()
    flange = prefixes(nominal, q)[1]

    def pose(p):
        return homogeneous(Rotation.from_rotvec(p[3:6]).as_matrix(), p[:3])

    def residuals(p):
        predicted = pose(p[:6]) @ flange @ pose(p[6:])
        turn = measured[:, :3, :3] @ np.swapaxes(predicted[:, :3, :3], 1, 2)
        return np.column_stack([measured[:, :3, 3] - predicted[:, :3, 3], Rotation.from_matrix(turn).as_rotvec()]).ravel()

    rng = np.random.default_rng(1)
    best = None
    for _ in range(40):
        start = np.concatenate([np.zeros(3), rng.normal(0, 1.5, 3), np.zeros(3), rng.normal(0, 1.5, 3)])
        found = least_squares(residuals, start, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if best is None or found.cost < best.cost:
            best = found
    return pose(best.x[:6]), pose(best.x[6:])


def step1_residuals():
    """Inputs [q, m] and residual twists after the paper's step 1, in the base frame of the base-tool fit."""
    table = np.genfromtxt(TRAIN, delimiter=",", names=True)
    column = lambda names: np.column_stack([table[name] for name in names])
    q = np.radians(column([f"q{i}_deg" for i in range(1, 7)]))
    turned = Rotation.from_quat(column(["qx", "qy", "qz", "qw"])).as_matrix()
    measured = homogeneous(turned, column(["x_mm", "y_mm", "z_mm"]) / 1e3)
    instrument_from_base, flange_from_target = base_tool(q, measured)
    measured = inverse(instrument_from_base) @ measured
    frames = nominal_frames()
    frames[6] = frames[6] @ flange_from_target
    for _ in range(20):
        before, predicted = prefixes(frames, q)
        residual = log(measured @ inverse(predicted))
        jacobian = np.concatenate([adjoint(at) for at in before], axis=2).reshape(-1, 42)
        step = np.linalg.pinv(jacobian, rcond=1e-10) @ residual.ravel()
        frames = np.array([exp(step[6 * i : 6 * i + 6]) @ frame for i, frame in enumerate(frames)])
    residual = log(measured @ inverse(prefixes(frames, q)[1]))
    return np.column_stack([q, table["payload_kg"]]), residual


def optimum():
    """The largest likelihoods that scikit-learn finds, all six outputs together and each alone."""
    x, y = step1_residuals()
    scaled = y / np.sqrt((y**2).mean(axis=0))

    def best(outputs):
        start = kernel([1, 0.1, 0.1, 0.01], 0.05, (1e-5, 1e5))
        gp = GaussianProcessRegressor(start, alpha=0.0, n_restarts_optimizer=3, random_state=1).fit(x, outputs)
        value = gp.log_marginal_likelihood_value_
        print(f"{value:.4f}", hyperparameters(gp.kernel_), flush=True)
        return {"log_likelihood": float(value), "hyperparameters": hyperparameters(gp.kernel_)}

    return {
        "residuals": y.tolist(),
        "shared": best(scaled),
        "per_output": [best(scaled[:, c]) for c in range(6)],
    }


def write(name, document):
    text = json.dumps(document, indent=0).replace("\n", "").replace("],[", "],\n[").replace(',"', ',\n"')
    (FOLDER / name).write_text(text + "\n")


if __name__ == "__main__":
    warnings.filterwarnings("ignore", module="sklearn")
    write("gp_likelihood.json", likelihoods(np.random.default_rng(20260501)))
    write("gp_optimum.json", optimum())
