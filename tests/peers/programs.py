"""Our programs as the peers' script calls them, the data they make, and CPU times."""

import json
import os
import pathlib
import resource
import subprocess
import sys

ROBOT = "abb-irb4400-serial"


class Programs:
    def __init__(self, binaries, folder):
        self.trainer = binaries / "trainer"
        self.peer_data = binaries / "examples" / "peer_data"
        self.folder = folder

    def example(self, *words):
        """The JSON answer of calibration/examples/peer_data.rs."""
        done = subprocess.run([self.peer_data, *map(str, words)], check=True, stdout=subprocess.PIPE)
        return json.loads(done.stdout)

    def run(self, *words):
        """A command of the trainer, which must succeed."""
        subprocess.run([self.trainer, *map(str, words)], check=True, stdout=subprocess.DEVNULL)

    def calibrate(self, train, *options):
        """The whole command: reading, both steps, the gate of single precision, writing. (CPU s, MB at most)."""
        blob = self.folder / "model.blob"
        command = [self.trainer, "calibrate", "--robot", ROBOT, train, "--out", blob, *options]
        return cpu_seconds_of(command)

    def simulated(self, scenario, poses):
        """The first `poses` rows of 2000 simulated ones."""
        cell = self.folder / f"simulated_{scenario}"
        if not (cell / "train.csv").exists():
            command = [self.trainer, "simulate", "--robot", ROBOT, "--scenario", scenario, "--poses", "2000"]
            command += ["--test-sets", "1", "--payloads", "1,2.5,5,7.5,10", "--seed", "1", "--out", cell]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        lines = (cell / "train.csv").read_text().splitlines(keepends=True)
        head = next(i for i, line in enumerate(lines) if not line.startswith("#"))
        part = cell / f"first_{poses}.csv"
        part.write_text("".join(lines[: head + 1 + poses]))
        return part


def measured_files(names):
    """Those files of the folder POEGP_MEASURED_DATA, wherever they are in it; none without the variable."""
    folder = os.environ.get("POEGP_MEASURED_DATA")
    if not folder:
        print("measured sets: NOT RUN: POEGP_MEASURED_DATA is not set", file=sys.stderr)
        return []
    found = [sorted(pathlib.Path(folder).rglob(name)) for name in names]
    missing = [name for name, paths in zip(names, found) if not paths]
    if missing:
        raise SystemExit(f"POEGP_MEASURED_DATA={folder} has no {', '.join(missing)}")
    return [paths[0] for paths in found]


def cpu_seconds_of(command):
    """(user + system seconds, peak memory in MB) of a program, which must succeed."""
    # One child at a time and waited for: the difference is its own. Peak memory needs a parent of its own.
    script = (
        "import json, resource, subprocess, sys\n"
        "subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL)\n"
        "r = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(json.dumps([r.ru_utime + r.ru_stime, r.ru_maxrss / 1024]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, *map(str, command)], check=True, stdout=subprocess.PIPE
    )
    return tuple(json.loads(done.stdout))


def own_cpu_seconds():
    """CPU seconds of this process so far."""
    r = resource.getrusage(resource.RUSAGE_SELF)
    return r.ru_utime + r.ru_stime


def print_table(title, head, rows):
    print(f"\n{title}\n")
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(str(cell) for cell in row) + " |", flush=True)
