"""Every public function of nav_core says what goes in and what comes out: names, shapes, units, frames."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

PACKAGE = Path(__file__).parents[2] / "nav_core"
SECTION = re.compile(r"^(\w+)\n-{3,}\n", flags=re.MULTILINE)
ENTRY = re.compile(r"^(?P<names>[*\w]+(?:, [*\w]+)*)(?: : (?P<type>.+))?$")
ARRAY = re.compile(r"(Floats|Flags|Integers|NDArray\[.*\])( \| (float|None))?")


class Public(NamedTuple):
    """A function or method that anybody may call."""

    place: str
    node: ast.FunctionDef
    parameters: dict[str, str]
    returned: str

    @property
    def doc(self) -> str:
        return ast.get_docstring(self.node) or ""

    @property
    def sections(self) -> dict[str, str]:
        parts = SECTION.split(self.doc)
        return dict(zip(parts[1::2], parts[2::2], strict=True))

    def described(self) -> dict[str, tuple[str, str]]:
        """Type and text of each parameter that the docstring names."""
        found: dict[str, tuple[str, str]] = {}
        names: list[str] = []
        for line in self.sections.get("Parameters", "").splitlines():
            entry = ENTRY.match(line)
            if entry:
                names = entry["names"].split(", ")
                found |= dict.fromkeys(names, (entry["type"] or "", ""))
            elif line.strip():
                found |= {name: (found[name][0], found[name][1] + line.strip()) for name in names}
        return found


def functions(source: str, module: str) -> Iterator[Public]:
    """Public functions, and public methods of public classes; properties and what takes nothing say it in a line."""
    tree = ast.parse(source)
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]
    for owner in (tree, *classes):
        for node in owner.body:
            if not isinstance(node, ast.FunctionDef) or node.name.startswith("_"):
                continue
            given = node.args
            parameters = {
                each.arg: ast.unparse(each.annotation) if each.annotation else ""
                for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)
                if each.arg not in ("self", "cls")
            }
            place = f"{module}:{node.lineno} {node.name}"
            yield Public(place, node, parameters, ast.unparse(node.returns) if node.returns else "None")


def faults(function: Public) -> Iterator[str]:
    """What a docstring does not say."""
    if not function.doc:
        yield "no docstring"
    if not function.parameters:
        return
    described = function.described()
    for name, annotation in function.parameters.items():
        if name not in described:
            yield f"{name} is not described"
        elif ARRAY.fullmatch(annotation) and "shape" not in described[name][0]:
            yield f"{name} has no shape"
    if function.returned != "None" and not {"Returns", "Yields"} & set(function.sections):
        yield "nothing on what comes back"


FUNCTIONS = [
    function
    for path in sorted(PACKAGE.rglob("*.py"))
    for function in functions(path.read_text(encoding="utf-8"), path.relative_to(PACKAGE).as_posix())
]


def test_every_public_function_describes_its_parameters_and_what_it_returns():
    assert len(FUNCTIONS) > 500
    found = [f"{function.place}: {fault}" for function in FUNCTIONS for fault in faults(function)]
    assert not found, "\n".join(found)


WHOLE = """Say it.

    Parameters
    ----------
    x : ndarray, shape (3,)
        m.

    Returns
    -------
    float
        m.
    """


@pytest.mark.parametrize(
    ("docstring", "expected"),
    [
        ("Say it.", ["x is not described", "nothing on what comes back"]),
        (
            "Say it.\n\n    Parameters\n    ----------\n    x : ndarray\n        m.\n    \n",
            ["x has no shape", "nothing on what comes back"],
        ),
        (WHOLE, []),
    ],
)
def test_what_is_missing_is_noticed(docstring, expected):
    source = f'def length(x: Floats) -> float:\n    """{docstring}"""\n'
    (function,) = functions(source, "made_up.py")
    assert list(faults(function)) == expected
