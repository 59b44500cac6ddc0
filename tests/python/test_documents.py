"""The example of the page on Python runs as it stands."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_example_of_the_guide_runs(trainer, tmp_path):
    trainer("simulate", "--robot", "abb-irb120", "--out", tmp_path / "cell")
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs/guide/python.md").read_text(), re.S | re.M)
    assert len(blocks) == 1
    done = subprocess.run(
        [sys.executable, "-P", "-c", blocks[0]], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    print("\n" + done.stdout)
    chosen, errors, chain = done.stdout.strip().splitlines()
    assert float(errors.split()[0]) < 0.2 and done.stderr == ""
    assert 0 < float(chain.split()[0]) < 0.2
