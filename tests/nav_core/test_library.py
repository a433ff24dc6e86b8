"""The library as a library: docs/library.md names what exists, and nothing needs more than the base dependencies."""

from __future__ import annotations

import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import nav_core

ROOT = Path(__file__).parents[2]
NAMES = re.findall(r"`(nav_core(?:\.\w+)+)`", (ROOT / "docs/library.md").read_text(encoding="utf-8"))
MODULES = sorted(each.name for each in pkgutil.walk_packages(nav_core.__path__, "nav_core."))


@pytest.mark.parametrize("name", sorted(set(NAMES)))
def test_what_the_index_names_can_be_imported(name):
    module, _, attribute = name.rpartition(".")
    found = getattr(importlib.import_module(module), attribute)
    assert found.__doc__


def test_what_a_package_exports_it_has_and_documents():
    for name in MODULES:
        module = importlib.import_module(name)
        for exported in getattr(module, "__all__", ()):
            assert hasattr(module, exported), f"{name}.{exported}"


@pytest.mark.parametrize("name", [name for name in MODULES if name.count(".") == 1])
def test_each_package_can_be_the_first_to_be_imported(name):
    subprocess.run([sys.executable, "-c", f"import {name}"], check=True)


def test_the_whole_library_needs_only_the_base_dependencies():
    """In a process of its own: everything imported, and nothing of the extras."""
    code = (
        "import importlib, sys\n"
        f"for name in {MODULES!r}: importlib.import_module(name)\n"
        "print(*sorted({name.partition('.')[0] for name in sys.modules} & "
        "{'server', 'fastapi', 'sqlalchemy', 'pydantic', 'pyarrow', 'matplotlib', 'viser', 'httpx', 'pandas'}))\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""


def test_filters_do_not_load_what_serves_others():
    """scipy takes longer to load than a minute of readings to filter."""
    code = (
        "import sys, nav_core.attitude, nav_core.navigation, nav_core.sensors, nav_core.strapdown\n"
        "parts = ('fft', 'interpolate', 'linalg', 'ndimage', 'optimize', 'signal', 'spatial', 'special', 'stats')\n"
        "print(*(part for part in parts if 'scipy.' + part in sys.modules))\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""


def test_the_example_of_the_readme_runs(capsys):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", readme, flags=re.DOTALL)
    exec(compile(example, "README.md", "exec"), {})
    assert capsys.readouterr().out.startswith("ready [[")
