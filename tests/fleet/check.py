"""Runs the fleet's workflow as its user would, kills it in the middle, runs it again, and looks at what came of it."""

import argparse
import csv
import json
import os
import pathlib
import re
import resource
import shutil
import signal
import subprocess
import sys
import time

FLEET = pathlib.Path(__file__).resolve().parents[2] / "examples" / "fleet"


def engine(arguments: argparse.Namespace, *more: str, profile: str = "local") -> list[str]:
    return [
        *(arguments.snakemake, "--snakefile", str(FLEET / "Snakefile")),
        *("--profile", str(FLEET / "profiles" / profile), *more, "--config", f"trainer={arguments.trainer}"),
    ]


def finished(folder: pathlib.Path) -> dict[str, int]:
    """When each robot was done, by its file."""
    return {file.parent.name: file.stat().st_mtime_ns for file in folder.glob("results/*/outcome.json")}


def run(command: list[str], folder: pathlib.Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    printed = done.stdout + done.stderr
    if done.returncode != 0:
        sys.exit(f"{command} ended with {done.returncode}:\n{printed}")
    return printed


def booked(log: str) -> set[str]:
    """Robots whose end the engine has noted, by its log."""
    names = dict(re.findall(r"jobid: (\d+)\n(?:    .*\n)*?    wildcards: name=(\S+)", log))
    return {names[job] for job in re.findall(r"Finished jobid: (\d+)", log) if job in names}


def kill_in_the_middle(arguments: argparse.Namespace, after: int) -> dict[str, int]:
    """Starts the workflow and kills it and all of its jobs once so many robots are done; when each of these was."""
    path = arguments.folder / "killed.log"
    with path.open("w", encoding="utf-8") as log:
        process = subprocess.Popen(engine(arguments), cwd=arguments.folder, stdout=log, stderr=log, start_new_session=True)
        try:
            while len(booked(path.read_text(encoding="utf-8"))) < after:
                if process.poll() is not None:
                    sys.exit(f"ended before it could be killed: {path.read_text(encoding='utf-8')}")
                time.sleep(0.05)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    done = finished(arguments.folder)
    return {name: done[name] for name in booked(path.read_text(encoding="utf-8"))}


def expect(holds: bool, what: str) -> None:
    if not holds:
        sys.exit(f"fleet: {what}")


def look(arguments: argparse.Namespace) -> None:
    """The table and the page."""
    results = arguments.folder / "results"
    with (results / "fleet.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    broken = f"r{arguments.robots + 1:02}"
    expect(len(rows) == arguments.robots + 1, f"{len(rows)} rows")
    expect(rows[0]["name"] == broken and rows[0]["state"] == "failed", f"{broken} is not the first row, failed: {rows[0]}")
    expect("train.csv:" in rows[0]["message"] and '"lost"' in rows[0]["message"], f"message {rows[0]['message']!r}")
    worst = [float(row["calibrated_p95_mm"]) for row in rows[1:]]
    expect(worst == sorted(worst, reverse=True), f"not the worst first: {worst}")
    page = (results / "fleet.html").read_text(encoding="utf-8")
    expect("<script" not in page and "http" not in page, "the page needs scripts or the network")
    for link in re.findall(r'href="([^"]*)"', page):
        expect((results / link).is_file(), f"{link} leads nowhere")
    for row in rows[1:]:
        facts = json.loads((results / row["name"] / "calibrate.json").read_text(encoding="utf-8"))["held_out"]
        for when in ("nominal", "calibrated"):
            for statistic in ("mean", "p95"):
                number = facts[when]["position_mm"][statistic]
                expect(float(row[f"{when}_{statistic}_mm"]) == number, f"{row['name']}: {when} {statistic}")
                expect(f"<td>{number:.3f}</td>" in page, f"{row['name']}: {number} is not on the page")
        expect(float(row["calibrated_mean_mm"]) < float(row["nominal_mean_mm"]), f"{row['name']} got worse")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--snakemake", required=True)
    parser.add_argument("--trainer", required=True)
    parser.add_argument("--robots", type=int, required=True)
    parser.add_argument("--poses", type=int, required=True)
    parser.add_argument("folder", type=pathlib.Path)
    arguments = parser.parse_args()
    folder = arguments.folder
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    robots = [sys.executable, str(FLEET / "scripts" / "simulate.py"), "--trainer", arguments.trainer, "--broken"]
    run([*robots, "--robots", str(arguments.robots), "--poses", str(arguments.poses), "robots"], folder)

    before = kill_in_the_middle(arguments, after=max(1, arguments.robots // 3))
    expect(len(before) <= arguments.robots, "everything was done before the kill")
    # What a kill leaves behind; a run that was ended by Ctrl-C does not need it.
    run(engine(arguments, "--unlock"), folder)
    run(engine(arguments), folder)
    after = finished(folder)
    again = [name for name, when in before.items() if after[name] != when]
    expect(not again, f"done again: {again} of {sorted(before)}")
    look(arguments)

    said = run(engine(arguments, "--dry-run"), folder)
    expect("Nothing to be done" in said, f"a third run does something:\n{said}")
    one = folder / "robots" / "r01" / "project.toml"
    one.write_text(one.read_text(encoding="utf-8") + '\n[calibration]\nmethod = "poe"\n', encoding="utf-8")
    said = run(engine(arguments), folder)
    changed = [name for name, when in finished(folder).items() if after[name] != when]
    expect(changed == ["r01"], f"one robot changed and these were done: {changed}\n{said}")
    look(arguments)

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    jobs = sum(json.loads(file.read_text())["cpu_seconds"] for file in folder.glob("results/*/outcome.json"))
    print(
        f"fleet: {arguments.robots} robots and a broken one; killed when {len(before)} were done, which stayed;"
        f" {jobs:.0f} CPU seconds in the trainer, {used.ru_utime + used.ru_stime:.0f} in all but what was killed"
    )


if __name__ == "__main__":
    main()
