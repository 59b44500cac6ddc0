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


def rows_of(folder: pathlib.Path) -> dict[str, dict]:
    """The rows of the table by name."""
    with (folder / "results" / "fleet.csv").open(encoding="utf-8", newline="") as file:
        return {row["name"]: row for row in csv.DictReader(file)}


def look_at_failures(arguments: argparse.Namespace) -> None:
    """A robot that fails keeps its earlier result; a signed model stays; a tolerance that is not met has numbers."""
    folder = arguments.folder
    results, robots = folder / "results", folder / "robots"
    (results / "r01" / "mine.txt").write_text("mine\n", encoding="utf-8")
    with (robots / "r01" / "project.toml").open("a", encoding="utf-8") as file:
        file.write("methud = 1\n")
    run([arguments.trainer, "keys", "new", "--out", str(folder / "maker")], folder)
    run([arguments.trainer, "sign", str(results / "r02" / "arm.blob"), "--key", str(folder / "maker.key")], folder)
    for name, more in (("r02", "[calibration]\nmethod = 'poe'\n"), ("r03", "[tolerance]\nposition_mm = 0.001\n")):
        with (robots / name / "project.toml").open("a", encoding="utf-8") as file:
            file.write(more)
    (robots / "forgotten").mkdir()
    kept = ("arm.blob", "report.html", "calibrate.json", "mine.txt")
    earlier = {file: file.read_bytes() for name in ("r01", "r02") for file in (results / name).iterdir() if file.name in kept}
    expect(len(earlier) == 7, f"files before: {sorted(map(str, earlier))}")
    said = run(engine(arguments), folder)
    expect("forgotten: found no project.toml" in said, f"the folder without project.toml is not named:\n{said}")
    for file, contents in earlier.items():
        expect(file.exists() and file.read_bytes() == contents, f"{file} did not stay")
    rows, page = rows_of(folder), (results / "fleet.html").read_text(encoding="utf-8")
    states = {name: rows[name]["state"] for name in ("forgotten", "r01", "r02", "r03")}
    wanted = {"forgotten": "no project.toml", "r01": "failed", "r02": "failed", "r03": "tolerance not met"}
    expect(states == wanted, f"states {states}")
    expect("methud" in rows["r01"]["message"] and "earlier run" in rows["r01"]["message"], f"message {rows['r01']['message']!r}")
    expect("signed" in rows["r02"]["message"], f"message {rows['r02']['message']!r}")
    expect(float(rows["r03"]["calibrated_p95_mm"]) > 0.001, f"no numbers of r03: {rows['r03']}")
    expect('href="./r03/report.html"' in page and "does not conform" in page, "r03 has no link, or no verdict")


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
    look_at_failures(arguments)

    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    jobs = sum(json.loads(file.read_text())["cpu_seconds"] for file in folder.glob("results/*/outcome.json"))
    print(
        f"fleet: {arguments.robots} robots and a broken one; killed when {len(before)} were done, which stayed;"
        f" {jobs:.0f} CPU seconds in the trainer, {used.ru_utime + used.ru_stime:.0f} in all but what was killed"
    )


if __name__ == "__main__":
    main()
