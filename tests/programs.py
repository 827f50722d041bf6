"""The programs that JAX compiles in a test, and their platform."""

from contextlib import contextmanager
from unittest import mock

import jax
import pytest

from jaxstab.core import control_flow

# Elsewhere many loads are solved together, rounded otherwise, small numbers are denormal, and
# programs have no texts.
on_the_cpu = pytest.mark.skipif(
    jax.default_backend() != "cpu", reason="what it asks for is given on the CPU alone"
)


@contextmanager
def beside_an_accelerator():
    """Trace programs as where JAX finds one."""
    jax.clear_caches()
    try:
        with mock.patch.object(control_flow, "has_accelerator", lambda: True):
            yield
    finally:
        # Or the next test gets this one's programs.
        jax.clear_caches()


@contextmanager
def compilations():
    """Yield a growing list of the programs compiled, or taken from a cache on disk, by name."""
    compiled = []

    def listen(event, _, fun_name="", **__):
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(fun_name)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield compiled
    jax.monitoring.unregister_event_duration_listener(listen)
