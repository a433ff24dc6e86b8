"""What worker and service ask of the C library's allocator, and the service of Python's collector."""

from __future__ import annotations

import gc
import platform
import subprocess
import sys
import textwrap

import pytest

from server import memory


def test_glibc_is_told_and_takes_it():
    assert memory.keep_freed_memory() is (platform.libc_ver()[0] == "glibc")


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="heaps of glibc")
@pytest.mark.parametrize("shared", [True, False])
def test_threads_share_heaps(shared: bool):
    counted = textwrap.dedent(
        f"""
        import ctypes, os, threading
        from server import memory

        assert not {shared} or memory.share_heaps()
        libc = ctypes.CDLL(None)
        libc.malloc.restype, libc.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
        libc.fdopen.restype, libc.fdopen.argtypes = ctypes.c_void_p, [ctypes.c_int, ctypes.c_char_p]
        libc.malloc_info.argtypes, libc.fflush.argtypes = [ctypes.c_int, ctypes.c_void_p], [ctypes.c_void_p]
        all_have = threading.Barrier(7)

        def work():
            assert libc.malloc(10_000)
            all_have.wait(30)

        threads = [threading.Thread(target=work) for _ in range(6)]
        for thread in threads:
            thread.start()
        all_have.wait(30)
        told = libc.fdopen(os.dup(1), b"w")
        assert libc.malloc_info(0, told) == 0 and libc.fflush(told) == 0
        """
    )
    done = subprocess.run([sys.executable, "-c", counted], capture_output=True, text=True, check=True, timeout=60)
    heaps = done.stdout.count("<heap nr=")
    assert heaps == memory.HEAPS if shared else heaps == 7


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="heaps of glibc")
def test_arrow_has_no_heaps_of_its_own():
    asked = "memory.share_heaps(); print(pyarrow.default_memory_pool().backend_name)"
    done = subprocess.run(
        [sys.executable, "-c", f"import pyarrow; from server import memory; {asked}"],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert done.stdout.strip() == "system"


def test_another_library_is_left_alone(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(platform, "libc_ver", lambda: ("", ""))
    assert memory.keep_freed_memory() is False
    assert memory.share_heaps() is False


def test_what_lasts_is_no_longer_collected():
    memory.set_aside()
    try:
        assert gc.get_freeze_count() > 1000
    finally:
        gc.unfreeze()
