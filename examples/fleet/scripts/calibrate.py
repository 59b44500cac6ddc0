"""Calibrates one cell of a fleet and writes what came of it into a folder: arm.blob, report.html, calibrate.json, outcome.json.

robot.toml says how:

    robot = "abb-irb120"          # a built-in arm, or a URDF or TOML file of this folder
    measurements = "measured.csv"
    tests = ["test.csv"]          # held out; without, a fifth of the measurements at a time
    options = ["--outliers", "reject"]   # of `trainer calibrate`

Exit code 0 with an answer, and that the trainer refused the data (1 or 2 of its exit codes) is one. Anything else, as a
signal, is none: the engine tries again.
"""

import argparse
import json
import pathlib
import resource
import subprocess
import sys
import time
import tomllib

KEYS = {"robot": str, "measurements": str, "tests": list, "options": list}
OURS = {"--robot", "--out", "--json", "--report", "--test"}


class Refused(Exception):
    """robot.toml is not what is expected."""


def read(cell: pathlib.Path) -> dict:
    """The keys of robot.toml, looked at."""
    file = cell / "robot.toml"
    try:
        keys = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise Refused(f"{file}: {error}") from error
    for name, value in keys.items():
        if name not in KEYS:
            raise Refused(f'{file}: unknown key "{name}", expected one of {", ".join(KEYS)}')
        if not isinstance(value, KEYS[name]):
            raise Refused(f"{file}: {name} is {value!r}, expected a {KEYS[name].__name__}")
        if isinstance(value, list) and not all(isinstance(item, str) for item in value):
            raise Refused(f"{file}: {name} is {value!r}, expected a list of texts")
    for name in ("robot", "measurements"):
        if name not in keys:
            raise Refused(f'{file}: expected a key "{name}"')
    for option in keys.get("options", []):
        if option.split("=")[0] in OURS:
            raise Refused(f"{file}: {option} in options is given by the workflow itself; leave it out")
    return keys


def command(trainer: str, cell: pathlib.Path, out: pathlib.Path, keys: dict) -> list[str]:
    """The one command of this cell."""
    own = cell / keys["robot"]
    words = [trainer, "calibrate", "--robot", str(own) if own.is_file() else keys["robot"]]
    words += [str(cell / keys["measurements"])]
    for test in keys.get("tests", []):
        words += ["--test", str(cell / test)]
    if "--serial-number" not in keys.get("options", []):
        words += ["--serial-number", cell.name]
    words += ["--out", str(out / "arm.blob"), "--report", str(out / "report.html")]
    return [*words, "--json", str(out / "calibrate.json"), *keys.get("options", [])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trainer", default="trainer")
    parser.add_argument("--cell", type=pathlib.Path, required=True)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    out = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    outcome = {"robot": None, "state": "failed", "exit_code": 2, "message": "", "seconds": 0.0, "cpu_seconds": 0.0}
    try:
        keys = read(arguments.cell)
        outcome["robot"] = keys["robot"]
        start = time.monotonic()
        done = subprocess.run(
            command(arguments.trainer, arguments.cell, out, keys), capture_output=True, text=True, check=False
        )
        outcome["seconds"] = round(time.monotonic() - start, 1)
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        outcome["cpu_seconds"] = round(used.ru_utime + used.ru_stime, 1)
        (out / "log.txt").write_text(done.stdout + done.stderr, encoding="utf-8")
        if done.returncode not in (0, 1, 2):
            sys.exit(f"{arguments.cell}: the trainer ended with {done.returncode}\n{done.stderr}")
        outcome["exit_code"] = done.returncode
        if done.returncode == 0:
            outcome["state"] = "calibrated"
        else:
            # From the error on: notes before it are in log.txt.
            lines = done.stderr.strip().splitlines()
            first = next((i for i, line in enumerate(lines) if line.startswith("error: ")), 0)
            outcome["message"] = "\n".join(lines[first:]).removeprefix("error: ")
    except Refused as error:
        outcome["message"] = str(error)
    (out / "outcome.json").write_text(json.dumps(outcome, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
