"""What the worker asks of the C library's allocator, and the service of Python's collector."""

from __future__ import annotations

import gc
import platform

import pytest

from server import memory


def test_glibc_is_told_and_takes_it():
    assert memory.keep_freed_memory() is (platform.libc_ver()[0] == "glibc")


def test_another_library_is_left_alone(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    assert memory.keep_freed_memory() is False


def test_what_lasts_is_no_longer_collected():
    memory.set_aside()
    try:
        assert gc.get_freeze_count() > 1000
    finally:
        gc.unfreeze()
