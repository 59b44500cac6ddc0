"""Robots of a fleet that does not exist, to try the workflow on: different arms, errors and seeds, 80 poses and 50 held out."""

import argparse
import pathlib
import subprocess

ARMS = ["abb-irb4400-serial", "abb-irb120", "kuka-iiwa7", "ur5", "ur10"]
SCENARIOS = ["paper", "rich", "wild"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trainer", default="trainer")
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument("--poses", type=int, default=80)
    parser.add_argument("--payloads", default="0,1,2.5", help="in kg")
    parser.add_argument("--broken", action="store_true", help="one more, whose file has a word where a number belongs")
    parser.add_argument("folder", type=pathlib.Path)
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for seed in range(1, arguments.robots + 1 + arguments.broken):
        arm = ARMS[(seed - 1) % len(ARMS)]
        # Each arm meets each kind of errors.
        scenario = SCENARIOS[(seed - 1) // len(ARMS) % len(SCENARIOS)]
        robot = arguments.folder / f"r{seed:02}"
        subprocess.run(
            [arguments.trainer, "simulate", "--robot", arm, "--poses", str(arguments.poses), "--test-sets", "1"]
            + ["--test-poses", "50", "--payloads", arguments.payloads, "--scenario", scenario]
            + ["--seed", str(seed), "--out", str(robot)],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        (robot / "project.toml").write_text(
            f'version = 1\nrobot.description = "{arm}"\n\n[data]\ntrain = "train.csv"\ntests = ["test1.csv"]\n',
            encoding="utf-8",
        )
        if seed > arguments.robots:
            text = (robot / "train.csv").read_text(encoding="utf-8")
            lines = text.splitlines(keepends=True)
            lines[-1] = "lost," + lines[-1].split(",", 1)[1]
            (robot / "train.csv").write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
