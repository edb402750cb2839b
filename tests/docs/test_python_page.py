"""The code of docs/python.md runs as it is written.

Evidence: property. Chains are short (see tests/reliability/short_chain.py).
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)

PYTHON = """\
#!/bin/sh
shift 3
exec '{python}' -c 'import sys
sys.path.insert(0, "{folder}")
import short_chain
short_chain.shorten(setattr)
from calib.cli.main import main
sys.exit(main(sys.argv[1:]))' "$@"
"""


def test_code_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = BLOCK.findall((PROJECT / "docs" / "python.md").read_text())
    interpreter = tmp_path / "python"
    tests = PROJECT / "tests" / "reliability"
    interpreter.write_text(PYTHON.format(python=sys.executable, folder=tests))
    interpreter.chmod(0o755)
    shutil.copytree(PROJECT / "datasets" / "xu-wang-2017", tmp_path / "my-rig")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "executable", str(interpreter))
    (making,) = (block for block in blocks if "calib.calibrate" in block)
    names: dict[str, object] = {}
    exec("import calib\n" + making, names)  # noqa: S102 - our own page
    for block in blocks:
        if block is not making:
            exec(block, names)  # noqa: S102 - our own page
    length, u = names["length"], names["u"]
    assert isinstance(length, float)
    assert isinstance(u, float)
    assert 0 < u < length
