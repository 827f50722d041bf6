"""Sources of functions and results, and the form of the bibliography."""

import re
from inspect import isclass, isfunction, ismodule

import jax.numpy as jnp
import pytest

import jaxstab as js

# Sources whose papers name what they are about: (what, surnames of the authors, year).
KNOWN = [
    (js.solvers.PolonskyKeerRey, ["Polonsky", "Keer"], "1999"),
    (js.solvers.PolonskyKeerRey, ["Rey", "Anciaux", "Molinari"], "2017"),
    (js.equilibrate, ["Rey", "Bleyer"], "2018"),
    (js.assess_stability, ["Rey", "Bleyer"], "2018"),
    (js.ProximalIteration, ["Rey", "Bleyer"], "2018"),
    (js.solvers.Davidson, ["Morgan", "Scott"], "1986"),
    (js.solvers.ProjectedLOBPCG, ["Knyazev"], "2001"),
    (js.HalfSpace, ["Westergaard"], "1939"),
    (js.continuation, ["Keller"], "1977"),
    (js.transition, ["E", "Ren", "Vanden-Eijnden"], "2007"),
    (js.detachment, ["Kramers"], "1940"),
    (js.detachment, ["Evans", "Ritchie"], "1997"),
    (js.potentials.Dugdale, ["Dugdale"], "1960"),
    (js.potentials.LennardJones, ["Israelachvili"], "2011"),
    (js.references.maugis, ["Maugis"], "1992"),
    (js.references.regime, ["Tabor"], "1977"),
    (js.references.jkr, ["Johnson", "Kendall", "Roberts"], "1971"),
    (js.references.jkr.pull_off, ["Maugis", "Barquins"], "1978"),
    (js.references.johnson, ["Johnson"], "1995"),
    (js.references.guduru, ["Guduru"], "2007"),
    (js.references.guduru, ["Kesari", "Lew"], "2011"),
    (js.evolve, ["Lee", "Radok"], "1960"),
    (js.Viscoelastic, ["Williams"], "1964"),
    (js.Viscoelastic, ["Baumgaertel", "Winter"], "1989"),
    (js.SurfaceTension, ["Style", "Hyland", "Boltyanskiy", "Wettlaufer", "Dufresne"], "2013"),
    (js.references.persson_brener, ["Persson", "Brener"], "2005"),
    (js.references.hertz, ["Hertz"], "1882"),
    (js.solids.Anisotropic, ["Barnett", "Lothe"], "1973"),
    (js.solids.Layered, ["Dunkin"], "1965"),
    (js.solids.Graded, ["Chen", "Yan", "Zhang", "Gao"], "2009"),
    (js.references.materials, ["Hall"], "1967"),
    (js.references.westergaard, ["Westergaard"], "1939"),
]


def entries(bibtex):
    """Return the entries of BibTeX by key, with a parser that knows nothing of ours."""
    found, depth, start = {}, 0, 0
    for place, character in enumerate(bibtex):
        if character == "{":
            depth += 1
        elif character == "}":
            depth -= 1
            assert depth >= 0
            if depth == 0:
                entry = bibtex[start : place + 1].strip()
                key = re.match(r"@\w+\{(\w+),", entry)
                assert key and key[1] not in found
                found[key[1]] = entry
                start = place + 1
    assert depth == 0
    assert not bibtex[start:].strip()
    return found


def surnames(entry):
    authors = re.search(r"author = \{(.*)\},", entry)
    assert authors
    return [name.split(",")[0] for name in authors[1].split(" and ")]


@pytest.mark.parametrize(("what", "authors", "year"), KNOWN)
def test_a_source_is_cited_for_what_it_is_behind(what, authors, year):
    cited = entries(js.cite(what).bibtex).values()
    assert any(surnames(x) == authors and f"year = {{{year}}}" in x for x in cited)


def test_everything_public_is_accepted_and_the_software_always_cited():
    rooms = (js, js.results, js.solvers)
    for item in (getattr(room, name) for room in rooms for name in room.__all__):
        citations = js.cite(item)
        assert "jaxstab" in entries(citations.bibtex)
        assert str(citations).startswith("The jaxstab developers.")


def test_without_arguments_the_software_and_its_method_are_cited():
    assert [surnames(x) for x in entries(js.cite().bibtex).values()] == [
        ["{The jaxstab developers}"],
        ["Rey", "Bleyer"],
    ]


def test_the_whole_bibliography_is_well_formed_and_complete():
    found = entries(js.cite(js).bibtex)
    assert len(found) > 15
    for key, entry in found.items():
        kind = entry[1 : entry.index("{")]
        expected = {
            "misc": ["version"],
            "book": ["publisher", "year"],
            "incollection": ["booktitle", "publisher", "pages", "year"],
        }.get(kind, ["journal", "year"])
        for field in ["author", "title", *expected]:
            assert re.search(rf"^  {field} = \{{.+\}},$", entry, re.MULTILINE), (key, field)
        assert "behind" not in entry
        doi = re.search(r"doi = \{(.*)\}", entry)
        assert doi is None or re.fullmatch(r"10\.\d{4,9}/\S+", doi[1])
    assert js.__version__ in found["jaxstab"]


def test_a_result_stands_for_its_class_and_its_parts():
    grid = js.Grid(4)
    contact = js.Contact(
        js.HalfSpace(grid, 1.0), jnp.zeros(grid.shape), js.potentials.Dugdale(1.0, 1.0)
    )
    found = str(js.cite(contact))
    assert all(name in found for name in ("Bleyer", "Westergaard", "Dugdale"))
    assert "Polonsky" in str(js.cite(js.solvers.PolonskyKeerRey()))


def test_a_solid_of_ones_own_stands_for_what_it_derives_from():
    class Stiffer(js.HalfSpace):
        """A half space."""

    assert "Westergaard" in str(js.cite(Stiffer))


def test_a_module_stands_for_all_that_it_holds():
    of_all = set(js.cite(js.references).reasons)
    for module in filter(ismodule, vars(js.references).values()):
        members = [x for x in vars(module).values() if isfunction(x) or isclass(x)]
        own = [x for x in members if x.__module__ == module.__name__]
        assert own
        assert set(js.cite(*own).reasons) <= set(js.cite(module).reasons) <= of_all


@pytest.mark.parametrize(
    ("item", "name"),
    [
        (len, "len"),
        (jnp, "jax.numpy"),
        ("equilibrate", "'equilibrate'"),
        (3, "int"),
        ([js.equilibrate], "list"),
        (lambda gap: gap, ".*<lambda>"),
    ],
)
def test_objects_of_others_are_refused_by_name(item, name):
    with pytest.raises(ValueError, match=f"^{name} is not of jaxstab: cite takes"):
        js.cite(item)


def test_a_sum_of_laws_stands_for_each_of_them():
    laws = js.potentials.Dugdale(1.0, 1.0), js.potentials.LennardJones(1.0, 0.5)
    assert set(js.cite(sum(laws)).reasons) == {*js.cite(laws[0]).reasons, *js.cite(laws[1]).reasons}
