"""The fleet's workflow on a Slurm cluster of one node: a job, the daemons and Snakemake are killed, and the table has to be that
of a run on this machine without any of it.

A script that stands before the trainer writes down each start and end with Slurm's job. Every robot has to have started exactly
once in a job that Slurm calls completed, and every other start has to be in a job that an interruption hit.
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

# More than Snakemake waits between two looks at its jobs, and than an interruption lasts.
SECONDS_WITHOUT_PROGRESS = 300

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

    def starts(self) -> list[tuple[str, str]]:
        """Robots with Slurm's job."""
        return [(name, job) for what, name, job, *_ in self.lines() if what == "start"]

    def ends(self) -> int:
        return sum(line[0] == "end" for line in self.lines())

    def going_on(self) -> dict[str, str]:
        """Slurm's job of each robot whose trainer has started and written no end."""
        jobs = {}
        for what, name, job, *_ in self.lines():
            if what == "start":
                jobs[name] = job
            else:
                jobs.pop(name, None)
        return jobs


class Fleet:
    """Snakemake, and the jobs that an interruption has hit."""

    def __init__(self, arguments: argparse.Namespace, folder: pathlib.Path, runs: Runs) -> None:
        self.arguments, self.folder, self.runs = arguments, folder, runs
        # Slurm's jobs.
        self.hit: set[str] = set()
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

    def training(self) -> dict[str, str]:
        """Slurm's job of each robot whose trainer runs."""
        return {name: job for name, job in self.runs.going_on().items() if job not in self.hit}

    def wait_until(self, holds, what: str, ends: bool = False) -> None:
        """Waits as long as anything goes on; Snakemake has to live unless the wait is for its end."""
        seen, when = None, time.monotonic()
        while not holds():
            if not ends and self.process.poll() is not None:
                sys.exit(f"fleet: Snakemake ended before {what}:\n{self.log.read_text(encoding='utf-8')}")
            now = (self.log.stat().st_size, self.runs.file.stat().st_size)
            if now != seen:
                seen, when = now, time.monotonic()
            elif time.monotonic() - when > SECONDS_WITHOUT_PROGRESS:
                sys.exit(f"fleet: nothing happens, waiting until {what}:\n{self.log.read_text(encoding='utf-8')}")
            time.sleep(0.02)

    def kill_job(self, cluster: Cluster) -> str:
        """Cancels the job of a robot whose trainer runs, as an administrator would; which it was."""
        while True:
            self.wait_until(self.training, "a trainer runs")
            name, job = next(iter(self.training().items()))
            cluster.ask("scancel", job)
            # The signal may come when the trainer has ended and its job has not.
            self.hit.add(job)
            self.wait_until(lambda: job in cluster.states(), f"job {job} has ended")
            # The job may have been faster than the signal.
            if cluster.states()[job] != "COMPLETED":
                return name

    def kill_daemons(self, cluster: Cluster, seconds: float) -> int:
        """For so long there is no Slurm; how many jobs ran at its end."""
        jobs = set(cluster.jobs("running"))
        cluster.kill_slurm()
        # A waiting job may have started in between.
        jobs |= set(self.runs.going_on().values())
        time.sleep(seconds)
        cluster.start_slurm()
        self.hit |= jobs
        return len(jobs)

    def kill_snakemake(self, cluster: Cluster) -> str:
        """Kills it and, as its user may, its jobs; otherwise they end by themselves."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        running, waiting, known = cluster.jobs("running"), cluster.jobs("pending"), len(self.booked())
        if self.arguments.let_jobs_end:
            self.wait_until(cluster.is_idle, "all jobs have ended", ends=True)
            return f"Snakemake killed when it knew {known} robots as done; its {len(running) + len(waiting)} jobs went on"
        # A waiting job may start before the signal comes.
        self.hit |= {*running, *waiting}
        cluster.ask("scancel", "--me")
        cluster.wait_for(cluster.is_idle, "jobs are left after scancel", 120)
        return f"Snakemake killed when it knew {known} robots as done, its {len(running)} running and {len(waiting)} waiting jobs cancelled"

    def finish(self) -> None:
        check.run(self.command("--unlock"), self.folder)
        self.start()
        self.wait_until(lambda: self.process.poll() is not None, "Snakemake has ended", ends=True)
        if self.process.returncode != 0:
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
    fleet.wait_until(lambda: fleet.runs.ends() >= arguments.robots // 6, "some robots are done")
    said.append(f"job of {fleet.kill_job(cluster)} killed")
    if arguments.seconds_without_slurm:
        fleet.wait_until(lambda: fleet.runs.ends() >= arguments.robots // 3, "a third is done")
        jobs = fleet.kill_daemons(cluster, arguments.seconds_without_slurm)
        said.append(f"slurmctld and slurmd killed for {arguments.seconds_without_slurm} s while {jobs} jobs ran")
    # Of a sample none is noted by then: Snakemake asks too seldom.
    fleet.wait_until(lambda: len(fleet.booked()) >= arguments.robots // 4 * 2 and fleet.training(), "half of them are noted")
    said.append(fleet.kill_snakemake(cluster))
    fleet.finish()
    return "; ".join(said)


def count(fleet: Fleet, cluster: Cluster, robots: int) -> str:
    """Nothing lost, nothing twice but what was hit."""
    states = cluster.states()
    starts = fleet.runs.starts()
    whole = collections.Counter(name for name, job in starts if states.get(job) == "COMPLETED")
    other = [(name, job) for name, job in starts if states.get(job) != "COMPLETED"]
    check.expect(len(whole) == robots, f"{len(whole)} robots of {robots} were calibrated")
    check.expect(max(whole.values()) == 1, f"calibrated more than once: {[name for name, number in whole.items() if number > 1]}")
    for name, job in other:
        check.expect(job in fleet.hit, f"{name}: job {job} was not interrupted and ended as {states.get(job)}")
    return (
        f"{len(starts)} calibrations of {robots} robots, each once in a job that completed,"
        f" {len(other)} in interrupted jobs ({', '.join(name for name, _ in other)})"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--snakemake", required=True)
    parser.add_argument("--trainer", required=True)
    parser.add_argument("--robots", type=int, required=True)
    parser.add_argument("--poses", type=int, required=True)
    parser.add_argument("--seconds-without-slurm", type=int, default=0, help="0: the daemons are not killed")
    parser.add_argument("--seconds-between-checks", type=int, help="instead of the profile's")
    parser.add_argument("--let-jobs-end", action="store_true", help="when Snakemake was killed; otherwise they are cancelled")
    parser.add_argument("folder", type=pathlib.Path)
    arguments = parser.parse_args()
    folder = arguments.folder
    adopt_orphans()
    os.environ["PATH"] = f"{check.FLEET / 'no-accounting'}:{os.environ['PATH']}"
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
            counted = count(fleet, cluster, arguments.robots + 1)
            blobs = compare(local, slurm)
            check.expect(cluster.is_idle(), f"jobs are left: {cluster.ask('squeue')}")
            again = check.run(fleet.command("--dry-run"), slurm)
            check.expect("Nothing to be done" in again, f"a further run does something:\n{again}")
            left = cluster.stop()
            check.expect(not left, f"{len(left)} processes are left: {left}")
    except NotStarted as error:
        print(f"NOT RUN: the fleet on Slurm: no cluster: {error}")
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
