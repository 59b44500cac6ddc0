"""The fleet's workflow on a Slurm cluster of one node: a job, the daemons and Snakemake are killed, and the table has to be that
of a run on this machine without any of it.

Every start and end of the trainer is written down by a script that stands before it. So it is counted, by neither Snakemake nor
Slurm, that no robot is calibrated twice unless an interruption hit it, and no more often than it was hit.
"""

import argparse
import collections
import filecmp
import os
import pathlib
import shlex
import shutil
import signal
import subprocess
import sys
import time

import check
from cluster import Cluster, NotStarted, adopt_orphans, descendants, end_all

RECORDER = """#!/bin/sh
[ "$1" = calibrate ] || exec {trainer} "$@"
name=$(basename "$(dirname "$2")")
echo "start $name $SLURM_JOB_ID" >>{runs}
{trainer} "$@"
code=$?
echo "end $name $SLURM_JOB_ID $code" >>{runs}
exit $code
"""


class Runs:
    """Starts and ends of the trainer, as they happen."""

    def __init__(self, file: pathlib.Path) -> None:
        self.file = file
        self.file.touch()

    def lines(self) -> list[list[str]]:
        return [line.split() for line in self.file.read_text(encoding="utf-8").splitlines()]

    def starts(self) -> collections.Counter:
        return collections.Counter(name for what, name, *_ in self.lines() if what == "start")

    def ended(self) -> set[str]:
        return {name for what, name, *_ in self.lines() if what == "end"}

    def going_on(self) -> dict[str, str]:
        """Slurm's job of each robot whose trainer has started and not ended."""
        jobs = {}
        for what, name, job, *_ in self.lines():
            if what == "start":
                jobs[name] = job
            else:
                jobs.pop(name, None)
        return jobs


class Fleet:
    """Snakemake in the foreground of the test, and what has hit which robot."""

    def __init__(self, arguments: argparse.Namespace, folder: pathlib.Path, runs: Runs) -> None:
        self.arguments, self.folder, self.runs = arguments, folder, runs
        self.hits: collections.Counter = collections.Counter()
        self.log = folder / "snakemake.log"
        self.process: subprocess.Popen | None = None

    def command(self, *more: str) -> list[str]:
        if self.arguments.seconds_between_checks:
            more += ("--slurm-init-seconds-before-status-checks", str(self.arguments.seconds_between_checks))
        return check.engine(self.arguments, *more, profile="slurm")

    def start(self) -> None:
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(self.command(), cwd=self.folder, stdout=log, stderr=log, start_new_session=True)

    def booked(self) -> set[str]:
        return check.booked(self.log.read_text(encoding="utf-8"))

    def wait_until(self, holds, what: str, seconds: float = 1800) -> None:
        deadline = time.monotonic() + seconds
        while not holds():
            if self.process.poll() is not None:
                sys.exit(f"fleet: Snakemake ended before {what}:\n{self.log.read_text(encoding='utf-8')}")
            if time.monotonic() > deadline:
                sys.exit(f"fleet: not after {seconds:.0f} s: {what}:\n{self.log.read_text(encoding='utf-8')}")
            time.sleep(0.02)

    def kill_job(self, cluster: Cluster) -> str:
        """Cancels the job of a robot whose trainer runs, as an administrator would; which it was."""
        while True:
            self.wait_until(self.runs.going_on, "a trainer runs")
            name, job = next(iter(self.runs.going_on().items()))
            cluster.ask("scancel", job)
            self.wait_until(lambda: job not in cluster.ask("squeue", "-h", "-o", "%i").split(), f"job {job} is gone", 60)
            # It may have been faster than the signal.
            if self.runs.going_on().get(name) == job:
                self.hits[name] += 1
                return name

    def kill_daemons(self, cluster: Cluster, seconds: float) -> set[str]:
        """For so long there is no Slurm; the robots whose trainers ran then."""
        hit = set(self.runs.going_on())
        cluster.kill_slurm()
        time.sleep(seconds)
        cluster.start_slurm()
        hit |= set(self.runs.going_on())
        self.hits.update(hit)
        return hit

    def kill_snakemake(self, cluster: Cluster) -> tuple[set[str], set[str]]:
        """Kills it and, as its user has to, its jobs; robots that were being calibrated, and those that were and it did not know."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        cluster.ask("scancel", "--me")
        cluster.wait_for(cluster.is_idle, "jobs are left after scancel", 120)
        booked, ended = self.booked(), self.runs.ended()
        lost = {name for name in self.runs.starts() if name not in booked}
        self.hits.update(lost)
        return lost - ended, lost & ended

    def finish(self) -> None:
        check.run(self.command("--unlock"), self.folder)
        self.start()
        if self.process.wait() != 0:
            sys.exit(f"fleet: the last run ended with {self.process.returncode}:\n{self.log.read_text(encoding='utf-8')}")


def compare(local: pathlib.Path, slurm: pathlib.Path) -> int:
    """The tables and all blobs, byte for byte; how many blobs."""
    blobs = sorted(file.relative_to(local) for file in local.glob("results/*/arm.blob"))
    for file in [pathlib.Path("results", "fleet.csv"), *blobs]:
        check.expect((slurm / file).is_file(), f"{file} is missing on Slurm")
        check.expect(filecmp.cmp(local / file, slurm / file, shallow=False), f"{file} differs between this machine and Slurm")
    return len(blobs)


def interrupted(fleet: Fleet, cluster: Cluster, arguments: argparse.Namespace) -> str:
    """The interruptions, one after the other, and the run that ends; what happened."""
    said = []
    fleet.start()
    fleet.wait_until(lambda: len(fleet.runs.ended()) >= arguments.robots // 6, "some robots are done")
    said.append(f"job of {fleet.kill_job(cluster)} killed")
    if arguments.seconds_without_slurm:
        fleet.wait_until(lambda: len(fleet.runs.ended()) >= arguments.robots // 3, "a third is done")
        hit = fleet.kill_daemons(cluster, arguments.seconds_without_slurm)
        said.append(f"slurmctld and slurmd killed for {arguments.seconds_without_slurm} s while {len(hit)} trainers ran")
    # Of a sample none is noted by then: Snakemake asks too seldom.
    fleet.wait_until(lambda: len(fleet.booked()) >= arguments.robots // 4 * 2 and fleet.runs.going_on(), "half of them are noted")
    booked = len(fleet.booked())
    running, unknown = fleet.kill_snakemake(cluster)
    said.append(f"Snakemake killed when it knew {booked} as done, {len(running)} ran and {len(unknown)} were done without its knowledge")
    fleet.finish()
    return "; ".join(said)


def count(fleet: Fleet, robots: int) -> str:
    """Nothing lost, nothing twice but what was hit."""
    starts = fleet.runs.starts()
    check.expect(len(starts) == robots, f"{len(starts)} robots of {robots} were calibrated")
    check.expect(not fleet.runs.going_on().keys() - fleet.runs.ended(), f"no end: {fleet.runs.going_on()}")
    for name, number in sorted(starts.items()):
        check.expect(number <= 1 + fleet.hits[name], f"{name} was calibrated {number} times and interrupted {fleet.hits[name]} times")
    again = {name: number for name, number in starts.items() if number > 1}
    return f"{sum(starts.values())} calibrations of {robots} robots: {len(again)} more than once, all of them interrupted"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--snakemake", required=True)
    parser.add_argument("--trainer", required=True)
    parser.add_argument("--robots", type=int, required=True)
    parser.add_argument("--poses", type=int, required=True)
    parser.add_argument("--seconds-without-slurm", type=int, default=0, help="0: the daemons are not killed")
    parser.add_argument("--seconds-between-checks", type=int, help="instead of the profile's")
    parser.add_argument("folder", type=pathlib.Path)
    arguments = parser.parse_args()
    folder = arguments.folder
    adopt_orphans()
    for stop in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(stop, lambda number, _: sys.exit(f"fleet: ended by signal {number}"))
    # Blobs hold the day.
    os.environ.setdefault("SOURCE_DATE_EPOCH", str(int(time.time())))

    shutil.rmtree(folder, ignore_errors=True)
    local, slurm = folder / "local", folder / "slurm"
    local.mkdir(parents=True)
    robots = [sys.executable, str(check.FLEET / "scripts" / "simulate.py"), "--trainer", arguments.trainer, "--broken"]
    check.run([*robots, "--robots", str(arguments.robots), "--poses", str(arguments.poses), "robots"], local)
    shutil.copytree(local / "robots", slurm / "robots")
    begin = time.monotonic()
    check.run(check.engine(arguments), local)
    seconds_local = time.monotonic() - begin

    recorder, file = slurm / "trainer", slurm / "runs.txt"
    recorder.write_text(RECORDER.format(trainer=shlex.quote(arguments.trainer), runs=shlex.quote(str(file))), encoding="utf-8")
    recorder.chmod(0o755)
    arguments.trainer = str(recorder)
    try:
        begin = time.monotonic()
        with Cluster(folder / "cluster") as cluster:
            fleet = Fleet(arguments, slurm, Runs(file))
            said = interrupted(fleet, cluster, arguments)
            counted = count(fleet, arguments.robots + 1)
            blobs = compare(local, slurm)
            check.expect(cluster.is_idle(), f"jobs are left: {cluster.ask('squeue')}")
            again = check.run(fleet.command("--dry-run"), slurm)
            check.expect("Nothing to be done" in again, f"a further run does something:\n{again}")
            left = cluster.stop()
            check.expect(not left, f"{len(left)} processes are left: {left}")
    except NotStarted as error:
        print(f"NOT RUN: the fleet on Slurm: no cluster: {error}", file=sys.stderr)
        return
    finally:
        end_all()
        assert not descendants()
    print(
        f"fleet on Slurm: {said}\n"
        f"fleet on Slurm: {counted}; the table and {blobs} blobs have the bytes of the run on this machine; no process is left;"
        f" {seconds_local:.0f} s on this machine, {time.monotonic() - begin:.0f} s on Slurm"
    )


if __name__ == "__main__":
    main()
