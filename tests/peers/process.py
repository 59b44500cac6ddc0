"""The paper's Gaussian process by scikit-learn: the same kernel, bounds, starting points and data as the trainer's."""

import warnings

import numpy as np
import scipy.optimize
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, DotProduct, WhiteKernel

# Of calibration/src/learning/task_space/fit.rs: signal variance, inverse squared lengthscale, constant, linear, noise variance.
BOUNDS = [(1e-4, 1e4), (1e-4, 1e2), (1e-8, 1e4), (1e-8, 1e4), (1e-6, 1e1)]
STARTS = [(1.0, 0.1, 0.1, 0.01, 0.05), (1.0, 1.0, 0.1, 0.01, 0.3)]

# Where both optimisers end on the bounds, or one gives up early, the likelihood in the table says so.
warnings.simplefilter("ignore", ConvergenceWarning)


def log_parameters(theta):
    """scikit-learn's parameters: logarithms, and a lengthscale in place of its inverse square."""
    signal, rate, constant, linear, noise = theta
    return np.log([signal, rate**-0.5, constant, linear, noise])


def kernel():
    s, r, c, l, n = BOUNDS
    return (
        ConstantKernel(1.0, s) * RBF(1.0, (r[1] ** -0.5, r[0] ** -0.5))
        + ConstantKernel(1.0, c)
        + ConstantKernel(1.0, l) * DotProduct(0.0, "fixed")
        + WhiteKernel(1.0, n)
    )


def from_the_same_starts(objective, _initial, bounds):
    """What scikit-learn does from one start and random restarts, from the trainer's two starts."""
    runs = [
        scipy.optimize.minimize(objective, log_parameters(start), method="L-BFGS-B", jac=True, bounds=bounds)
        for start in STARTS
    ]
    best = min(runs, key=lambda run: run.fun)
    return best.x, best.fun


def fit(inputs, outputs):
    """The fitted process; outputs that come together share their hyperparameters."""
    process = GaussianProcessRegressor(kernel(), alpha=0.0, optimizer=from_the_same_starts, copy_X_train=False)
    return process.fit(inputs, outputs)


def fit_one(inputs, outputs):
    """One process for all outputs."""
    return [fit(inputs, outputs)]


def fit_each(inputs, outputs):
    """A process for each output."""
    return [fit(inputs, outputs[:, c]) for c in range(outputs.shape[1])]
