"""What Snakemake itself costs for 5, 50 and 500 robots: seconds, peak memory and files.

The trainer is a stub here, a shell script that writes a small file for each output and calibrates nothing: seconds are those
of the engine and of the scripts of examples/fleet. Robots are copies of one simulated robot.
"""

import argparse
import json
import os
import pathlib
import shutil
import sys
import time

import check

SIZES = [5, 50, 500]

# What gather.py reads.
ERRORS = {"poses": 50, "position_mm": {"mean": 0.1, "p95": 0.2, "max": 0.3}}
FOUND = {"training_poses": 60, "blob": {"bytes": 9000}, "held_out": {"nominal": ERRORS, "calibrated": ERRORS}}

STUB = f"""#!/bin/sh
[ "$1" = calibrate ] || {{ echo "trainer 0 (a stub)"; exit; }}
while [ $# -gt 0 ]; do
    case $1 in
    --out | --report) echo stub >"$2" ;;
    --json) echo '{json.dumps(FOUND)}' >"$2" ;;
    esac
    shift
done
"""


def measured(command: list[str], folder: pathlib.Path) -> tuple[float, float, float]:
    """Seconds, CPU seconds and peak memory in MB of a command that has to succeed."""
    begin = time.monotonic()
    with (folder / "log.txt").open("wb") as log:
        process = os.posix_spawn(
            "/usr/bin/env",
            ["env", "-C", str(folder), *command],
            os.environ,
            file_actions=[(os.POSIX_SPAWN_DUP2, log.fileno(), 1), (os.POSIX_SPAWN_DUP2, log.fileno(), 2)],
        )
        _, status, used = os.wait4(process, 0)
    if status != 0:
        sys.exit(f"{command} ended with {status}:\n{(folder / 'log.txt').read_text(encoding='utf-8')}")
    return time.monotonic() - begin, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def files(folder: pathlib.Path) -> int:
    return sum(len(names) for _, _, names in os.walk(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--snakemake", required=True)
    parser.add_argument("--trainer", required=True, help="simulates the one robot")
    parser.add_argument("folder", type=pathlib.Path)
    arguments = parser.parse_args()
    shutil.rmtree(arguments.folder, ignore_errors=True)
    arguments.folder.mkdir(parents=True)
    simulate = [sys.executable, str(check.FLEET / "scripts" / "simulate.py"), "--trainer", arguments.trainer]
    check.run([*simulate, "--robots", "1", "one"], arguments.folder)
    stub = arguments.folder / "trainer"
    stub.write_text(STUB, encoding="utf-8")
    stub.chmod(0o755)
    arguments.trainer = str(stub)

    print("robots | files: robot, result, .snakemake | seconds (CPU): plan, run, nothing to do, one robot | MB, largest")
    for size in SIZES:
        folder = arguments.folder / str(size)
        for number in range(1, size + 1):
            shutil.copytree(arguments.folder / "one" / "r01", folder / "robots" / f"r{number:03}")
        everything = check.engine(arguments)
        # After `--config KEY=VALUE` a target would be one more of these.
        one = [everything[0], "results/r001/outcome.json", *everything[1:]]
        steps = [measured(command, folder) for command in ([*everything, "--dry-run"], everything, everything, [*one, "--dry-run", "--force"])]
        done = len(list(folder.glob("results/*/outcome.json")))
        check.expect(done == size, f"{done} robots of {size} are done")
        counts = [files(folder / "robots" / "r001"), files(folder / "results" / "r001"), files(folder / ".snakemake")]
        print(
            f"{size} | {', '.join(map(str, counts))} | "
            + ", ".join(f"{seconds:.1f} ({cpu:.1f})" for seconds, cpu, _ in steps)
            + f" | {max(memory for _, _, memory in steps):.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
