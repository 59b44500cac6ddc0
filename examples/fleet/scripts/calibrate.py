"""Calibrates one robot of a fleet and writes what came of it into a folder: arm.blob, report.html, calibrate.json, outcome.json.

The trainer writes all its outputs or none, and refuses to replace a signed model. An earlier result therefore stays until there
is a new one; without a new one only log.txt and outcome.json change.

project.toml, the project file of `trainer calibrate` (docs/guide/projects.md), says how; where the outputs go is said here.

Exit code 0 with an answer, and that the trainer refused the data (1, 2 or 3 of its exit codes) is one. Anything else, as a
signal or a full disk, is none: the engine tries again.
"""

import argparse
import json
import pathlib
import resource
import subprocess
import sys
import time
import tomllib


def read(file: pathlib.Path) -> dict:
    """The table `robot`; the trainer reports what is wrong with a file."""
    try:
        robot = tomllib.loads(file.read_text(encoding="utf-8")).get("robot")
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
        robot = None
    return robot if isinstance(robot, dict) else {}


def changed(file: pathlib.Path) -> int | None:
    """When a file was written, in ns."""
    return file.stat().st_mtime_ns if file.exists() else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trainer", default="trainer")
    parser.add_argument("--robot", type=pathlib.Path, required=True)
    parser.add_argument("--outcome", type=pathlib.Path, required=True, help="outcome.json in the folder of the results")
    parser.add_argument("--threads", type=int, default=1)
    arguments = parser.parse_args()
    folder, out = arguments.robot, arguments.outcome.parent
    out.mkdir(parents=True, exist_ok=True)
    robot = read(folder / "project.toml")
    # The trainer writes a JSON of refused data, too: such a one does not become calibrate.json.
    facts = out / ".calibrate.json"
    facts.unlink(missing_ok=True)
    report_before = changed(out / "report.html")
    command = [arguments.trainer, "calibrate", str(folder / "project.toml"), "--out", str(out / "arm.blob")]
    command += ["--report", str(out / "report.html"), "--json", str(facts)]
    command += ["--threads", str(arguments.threads)]
    if not robot.get("serial_number"):
        command += ["--serial-number", folder.name]
    start = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    seconds = time.monotonic() - start
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    (out / "log.txt").write_text(done.stdout + done.stderr, encoding="utf-8")
    is_output_lost = ": not written: " in done.stderr
    if done.returncode not in (0, 1, 2, 3) or is_output_lost:
        sys.exit(f"{folder}: the trainer ended with {done.returncode}\n{done.stderr}")
    message = ""
    if done.returncode != 0:
        # From the error on: notes before it are in log.txt.
        lines = done.stderr.strip().splitlines()
        first = next((i for i, line in enumerate(lines) if line.startswith("error: ")), 0)
        message = "\n".join(lines[first:]).removeprefix("error: ")
    if done.returncode in (0, 1) and facts.exists():
        facts.replace(out / "calibrate.json")
        # Too few poses make no report, and that of an earlier model is not one of this.
        if report_before is not None and changed(out / "report.html") == report_before:
            (out / "report.html").unlink()
        state = "calibrated" if done.returncode == 0 else "tolerance not met"
    else:
        facts.unlink(missing_ok=True)
        state = "failed"
        if (out / "arm.blob").exists():
            message += "\nnote: the model of an earlier run is still there: arm.blob"
    description = robot.get("description")
    outcome = {
        "robot": description if isinstance(description, str) else None,
        "state": state,
        "exit_code": done.returncode,
        "message": message,
        "seconds": round(seconds, 1),
        "cpu_seconds": round(used.ru_utime + used.ru_stime, 1),
    }
    beside = out / ".outcome.json"
    beside.write_text(json.dumps(outcome, indent=2) + "\n", encoding="utf-8")
    beside.replace(arguments.outcome)


if __name__ == "__main__":
    main()
