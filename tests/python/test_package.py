"""What is installed: its size, its types, its documentation."""

import ast
import doctest
import inspect
import os
import subprocess
import sys
from pathlib import Path

import poegp

PACKAGE = Path(poegp.__file__).parent


def test_the_wheel_is_small():
    wheel = Path(os.environ["POEGP_WHEEL"])
    size = wheel.stat().st_size
    print(f"\n{wheel.name}: {size / 1e6:.2f} MB")
    assert "abi3" in wheel.name
    assert size <= 8e6


def test_the_stubs_name_what_there_is():
    """Names, parameters and their defaults, in both directions."""
    assert (PACKAGE / "py.typed").exists()
    tree = ast.parse((PACKAGE / "__init__.pyi").read_text())
    stubs = {n.name: n for n in tree.body if isinstance(n, (ast.ClassDef, ast.FunctionDef))}
    public = [name for name in poegp.__all__ if not name.startswith("_")]
    assert sorted(n for n in stubs if not n.startswith("_")) == sorted(public)

    def same(stub, function):
        names = [a.arg for a in stub.args.args + stub.args.kwonlyargs]
        parameters = inspect.signature(function).parameters.values()
        found = [p.name for p in parameters if p.kind is not p.VAR_KEYWORD]
        assert [n for n in names if n != "cls"] == found, stub.name
        kinds = {a.arg for a in stub.args.kwonlyargs}
        assert kinds == {p.name for p in parameters if p.kind is p.KEYWORD_ONLY}

    for name, stub in stubs.items():
        thing = getattr(poegp, name, None)
        if isinstance(stub, ast.FunctionDef) and thing is not None:
            same(stub, thing)
            assert thing.__doc__
        elif name in ("Model", "Calibration"):
            functions = {n.name: n for n in stub.body if isinstance(n, ast.FunctionDef)}
            methods = {n for n in vars(thing) if not n.startswith("_")}
            assert {n for n in functions if not n.startswith("_")} == methods
            for method in methods:
                member = getattr(thing, method)
                assert member.__doc__, method
                if callable(member):
                    same(functions[method], member)


def test_every_option_of_the_stubs_is_one_of_the_command_line(trainer):
    """And every option of the command line but outputs is in the stubs."""
    tree = ast.parse((PACKAGE / "__init__.pyi").read_text())
    tables = {}
    for n in tree.body:
        if isinstance(n, ast.ClassDef) and n.name.startswith("_"):
            own = {a.target.id for a in n.body if isinstance(a, ast.AnnAssign)}
            tables[n.name] = own.union(*(tables.get(base.id, set()) for base in n.bases if isinstance(base, ast.Name)))
    # What functions have as arguments of their own, or write.
    arguments = {
        "export": {"urdf", "payload_kg", "region", "target_link", "mjcf", "ur_kinematics", "dh", "mdh", "poe", "joint_offsets", "c_header"},
        "evaluate": {"predictions", "trust"},
        "check": {"max_mm"},
        "compare": {"methods", "test", "folds"},
        # Touches need a description that is filled in; programs are files.
        "plan": {"count", "payloads", "test_out", "touch", "features_out", "rapid", "krl", "urscript", "fanuc"},
    }
    # Residuals are of poses; touches, which features are of, have none.
    assert tables["_ResidualOptions"] == tables["_EvaluateOptions"] - {"features"}
    for command in ["calibrate", "check", "compare", "correct", "evaluate", "export", "plan"]:
        table = f"_{command.capitalize()}Options"
        lines = [line.split() for line in trainer(command, "--help").splitlines()]
        known = {w for line in lines for w in line[:2] if w.startswith("--")}
        known = {w.strip(",()[]").removeprefix("--").replace("-", "_") for w in known}
        outputs = {"out", "json", "report", "write_project", "controller_csv", "robot", "method", "help", "quiet", "with"}
        assert tables[table] == known - outputs - arguments.get(command, set())


def test_a_type_checker_takes_the_documented_uses(tmp_path):
    """And refuses what is none."""
    uses = (Path(__file__).parent / "typed.py").read_text()

    def checked(name, text):
        (tmp_path / name).write_text(text)
        command = [sys.executable, "-P", "-m", "mypy", "--strict", "--cache-dir", tmp_path / "cache", name]
        return subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)

    done = checked("good.py", uses)
    assert done.returncode == 0, done.stdout + done.stderr
    done = checked("bad.py", 'import poegp\npoegp.calibrate("a", 3)\npoegp.calibrate("a", "b", threads="x")\n')
    assert done.stdout.count("error:") == 2, done.stdout + done.stderr


def test_doctests():
    assert doctest.testmod(poegp).failed == 0
