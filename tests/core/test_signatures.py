"""Signatures, as `inspect.signature` and editors show them."""

import inspect

import pytest

import jaxstab as js

FORMS = (js.references.jkr, js.references.maugis, js.references.johnson, js.references.guduru)
SPACES = (js, js.potentials, js.surfaces, js.plots, *FORMS)


@pytest.mark.parametrize("space", SPACES, ids=lambda space: space.__name__)
def test_a_signature_names_what_is_like_an_array(space):
    names = [name for name in getattr(space, "__all__", dir(space)) if not name.startswith("_")]
    public = {name: getattr(space, name) for name in names if callable(getattr(space, name))}
    # Those of exceptions and enumerations are Python's.
    functions = {name: x for name, x in public.items() if inspect.isfunction(x)}
    assert functions
    for name, function in functions.items():
        text = str(inspect.signature(function))
        assert not any(part in text for part in ("numpy.number", "Buffer")), name
        assert len(text) < 800, (name, len(text))
