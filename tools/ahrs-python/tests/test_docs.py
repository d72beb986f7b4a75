"""The Python examples of the documentation run."""

import re

import pytest
from conftest import ROOT, System

FILES = ("docs/how-to/python.md", "tools/ahrs-python/README.md")


@pytest.mark.parametrize("name", FILES)
def test_examples_of_the_documentation_run(
    name: str, simulated: System, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert blocks
    monkeypatch.chdir(ROOT)
    scope: dict[str, object] = {}
    for block in blocks:
        # The blocks of a file build on each other. The system of this test has its own name.
        exec(compile(block.replace('"plumbline"', repr(simulated.name)), name, "exec"), scope)
