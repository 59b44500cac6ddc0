"""One table (CSV) and one page (HTML) of a fleet, from the folders that calibrate.py wrote: robots without a
result first, then those whose tolerance is not met, then by the 95th percentile of the held-out error, the worst first."""

import argparse
import csv
import html
import json
import os
import pathlib
import statistics
import urllib.parse

# The order of the states in the table.
STATES = ["no project.toml", "failed", "tolerance not met", "calibrated"]

COLUMNS = [
    "name",
    "state",
    "robot",
    "poses",
    "held_out_poses",
    "nominal_mean_mm",
    "nominal_p95_mm",
    "calibrated_mean_mm",
    "calibrated_p95_mm",
    "calibrated_max_mm",
    "blob_bytes",
    "message",
]

STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --paper: #fff; --faint: #5f6873; --rule: #d5dae0; --bad: #a3271c; --bar: #2f6fb2; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e8ec; --paper: #14181d; --faint: #98a2ad; --rule: #363d45; --bad: #ff9183; --bar: #6ea8e0; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 70em; margin: 2em auto; padding: 0 1em; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: .3em .7em; border-bottom: 1px solid var(--rule); text-align: right; white-space: nowrap; }
th:nth-child(-n+2), td:nth-child(-n+2) { text-align: left; }
th { color: var(--faint); font-weight: 600; white-space: normal; } a { color: var(--bar); }
.failed { color: var(--bad); white-space: pre-wrap; text-align: left; overflow-wrap: anywhere; }
.bar { display: inline-block; height: .7em; background: var(--bar); } .p { color: var(--faint); }
"""


def row(folder: pathlib.Path) -> dict:
    """What is known of one robot, errors in mm."""
    outcome = json.loads((folder / "outcome.json").read_text(encoding="utf-8"))
    found = {"name": folder.name, **{key: outcome[key] for key in ("state", "robot", "message")}}
    if outcome["state"] != "failed":
        facts = json.loads((folder / "calibrate.json").read_text(encoding="utf-8"))
        found |= {"poses": facts.get("training_poses", 0), "blob_bytes": facts["blob"]["bytes"]}
        # Too few poses leave none to hold out.
        if held_out := facts.get("held_out"):
            found |= {
                "held_out_poses": held_out["calibrated"]["poses"],
                "calibrated_max_mm": held_out["calibrated"]["position_mm"]["max"],
            }
            for when in ("nominal", "calibrated"):
                for statistic in ("mean", "p95"):
                    found[f"{when}_{statistic}_mm"] = held_out[when]["position_mm"][statistic]
    return found


def without_project(name: str) -> dict:
    """A folder that is no robot because it lacks a project file."""
    message = "found no project.toml: this folder is not calibrated"
    return {"name": name, "state": "no project.toml", "robot": None, "message": message}


def order(found: dict) -> tuple:
    """What needs attention first, then the worst."""
    return (STATES.index(found["state"]), -found.get("calibrated_p95_mm", 0.0), found["name"])


def write(file: pathlib.Path, text: str) -> None:
    """The whole file or none."""
    beside = file.with_name(f".{file.name}.new")
    beside.write_text(text, encoding="utf-8")
    os.replace(beside, file)


def table(file: pathlib.Path, rows: list[dict]) -> None:
    """Numbers as they are in calibrate.json, empty where there is none."""
    beside = file.with_name(f".{file.name}.new")
    with beside.open("w", encoding="utf-8", newline="") as out:
        writer = csv.DictWriter(out, COLUMNS, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    os.replace(beside, file)


def page_row(found: dict, largest: float, place: str) -> str:
    name, robot = html.escape(found["name"]), html.escape(found["robot"] or "–")
    message = html.escape(found["message"])
    if found["state"] in ("failed", "no project.toml"):
        return f'<tr><td>{name}</td><td>{robot}</td><td colspan="7" class="failed">{message}</td></tr>'
    # Quoted, and never the name of a protocol, whatever the folder's name is.
    report = html.escape(urllib.parse.quote(f"./{place}{found['name']}/report.html"))
    link = f'<a href="{report}">{name}</a>' if "calibrated_p95_mm" in found else name
    keys = ("nominal_mean_mm", "nominal_p95_mm", "calibrated_mean_mm", "calibrated_p95_mm", "calibrated_max_mm")
    numbers = "".join(f"<td>{found[key]:.3f}</td>" if key in found else "<td>–</td>" for key in keys)
    width = 100 * found.get("calibrated_p95_mm", 0.0) / largest if largest > 0 else 0
    bar = f'<td style="text-align:left"><span class="bar" style="width:{width:.0f}px"></span></td>'
    row = f"<tr><td>{link}</td><td>{robot}</td><td>{found['poses']} / {found.get('held_out_poses', 0)}</td>{numbers}{bar}</tr>"
    if message:
        row += f'\n<tr><td></td><td></td><td colspan="7" class="failed">{message}</td></tr>'
    return row


def page(rows: list[dict], place: str) -> str:
    number = {state: sum(found["state"] == state for found in rows) for state in STATES}
    measured = [found for found in rows if "calibrated_p95_mm" in found]
    said = f"{number['calibrated']} of {len(rows)} robots are calibrated."
    if measured:
        means = {when: statistics.median(found[f"{when}_p95_mm"] for found in measured) for when in ("nominal", "calibrated")}
        worst = max(measured, key=lambda found: found["calibrated_p95_mm"])
        said += (
            f" In the median robot 95 % of the held-out poses were within {means['nominal']:.3f} mm before and are within"
            f" {means['calibrated']:.3f} mm now; the worst is {worst['name']} with {worst['calibrated_p95_mm']:.3f} mm."
        )
    said += f" {number['failed']} failed: see the first rows." if number["failed"] else ""
    said += f" The tolerance of {number['tolerance not met']} is not shown to be met." if number["tolerance not met"] else ""
    said += f" {number['no project.toml']} without project.toml." if number["no project.toml"] else ""
    largest = max((found["calibrated_p95_mm"] for found in measured), default=0.0)
    body = "\n".join(page_row(found, largest, place) for found in rows)
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Calibration of {len(rows)} robots</title><style>{STYLE}</style></head><body>
<h1>Calibration of {len(rows)} robots</h1>
<p>{html.escape(said)}</p>
<div class="scroll"><table><thead><tr><th>robot</th><th>kind</th><th>poses / held out</th><th>nominal: mean, mm</th><th>95 %</th>
<th>calibrated: mean, mm</th><th>95 %</th><th>largest</th><th></th></tr></thead><tbody>
{body}
</tbody></table></div>
<p class="p">Position errors of poses that were not trained on; they contain the instrument's noise. “Before” is the
nominal arm with base and tool fitted. Names lead to the report of each robot; bars are the 95 % after.</p>
</body></html>
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--table", type=pathlib.Path, required=True)
    parser.add_argument("--page", type=pathlib.Path, required=True)
    parser.add_argument("--without", action="append", default=[], help="name of a folder without project.toml")
    parser.add_argument("outcomes", type=pathlib.Path, nargs="+")
    arguments = parser.parse_args()
    folders = [outcome.parent for outcome in arguments.outcomes]
    rows = [row(folder) for folder in folders] + [without_project(name) for name in arguments.without]
    rows.sort(key=order)
    table(arguments.table, rows)
    # The page leads to the reports from where it lies.
    beside = os.path.relpath(folders[0].parent, arguments.page.parent)
    write(arguments.page, page(rows, "" if beside == "." else f"{beside}/"))


if __name__ == "__main__":
    main()
