import os

import jax
import jax.numpy as jnp
import pytest

import jaxstab as js
from jaxstab.__main__ import main


def test_a_surface_and_a_result_say_what_they_are_and_a_result_is_drawn(scan, tmp_path, capsys):
    main(["info", str(scan), "--lengths", "2", "1.5", "--unit", "um"])
    said = capsys.readouterr().out
    assert "16 x 12" in said and "µm" in said and "missing" in said
    grid = js.Grid(16)
    heights = js.surfaces.self_affine(grid, jax.random.key(0), k_high=4, rms_height=0.1)
    contact = js.Contact(js.HalfSpace(grid, 0.05), heights, js.potentials.Exponential(0.01, 0.2))
    sweep = js.sweep(contact, js.MeanGap(jnp.array([0.1, 0.2])))
    path = js.save(tmp_path / "run.nc", contact, sweep)
    with pytest.raises(SystemExit):
        main(["info", str(path), "--unit", "um"])
    assert "which has its own lengths and unit: leave out" in capsys.readouterr().err
    main(["info", str(path)])
    said = capsys.readouterr().out
    assert said.startswith("Sweep of an adhesive contact") and str(sweep) in said
    assert max(map(len, said.splitlines())) < 200
    for options in ([], [], ["--state", "1", "--output", str(tmp_path / "a.pdf")]):
        main(["plot", str(path), *options])
        file = capsys.readouterr().out.strip()
        assert os.path.getsize(file) > 10_000
    figures = sorted(file.name for file in tmp_path.iterdir() if file.suffix in (".png", ".pdf"))
    assert figures == ["a.pdf", "run-2.png", "run.png"]
    scalars = js.save(tmp_path / "scalars.nc", contact, sweep, fields=False)
    main(["info", str(scalars)])
    assert "HalfSpace" in capsys.readouterr().out


def test_what_to_cite_is_said(capsys):
    main(["cite", "PolonskyKeerRey", "--bibtex"])
    assert "@article" in capsys.readouterr().out
    main(["cite", "jaxstab.potentials.Dugdale"])
    assert "Yielding of steel sheets" in capsys.readouterr().out
    main(["cite"])
    assert "Bleyer" in capsys.readouterr().out
