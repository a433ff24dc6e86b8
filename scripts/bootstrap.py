"""Install the pinned requirements and this checkout into the environment that runs this script.

The installer itself (uv) comes from the same lock file, hash included, so that nothing unpinned runs.
"""

from __future__ import annotations

import compileall
import re
import subprocess
import sys
import tempfile
from pathlib import Path


def pinned(lock: str, name: str) -> str:
    """The entry of one package, with its hashes."""
    entry = re.search(rf"^{name}==.*?(?=^\S|\Z)", lock, re.MULTILINE | re.DOTALL)
    if entry is None:
        sys.exit(f"{name} is not in the lock file")
    return entry[0]


def main() -> None:
    lock_path = Path(sys.argv[1])
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as uv_only:
        uv_only.write(pinned(lock_path.read_text(encoding="utf-8"), "uv"))
        uv_only.flush()
        pip = [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        subprocess.run([*pip, "--require-hashes", "--no-deps", "-r", uv_only.name], check=True)  # noqa: S603  fixed
    uv = [str(Path(sys.executable).with_name("uv")), "pip", "install", "-q", "--python", sys.executable]
    # Compiled now and not at the first start, which a new user is waiting for.
    locked = ["--require-hashes", "--compile-bytecode", "-r", str(lock_path)]
    subprocess.run([*uv, *locked], check=True)  # noqa: S603  fixed arguments
    subprocess.run([*uv, "--no-deps", "--no-build-isolation", "-e", "."], check=True)  # noqa: S603  fixed arguments
    compileall.compile_dir("nav_core", quiet=1)
    compileall.compile_dir("server", quiet=1)


if __name__ == "__main__":
    main()
