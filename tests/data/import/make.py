"""Writes one set of poses in every shape that `trainer import` reads, and what must come out. See README.md."""

import itertools
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

HERE = Path(__file__).parent
rng = np.random.default_rng(6)
N = 8
joints = np.round(rng.uniform(-170, 170, (N, 6)), 3)
positions = np.round(rng.uniform(-2500, 2500, (N, 3)), 4)
payloads = rng.choice([0, 1.25, 2.5], N)
rotations = Rotation.random(N, rng=rng)
quaternions = rotations.as_quat()
# As a file with twelve decimals has them; half a turn, and gimbal lock of all orders that end on another axis.
quaternions[2] = [0.6, 0, 0.8, 0]
quaternions[5] = Rotation.from_euler("zyx", [30, 90, 0], degrees=True).as_quat()
rotations = Rotation.from_quat(quaternions)


def text(x, decimals):
    out = f"{x:.{decimals}f}"
    out = out.rstrip("0").rstrip(".") if "." in out else out
    return "0" if out == "-0" else out


def expected_quaternion(r):
    x, y, z, w = r.as_quat()
    numbers = [w, x, y, z]
    texts = [text(v, 10) for v in numbers]
    first = next(t for t in texts if t != "0")
    return [text(-v, 10) for v in numbers] if first.startswith("-") else texts


def write(name, lines, end="\n", encoding="utf-8", last=True):
    data = end.join(lines) + (end if last else "")
    (HERE / name).write_bytes(data.encode(encoding))


def full(x):
    return repr(float(x))


J = [f"q{i}" for i in range(1, 7)]
header = ["payload_kg"] + [f"{q}_deg" for q in J] + ["x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"]
rows = []
for k in range(N):
    row = [text(payloads[k], 6)] + [text(q, 10) for q in joints[k]] + [text(x, 6) for x in positions[k]]
    rows.append(",".join(row + expected_quaternion(rotations[k])))
write("expected.csv", [",".join(header)] + rows)


def wxyz(k):
    x, y, z, w = quaternions[k]
    return [w, x, y, z]


BASIC = """[joints]
columns = ["J1", "J2", "J3", "J4", "J5", "J6"]
unit = "deg"

[payload]
column = "load"
unit = "kg"
"""
POSITION = """
[position]
columns = ["X", "Y", "Z"]
unit = "mm"
"""
PLAIN = ["J1", "J2", "J3", "J4", "J5", "J6", "load", "X", "Y", "Z"]


def plain(k):
    return [full(x) for x in [*joints[k], payloads[k], *positions[k]]]


# Commas, w first.
write("comma.csv", [",".join(PLAIN + ["W", "QX", "QY", "QZ"])]
      + [",".join(plain(k) + [full(x) for x in wxyz(k)]) for k in range(N)])
write("comma.toml", [BASIC + POSITION + """
[orientation]
kind = "quaternion"
columns = ["W", "QX", "QY", "QZ"]
order = "wxyz"
"""], last=False)

# A German office: semicolons with one at the end, decimal commas, points in thousands, Latin-1, CRLF, a preamble, units in
# a line of their own, a column that nobody needs, a last line that is no row.
german = ["Meßprotokoll Zelle 4;;;", "Prüfer: Müller", "",
          "Zeit;Achse 1;Achse 2;Achse 3;Achse 4;Achse 5;Achse 6;Masse;Größe X;Größe Y;Größe Z;Q4;Q1;Q2;Q3;",
          "hh:mm;°;°;°;°;°;°;g;mm;mm;mm;;;;;"]


def comma(x):
    return full(x).replace(".", ",")


def grouped(x):
    return f"{x:,.4f}".replace(",", " ").replace(".", ",").replace(" ", ".")


for k in range(N):
    x, y, z, w = quaternions[k]
    cells = [f"10:{k:02d}", *map(comma, joints[k]), grouped(1000 * payloads[k]), *map(grouped, positions[k]),
             *map(comma, [w, x, y, z])]
    german.append(";".join(cells) + ";")
german += ["", "Ende der Messung"]
write("german.csv", german, end="\r\n", encoding="latin-1")
write("german.toml", ["""[file]
separator = ";"
decimal = ","
thousands = "."
encoding = "latin-1"
skip_lines = 3
skip_last_lines = 1
header_lines = 2

[joints]
columns = ["Achse 1", "Achse 2", "Achse 3", "Achse 4", "Achse 5", "Achse 6"]
unit = "deg"

[payload]
column = "Masse"
unit = "g"

[position]
columns = ["Größe X", "Größe Y", "Größe Z"]
unit = "mm"

[orientation]
kind = "quaternion"
columns = ["Q1", "Q2", "Q3", "Q4"]
order = "xyzw"
"""], last=False)

# Tabulators behind a byte order mark, radians and metres, w last.
write("tabs.txt", ["\t".join(PLAIN + ["qx", "qy", "qz", "qw"])]
      + ["\t".join(full(x) for x in [*np.radians(joints[k]), payloads[k]])
         + "\t" + "\t".join(f"{x / 1000:.7f}" for x in positions[k])
         + "\t" + "\t".join(full(x) for x in quaternions[k]) for k in range(N)], encoding="utf-8-sig")
write("tabs.toml", ["""[file]
separator = "tab"

""" + BASIC.replace('"deg"', '"rad"') + POSITION.replace('"mm"', '"m"') + """
[orientation]
kind = "quaternion"
columns = ["qx", "qy", "qz", "qw"]
order = "xyzw"
"""], last=False)

# UTF-16 as spreadsheets' "Unicode text" has it.
write("unicode.txt", ["\t".join(PLAIN + ["W", "QX", "QY", "QZ"])]
      + ["\t".join(comma(x) for x in [*joints[k], payloads[k], *positions[k], *wxyz(k)]) for k in range(N)],
      end="\r\n", encoding="utf-16")
write("unicode.toml", ["""[file]
separator = "tab"
decimal = ","
encoding = "utf-16"

""" + BASIC + POSITION + """
[orientation]
kind = "quaternion"
columns = ["W", "QX", "QY", "QZ"]
order = "wxyz"
"""], last=False)

# Spaces, no header, comments of two kinds, a rotation vector in radians.
write("spaces.txt", ["// Frame: WORLD", "# six joints, mass, x y z, rotation vector", ""]
      + ["  ".join(f"{x:>24}" for x in plain(k) + [full(x) for x in rotations[k].as_rotvec()]) for k in range(N)]
      + ["// end"])
write("spaces.toml", ["""[file]
separator = "space"
header_lines = 0
comments = ["//", "#"]

[joints]
columns = [1, 2, 3, 4, 5, 6]
unit = "deg"

[payload]
column = 7
unit = "kg"

[position]
columns = [8, 9, 10]
unit = "mm"

[orientation]
kind = "rotation-vector"
columns = [11, 12, 13]
unit = "rad"
"""], last=False)


# Matrices: 3x4 in a row, 4x4 column by column in metres, and nine numbers beside a position.
def matrix(k, scale=1.0):
    out = np.eye(4)
    out[:3, :3] = rotations[k].as_matrix()
    out[:3, 3] = positions[k] * scale
    return out


def cells(values):
    return ",".join(full(x) for x in values)


three = [f"m{r}{c}" for r in range(1, 4) for c in range(1, 5)]
four = [f"t{r}{c}" for c in range(1, 5) for r in range(1, 5)]
nine = [f"r{r}{c}" for r in range(1, 4) for c in range(1, 4)]
write("matrix_3x4.csv", [",".join(PLAIN[:7] + three)]
      + [cells([*joints[k], payloads[k], *matrix(k)[:3].ravel()]) for k in range(N)])
write("matrix_3x4.toml", [BASIC + f"\n[pose]\ncolumns = {three}\nunit = \"mm\"\n".replace("'", '"')], last=False)
metres = lambda x: f"{x:.7f}"
lines = [",".join(PLAIN[:7] + four)]
for k in range(N):
    m = matrix(k).T.ravel()
    texts = [metres(v / 1000) if i in (12, 13, 14) else full(v) for i, v in enumerate(m)]
    lines.append(cells([*joints[k], payloads[k]]) + "," + ",".join(texts))
write("matrix_4x4.csv", lines)
write("matrix_4x4.toml",
      [BASIC + f"\n[pose]\ncolumns = {four}\nunit = \"m\"\nlayout = \"columns\"\n".replace("'", '"')], last=False)
write("matrix_9.csv", [",".join(PLAIN + nine)]
      + [",".join(plain(k)) + "," + cells(rotations[k].as_matrix().ravel()) for k in range(N)])
write("matrix_9.toml",
      [BASIC + POSITION + f"\n[orientation]\nkind = \"matrix\"\ncolumns = {nine}\n".replace("'", '"')], last=False)

# All Euler angles, degrees.
orders = ["".join(o) for o in itertools.product("XYZ", repeat=3) if o[0] != o[1] and o[1] != o[2]]
orders += [o.lower() for o in orders]
names = list(PLAIN)
for o in orders:
    names += [f"{o}_{'intrinsic' if o.isupper() else 'extrinsic'}_{i}" for i in (1, 2, 3)]
import warnings

warnings.simplefilter("ignore")  # gimbal lock is what one pose is for
write("euler.csv", [",".join(names)]
      + [",".join(plain(k)) + "," + cells(x for o in orders for x in rotations[k].as_euler(o, degrees=True))
         for k in range(N)])
write("euler.toml", [BASIC + POSITION + """
[orientation]
kind = "euler"
columns = ["ORDER_AXES_1", "ORDER_AXES_2", "ORDER_AXES_3"]
order = "ORDER"
axes = "AXES"
unit = "deg"
"""], last=False)

# Points: SpatialAnalyzer's collection, group, target, x, y, z with commas, and the joints by name in another order; and a
# list of names as a tracker gives them, pose and target in one, in metres, joints by order.
targets = {"T1": [0, 0, 0], "T2": [120, 0, 0], "T3": [0, 80, 0], "T4": [15.5, 20, -60]}
sa, leica = ["// SpatialAnalyzer", "// Frame: Instrument"], []
for k in range(N):
    for name, place in targets.items():
        p = rotations[k].apply(place) + positions[k]
        if k == 3 and name == "T2":
            continue  # three of four are enough
        sa.append(f"Cell 4, Pose {k + 1:02d}, {name}, " + ", ".join(full(x) for x in p))
        leica.append(f"P{k + 1}_{name} " + " ".join(f"{x / 1000:.16f}" for x in p))
write("points.txt", sa)
write("points_joints.csv", ["name;J1;J2;J3;J4;J5;J6;load"]
      + [f"Pose {k + 1:02d};" + ";".join(comma(x) for x in [*joints[k], payloads[k]]) for k in reversed(range(N))])
write("points.toml", ["""[file]
separator = ","
header_lines = 0
comments = ["//"]

[joints_file]
separator = ";"
decimal = ","

""" + BASIC.replace("[joints]\n", "[joints]\nname = \"name\"\n") + """
[points]
name = 2
target = 3
columns = [4, 5, 6]
unit = "mm"
join = "name"
targets = { T1 = [0, 0, 0], T2 = [120, 0, 0], T3 = [0, 80, 0], T4 = [15.5, 20, -60] }
targets_unit = "mm"
"""], last=False)
write("leica.txt", leica)
write("leica_joints.csv", [",".join(PLAIN[:7])] + [cells([*joints[k], payloads[k]]) for k in range(N)])
write("leica.toml", ["""[file]
separator = "space"
header_lines = 0

[joints_file]
separator = "comma"

""" + BASIC + """
[points]
name = 1
split = "_"
columns = [2, 3, 4]
unit = "m"
join = "order"
targets = { T1 = [0, 0, 0], T2 = [0.12, 0, 0], T3 = [0, 0.08, 0], T4 = [0.0155, 0.02, -0.06] }
targets_unit = "m"
"""], last=False)
