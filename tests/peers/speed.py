"""CPU seconds of the trainer and of scikit-learn, one after the other on the same data."""

import numpy as np

import process
from programs import own_cpu_seconds, print_table


def timed(function, *arguments):
    start = own_cpu_seconds()
    result = function(*arguments)
    return result, own_cpu_seconds() - start


def table(programs):
    rows = []
    for poses, per_output, goal in [(300, False, 10), (300, True, 10), (1000, False, 5)]:
        rows.append(fit(programs, poses, per_output, goal))
    seconds, memory = programs.calibrate(programs.simulated("paper", 2000), "--method", "poe-gp-load")
    rows.append(["`poe-gp-load`, N = 2000", "–", "–", "–", "60 s", "–", f"{seconds:.2f} ({memory:.0f} MB)", "–"])
    for poses, goal in [(300, "3 s, 500 MB"), (1000, "60 s")]:
        seconds, memory = programs.calibrate(programs.simulated("paper", poses))
        rows.append([f"`elastic`, N = {poses}", "–", "–", "–", goal, "–", f"{seconds:.2f} ({memory:.0f} MB)", "–"])
    rows.append(predict(programs))
    print_table(
        "Speed: CPU seconds, user and system, one thread. Fit against fit: kernel, data, bounds and starting points are the "
        "same. Likelihood: how much larger ours is at its optimum, in nats per point, all outputs together. Beside it the "
        "whole command `trainer calibrate`: it reads, fits the chain, fits the process again where single precision asks "
        "for it, checks and writes.",
        ["", "our fit", "scikit-learn's", "ratio", "goal", "likelihood", "whole command", "its ratio"],
        rows,
    )


def fit(programs, poses, per_output, goal):
    train = programs.simulated("paper", poses)
    options = ["--method", "poe-gp-load"] + (["--per-output"] if per_output else [])
    whole = min(programs.calibrate(train, *options)[0] for _ in range(3))
    given = programs.example("processes" if per_output else "process", "abb-irb4400-serial", train)
    ours = given["per_output" if per_output else "shared"]
    inputs, outputs = np.array(given["inputs"]), np.array(given["outputs"])
    targets = list(outputs.T) if per_output else [outputs]
    processes, theirs = timed(process.fit_each if per_output else process.fit_one, inputs, outputs)
    if poses < 500:
        # The better of three, like ours.
        again = process.fit_each if per_output else process.fit_one
        theirs = min(theirs, *(timed(again, inputs, outputs)[1] for _ in range(2)))
    # Our optimum, judged by their likelihood.
    lead = 0.0
    for one, mine, target in zip(processes, ours["processes"], targets):
        theta = process.log_parameters(mine["theta"])
        value = one.log_marginal_likelihood(theta)
        assert abs(value - mine["log_likelihood"]) < 1e-6 * abs(value), "two different likelihoods"
        lead += (value - one.log_marginal_likelihood_value_) / len(target)
    name = f"`poe-gp-load{' --per-output' if per_output else ''}`, N = {poses}"
    seconds = ours["cpu_seconds"]
    goal = f"{goal} times, −0.001"
    ratios = f"{theirs / seconds:.1f}", f"{theirs / whole:.1f}"
    return [name, f"{seconds:.3f}", f"{theirs:.3f}", ratios[0], goal, f"{lead:+.5f}", f"{whole:.2f}", ratios[1]]


def predict(programs):
    train = programs.simulated("paper", 300)
    programs.calibrate(train, "--method", "poe-gp-load")
    many = programs.simulated("paper", 2000)
    ours = min(programs.example("predict", programs.folder / "model.blob", many, 5)["cpu_seconds"] for _ in range(3))
    given = programs.example("process", "abb-irb4400-serial", train)
    one = process.fit(np.array(given["inputs"]), np.array(given["outputs"]))
    inputs = np.array(programs.example("inputs", "abb-irb4400-serial", many)["inputs"])
    batch = np.tile(inputs, (5, 1))
    one.predict(batch[:100])
    theirs = min(timed(one.predict, batch)[1] for _ in range(3))
    name = "10 000 predictions, N = 300 (ours: poses in f32; theirs: the six outputs alone, one batch)"
    return [name, f"{ours:.4f}", f"{theirs:.4f}", f"{theirs / ours:.1f}", "0.1 s, 1 times", "–", "–", "–"]
