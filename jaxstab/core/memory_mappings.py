"""Memory mappings, of which Linux gives a process 65 530 and compiled programs take hundreds."""

from pathlib import Path

# LLVM aborts the process when no more memory can be mapped, so the error must come before.
_MOST = 0.95


def require_memory_mappings() -> None:
    """Raise `MemoryError` if a program to be compiled may exhaust the memory mappings."""
    maps, limit = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
    if not (maps.exists() and limit.exists()):
        return
    number, most = maps.read_bytes().count(b"\n"), int(limit.read_text())
    if number > _MOST * most:
        raise MemoryError(
            f"The process has {number} of at most {most} memory mappings, nearly all of them by "
            "compiled programs. Call jax.clear_caches(), which drops these, and go on; or raise "
            "the limit vm.max_map_count of the system."
        )
