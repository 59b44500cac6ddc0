"""Writes the first rows of a simulated set as other programs write such files. See README.md; only Python's own library."""

import csv
import math
from pathlib import Path

HERE = Path(__file__).parent
SIMULATED = HERE.parent.parent / "simulated" / "irb4400_paper_s0_train.csv"
N = 8

with SIMULATED.open() as file:
    rows = [{k: float(v) for k, v in row.items()} for row in list(csv.DictReader(file))[:N]]
joints = [[row[f"q{i}_deg"] for i in range(1, 7)] for row in rows]
positions = [[row[f"{a}_mm"] for a in "xyz"] for row in rows]
payloads = [row["payload_kg"] for row in rows]


def rotation(row):
    w, x, y, z = (row[k] for k in ("qw", "qx", "qy", "qz"))
    n = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / n, x / n, y / n, z / n
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]


rotations = [rotation(row) for row in rows]


def rotation_vector(k):
    w, *v = (rows[k][name] for name in ("qw", "qx", "qy", "qz"))
    length = math.sqrt(sum(x * x for x in v))
    angle = 2 * math.atan2(length, w)
    return [x / length * angle for x in v]


def fixed_angles(k):
    """Roll, pitch, yaw: turns about the fixed X, then Y, then Z."""
    r = rotations[k]
    return [math.atan2(r[2][1], r[2][2]), math.asin(-r[2][0]), math.atan2(r[1][0], r[0][0])]


def radians(values):
    return [math.radians(x) for x in values]


def write(name, separator, *lines):
    texts = (separator.join(x if isinstance(x, str) else repr(x) for x in line) for line in lines)
    (HERE / name).write_text("".join(f"{line}\n" for line in texts), encoding="utf-8")


# Units in brackets: radians, kilograms, inches, degrees; the angles are yaw, pitch, roll of moving axes.
write("brackets.csv", ",",
      [f"Axis {i} [rad]" for i in range(1, 7)] + ["Load (kg)", "X [in]", "Y [in]", "Z [in]"]
      + ["Yaw [deg]", "Pitch [deg]", "Roll [deg]"],
      *([*radians(joints[k]), payloads[k], *(x / 25.4 for x in positions[k]),
         *(math.degrees(x) for x in reversed(fixed_angles(k)))] for k in range(N)))

# Units on a second line; a 4×4 matrix row by row, its translation in metres.
write("units_line.txt", "\t",
      [f"J{i}" for i in range(1, 7)] + ["Load"] + [f"T{r}{c}" for r in range(1, 5) for c in range(1, 5)],
      ["deg"] * 6 + ["g"] + (["", "", "", "m"] * 3) + [""] * 4,
      *([*joints[k], 1000 * payloads[k]]
        + [x for r, p in zip(rotations[k], positions[k]) for x in [*r, p / 1000]] + [0, 0, 0, 1] for k in range(N)))

# Roll, pitch, yaw of fixed axes in milliradians; and a rotation vector in radians.
write("fixed_axes.csv", ";",
      [f"J{i} [°]" for i in range(1, 7)] + ["m [kg]", "x [µm]", "y [µm]", "z [µm]", "rx [mrad]", "ry [mrad]", "rz [mrad]"],
      *([*joints[k], payloads[k], *(1000 * x for x in positions[k]), *(1000 * x for x in fixed_angles(k))]
        for k in range(N)))
write("rotation_vector.csv", ",",
      [f"q{i} (rad)" for i in range(6)] + ["payload (kg)", "x (m)", "y (m)", "z (m)", "rx (rad)", "ry (rad)", "rz (rad)"],
      *([*radians(joints[k]), payloads[k], *(x / 1000 for x in positions[k]), *rotation_vector(k)] for k in range(N)))

# Poses of a tracker with a running number and its clock, the position in metres, the rotation vector in degrees; its rows
# are 2.5 s apart.
write("tracker.csv", ";",
      ["No", "Time [ms]", "X [m]", "Y [m]", "Z [m]", "RX [deg]", "RY [deg]", "RZ [deg]"],
      *([f"{k + 1:03d}", str(1000000 + 2500 * k), *(x / 1000 for x in positions[k]),
         *(math.degrees(x) for x in rotation_vector(k))] for k in range(N)))


# Joints as drivers write them: RTDE at 125 Hz, with separators of spaces and the clock in seconds, moving between the
# poses; ROS; ABB with the number, in another order; Fanuc and KUKA.
UR = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
log = []
for k in range(N):
    for step in range(-3, 4):
        moved = [q + 0.4 * step for q in radians(joints[k])]
        stamp = f"{1000 + 2.5 * k + 0.008 * step + 0.0015:.4f}"
        log.append([stamp, *(q + 0.001 for q in moved), *moved, f"{payloads[k]:.2f}"])
write("rtde.txt", " ", ["timestamp"] + [f"target_q_{i}" for i in range(6)] + [f"actual_q_{i}" for i in range(6)]
      + ["payload"], *log)
write("ros.csv", ",", UR + ["payload"], *([*radians(joints[k]), payloads[k]] for k in range(N)))
write("abb.txt", "\t", ["No"] + [f"rax_{i}" for i in range(1, 7)] + ["loaddata.mass"],
      *([f"{k + 1:03d}", *joints[k], payloads[k]] for k in reversed(range(N))))
write("fanuc.csv", ",", [f"J{i}" for i in range(1, 7)] + ["PAYLOAD"], *([*joints[k], payloads[k]] for k in range(N)))
write("kuka.csv", ";", [f"A{i} [°]" for i in range(1, 7)] + ["LOAD"], *([*joints[k], payloads[k]] for k in range(N)))

# Four reflectors in a row, in inches; the instrument missed one of them twice.
PLACES = [[0, 0, 0], [120, 0, 0], [0, 80, 0], [15.5, 20, -60]]
seen = []
for k in range(N):
    row = [*joints[k], payloads[k]]
    for i, place in enumerate(PLACES):
        point = [sum(r * x for r, x in zip(turn, place)) + p for turn, p in zip(rotations[k], positions[k])]
        missed = (k, i) in [(2, 1), (5, 3)]
        row += ([""] * 3 if k == 2 else [0, 0, 0]) if missed else [x / 25.4 for x in point]
    seen.append(row)
write("reflectors.csv", ",",
      [f"J{i}" for i in range(1, 7)] + ["payload [kg]"] + [f"SMR{i}.{a} [in]" for i in range(1, 5) for a in "xyz"], *seen)

# A workbook as spreadsheets write it: two sheets, a title, shared strings, empty cells left out, a column of dates.
import zipfile
from xml.sax.saxutils import escape

header = ["Datum"] + [f"J{i}" for i in range(1, 7)] + ["Load (kg)", "X [mm]", "Y [mm]", "Z [mm]", "RX [rad]", "RY [rad]", "RZ [rad]"]
strings = ["Cell 4", "Notes", *header]


def cell(row, column, value):
    name = f"{chr(65 + column)}{row}"
    if isinstance(value, str):
        return f'<c r="{name}" t="s"><v>{strings.index(value)}</v></c>'
    return f'<c r="{name}"{" s=" + chr(34) + "1" + chr(34) if column == 0 else ""}><v>{value!r}</v></c>'


def sheet(lines):
    body = "".join(f'<row r="{n}">{"".join(cell(n, c, v) for c, v in enumerate(line) if v is not None)}</row>' for n, line in lines)
    return f'{XML}<worksheet xmlns="{MAIN}"><sheetData>{body}</sheetData></worksheet>'


XML = '<?xml version="1.0" encoding="UTF-8" standalone="yes"?>\n'
MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
REL = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGE = "http://schemas.openxmlformats.org/package/2006"
OFFICE = "application/vnd.openxmlformats-officedocument.spreadsheetml"
measured = [[46000.5 + k, *joints[k], payloads[k], *positions[k], *rotation_vector(k)] for k in range(N)]
parts = {
    "[Content_Types].xml": f'{XML}<Types xmlns="{PACKAGE}/content-types"><Default Extension="rels" '
    f'ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="xml" ContentType="application/xml"/>'
    f'<Override PartName="/xl/workbook.xml" ContentType="{OFFICE}.sheet.main+xml"/></Types>',
    "_rels/.rels": f'{XML}<Relationships xmlns="{PACKAGE}/relationships"><Relationship Id="rId1" Type="{REL}/officeDocument" '
    'Target="xl/workbook.xml"/></Relationships>',
    "xl/workbook.xml": f'{XML}<workbook xmlns="{MAIN}" xmlns:r="{REL}"><sheets><sheet name="Notes" sheetId="1" r:id="rId1"/>'
    '<sheet name="Measured" sheetId="2" r:id="rId2"/></sheets></workbook>',
    "xl/_rels/workbook.xml.rels": f'{XML}<Relationships xmlns="{PACKAGE}/relationships">'
    + "".join(f'<Relationship Id="rId{i}" Type="{REL}/{kind}" Target="{target}"/>' for i, (kind, target) in enumerate(
        [("worksheet", "worksheets/sheet1.xml"), ("worksheet", "worksheets/sheet2.xml"), ("styles", "styles.xml"),
         ("sharedStrings", "sharedStrings.xml")], 1)) + "</Relationships>",
    "xl/styles.xml": f'{XML}<styleSheet xmlns="{MAIN}"><cellXfs count="2"><xf numFmtId="0"/><xf numFmtId="14" applyNumberFormat="1"/>'
    "</cellXfs></styleSheet>",
    "xl/sharedStrings.xml": f'{XML}<sst xmlns="{MAIN}">' + "".join(f"<si><t>{escape(s)}</t></si>" for s in strings) + "</sst>",
    "xl/worksheets/sheet1.xml": sheet([(1, ["Notes"])]),
    "xl/worksheets/sheet2.xml": sheet([(1, ["Cell 4"]), (3, header), *enumerate(measured, 4)]),
}
with zipfile.ZipFile(HERE / "workbook.xlsx", "w", zipfile.ZIP_DEFLATED) as file:
    for name, text in parts.items():
        file.writestr(zipfile.ZipInfo(name), text, zipfile.ZIP_DEFLATED)
