"""The Python examples of the documentation run."""

import re

import pytest
from conftest import ROOT

FILES = ("docs/how-to/python.md", "crates/ahrs-python/README.md")


@pytest.mark.parametrize("name", FILES)
def test_examples_of_the_documentation_run(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert blocks
    monkeypatch.chdir(ROOT)
    scope: dict[str, object] = {}
    for block in blocks:
        # The blocks of a file build on each other.
        exec(compile(block, name, "exec"), scope)
