"""Runs LinuxCNC on the places of the cell and holds what it did against the limits: called by `run`.

    trial.py FOLDER

FOLDER has base-tool.blob, elastic.blob and their .json. Exit code 1 when a limit is broken, 2 when no answer was found: LinuxCNC
stalled three times in one place.
"""

import json
import os
import pathlib
import pwd
import re
import shutil
import signal
import subprocess
import sys
import tempfile

import arm
import judge
import numpy as np

HERE = pathlib.Path(__file__).resolve().parent
# LinuxCNC refuses root.
USER = "nobody"
SEED = int(os.environ.get("POEGP_SEED", "1"))
PAYLOAD_KG = arm.WORKING_KG
ATTEMPTS = 3
SECONDS = 240
# What a machine does that has no time for LinuxCNC.
STALL = re.compile(r"timeout|timed out|not within|cycles were lost", re.IGNORECASE)

MEAN_MM, LARGEST_MM = 0.035, 0.06
INVERSE_US = 8.0
NOISE_RAD_S2 = 0.01
STEP_RAD = 1e-6
# MAX_VELOCITY of the joints in cell.ini, for one cycle.
CYCLE_DEG = 0.15
# Without a correction there has to be something to correct.
DRAWN_MM = 0.2
SPEED_MM_S = 250.0
CYCLES = 15_000
# The singularity of the true wrist is within half a degree of 0, and each direction is tested after half a degree.
STOP_DEG = (4.0, 5.5)


class Stalled(Exception):
    """The machine had no time: neither right nor wrong."""


def linuxcnc(folder, program, blob, tool):
    """One run from start to end; returns the record and the operator's outcome."""
    place = pathlib.Path(tempfile.mkdtemp(prefix="poegp-linuxcnc-"))
    try:
        for name in ("cell.ini", "cell.hal", "drive.py"):
            shutil.copy(HERE / name, place)
        shutil.copy(blob, place / "arm.blob")
        shutil.copy(program, place / "path.ngc")
        setting = {"BLOB": place / "arm.blob", "TOOL": tool, "PAYLOAD_KG": PAYLOAD_KG, "PROGRAM": place / "path.ngc"}
        (place / "arm.inc").write_text("[POEGP]\n" + "".join(f"{k} = {v}\n" for k, v in setting.items()), encoding="utf-8")
        as_user = []
        if os.geteuid() == 0:
            user = pwd.getpwnam(USER)
            for path in (place, *place.iterdir()):
                os.chown(path, user.pw_uid, user.pw_gid)
            as_user = ["runuser", "-u", USER, "--", "env", f"HOME={place}"]
        environment = {**os.environ, "HOME": str(place)}
        environment.pop("DISPLAY", None)
        with (place / "log.txt").open("wb") as log:
            # Without -r it ends in silence where there is no terminal.
            command = [*as_user, "linuxcnc", "-r", str(place / "cell.ini")]
            process = subprocess.Popen(command, cwd=place, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)
            try:
                process.wait(SECONDS)
            except subprocess.TimeoutExpired as error:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                subprocess.run([*as_user, "halrun", "-U"], cwd=place, env=environment, stdout=log, stderr=log, check=False)
                raise Stalled(f"LinuxCNC had not ended within {SECONDS} s") from error
        for name in ("log.txt", "outcome.json", "record.txt"):
            if (place / name).exists():
                shutil.copy(place / name, folder)
    finally:
        shutil.rmtree(place, ignore_errors=True)
    log = (folder / "log.txt").read_text(encoding="utf-8", errors="replace")
    if not (folder / "outcome.json").exists():
        raise Stalled(log[-500:]) if STALL.search(log) else RuntimeError(f"LinuxCNC did not start:\n{log}")
    outcome = json.loads((folder / "outcome.json").read_text(encoding="utf-8"))
    for message in outcome["messages"]:
        if STALL.search(message) and not any("poegpkins" in other for other in outcome["messages"]):
            raise Stalled(message)
    try:
        return judge.read(folder / "record.txt"), outcome
    except ValueError as error:
        raise Stalled(str(error)) from error


def attempts(folder, place, model, tool):
    """The same, again when the machine stalled."""
    out = folder / f"{place}-{model}"
    program = folder / f"{place}.ngc"
    subprocess.run([sys.executable, str(HERE / "path.py"), place, str(program)], check=True)
    for attempt in range(1, ATTEMPTS + 1):
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        try:
            return linuxcnc(out, program, folder / f"{model}.blob", tool)
        except Stalled as stall:
            print(f"place {place}, {model}: inconclusive, attempt {attempt} of {ATTEMPTS}: {stall}", flush=True)
    raise Stalled(f"place {place}, {model}: stalled {ATTEMPTS} times")


def cube(folder, place, model, tool, broken):
    record, outcome = attempts(folder, place, model, tool)
    inspected = json.loads((folder / f"{model}.json").read_text(encoding="utf-8"))
    found = judge.judge(record, inspected, SEED, PAYLOAD_KG)
    (folder / f"{place}-{model}" / "judged.json").write_text(json.dumps(found, indent=2), encoding="utf-8")
    print(
        f"| {place} | {model} | {found['mean_mm']:.4f} | {found['p95_mm']:.4f} | {found['largest_mm']:.4f} | {found['inverse_median_us']:.1f} "
        f"| {found['inverse_p99_us']:.1f} | {found['acceleration_noise_rad_s2']:.1e} | {found['cycles']} |",
        flush=True,
    )

    def limit(holds, text):
        if not holds:
            broken.append(f"place {place}, {model}: {text}")

    limit(outcome["ended"], f"the program did not end: {outcome['messages']}")
    limit(found["cycles"] >= CYCLES, f"{found['cycles']} cycles on the path, expected {CYCLES} or more")
    limit(abs(found["largest_speed_mm_s"] - SPEED_MM_S) < 0.1, f"{found['largest_speed_mm_s']:.3f} mm/s, expected {SPEED_MM_S}")
    limit(found["status"] == 0, f"status {found['status']}, expected 0: no remark")
    limit(found["smooth_cycles"] >= CYCLES // 2, f"noise from {found['smooth_cycles']} cycles, expected {CYCLES // 2} or more")
    limit(found["acceleration_noise_rad_s2"] <= NOISE_RAD_S2, f"noise {found['acceleration_noise_rad_s2']:.2g} rad/s², limit {NOISE_RAD_S2}")
    limit(found["start_step_rad"] <= STEP_RAD, f"joints step by {found['start_step_rad']:.2g} rad after homing, limit {STEP_RAD}")
    limit(found["largest_step_deg"] <= CYCLE_DEG, f"a joint turns by {found['largest_step_deg']:.3f} degrees in one cycle, limit {CYCLE_DEG}")
    if model == "elastic":
        limit(found["forward_mm"] <= LARGEST_MM, f"forward kinematics {found['forward_mm']:.4f} mm off at the start, limit {LARGEST_MM}")
        limit(found["mean_mm"] <= MEAN_MM, f"mean error {found['mean_mm']:.4f} mm, limit {MEAN_MM}")
        limit(found["largest_mm"] <= LARGEST_MM, f"largest error {found['largest_mm']:.4f} mm, limit {LARGEST_MM}")
        limit(found["inverse_median_us"] <= INVERSE_US, f"inverse {found['inverse_median_us']:.1f} µs in the median, limit {INVERSE_US}")
    else:
        limit(found["mean_mm"] >= DRAWN_MM, f"mean error {found['mean_mm']:.4f} mm without a correction, expected {DRAWN_MM} or more")


def singular(folder, tool, broken):
    """A line that turns the wrist straight: followed until joint 5 is 5 degrees away, stopped there, the joint named."""
    record, outcome = attempts(folder, "singular", "elastic", tool)
    inspected = json.loads((folder / "elastic.json").read_text(encoding="utf-8"))
    found = judge.judge(record, inspected, SEED, PAYLOAD_KG)
    beside = np.flatnonzero(record["singular"])
    # Some cycles later, when the last joints have left LinuxCNC.
    stopped = np.degrees(record["joints"][beside[0] + 10, 4]) if len(beside) else np.nan
    print(f"\nTowards a straight wrist: stopped with joint 5 at {stopped:.2f} degrees, largest error before {found['largest_mm']:.4f} mm.")
    print(f"LinuxCNC said: {' / '.join(outcome['messages'])}")
    if outcome["ended"] or not any("joint 5 is within 5 degrees of a singularity" in m for m in outcome["messages"]):
        broken.append("the singularity of joint 5 was not named")
    if found["largest_step_deg"] > CYCLE_DEG:
        broken.append(f"beside the singularity a joint turned by {found['largest_step_deg']:.3f} degrees in one cycle, limit {CYCLE_DEG}")
    if not outcome.get("turned_away"):
        broken.append("the arm did not go on after joint 5 had been turned away in joint mode")
    if not STOP_DEG[0] <= stopped <= STOP_DEG[1]:
        broken.append(f"joint 5 stopped at {stopped:.2f} degrees, expected {STOP_DEG[0]} to {STOP_DEG[1]}")
    if found["largest_mm"] > LARGEST_MM:
        broken.append(f"towards the singularity: largest error {found['largest_mm']:.4f} mm, limit {LARGEST_MM}")


def main():
    folder = pathlib.Path(sys.argv[1]).resolve()
    target_from_tool = arm.TrueArm(SEED).target_from_tool
    tool = ",".join(f"{x:.12f}" for x in [*(1e3 * target_from_tool[:3, 3]), *arm.to_quaternion(target_from_tool[:3, :3])])
    broken = []
    print("| place | model | mean, mm | p95, mm | largest, mm | inverse, median, µs | p99, µs | noise, rad/s² | cycles |")
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    try:
        for place in "123":
            for model in ("base-tool", "elastic"):
                cube(folder, place, model, tool, broken)
        singular(folder, tool, broken)
    except Stalled as stall:
        print(f"no answer: {stall}")
        sys.exit(2)
    for text in broken:
        print(f"LIMIT BROKEN: {text}")
    print("all limits hold" if not broken else f"{len(broken)} limits are broken")
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()
