"""nav_core stands on the standard library and four packages; a fifth would be one more for its users to install."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

import nav_core

ALLOWED = {"numpy", "scipy", "numba", "pygeomag", "nav_core"} | set(sys.stdlib_module_names)
# In the standard library, but not numerics: files, clocks, the environment, logging, processes.
FORBIDDEN = {"os", "io", "logging", "subprocess", "socket", "time", "random", "threading", "asyncio", "tempfile"}
FILES = sorted(Path(nav_core.__file__).parent.rglob("*.py"))


def imported(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_imports_are_numerics(path):
    assert imported(path) <= ALLOWED - FORBIDDEN
