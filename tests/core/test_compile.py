import jax.numpy as jnp
import numpy as np

from jaxstab.core import compile as programs


def test_programs_are_dropped_before_there_is_no_room_for_more(monkeypatch):
    traces = []

    def double(value):
        traces.append(value.shape)
        return 2 * value

    monkeypatch.setattr(programs, "_programs", [])
    monkeypatch.setattr(programs, "_kinds", set())
    compiled = programs.program(double)
    compiled(jnp.ones(3))

    before = programs.num_pieces()
    monkeypatch.setattr(programs, "_max_pieces", lambda: 10 * before)
    programs.make_room("one kind")
    compiled(jnp.ones(3))
    assert traces == [(3,)]

    monkeypatch.setattr(programs, "_max_pieces", lambda: before)
    programs.make_room("one kind")
    compiled(jnp.ones(3))
    assert traces == [(3,)]
    programs.make_room("another kind")
    np.testing.assert_array_equal(compiled(jnp.ones(3)), 2)
    assert traces == [(3,), (3,)]
