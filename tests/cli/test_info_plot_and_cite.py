import os

import jax.numpy as jnp
import numpy as np
import pytest

import jaxstab as js
from jaxstab.__main__ import main


def test_a_surface_and_a_result_say_what_they_are_and_a_result_is_drawn(
    scan, hertz, tmp_path, capsys
):
    main(["info", str(scan), "--lengths", "2", "1.5", "--unit", "um"])
    said = capsys.readouterr().out
    assert "16 x 12" in said and "µm" in said and "missing" in said
    sweep = js.sweep(hertz, js.MeanDisplacement(jnp.array([1.2, 1.31])))
    path = js.save(tmp_path / "run.nc", hertz, sweep)
    with pytest.raises(SystemExit):
        main(["info", str(path), "--unit", "um"])
    assert "which has its own lengths and unit: leave out" in capsys.readouterr().err
    main(["info", str(path)])
    said = capsys.readouterr().out
    assert said.startswith("Sweep of an adhesive contact") and str(sweep) in said
    assert max(map(len, said.splitlines())) < 200
    # A figure that is there already stays as it is.
    (tmp_path / "run.png").touch()
    for options in ([], ["--state", "1", "--output", str(tmp_path / "a.pdf")]):
        main(["plot", str(path), *options])
        file = capsys.readouterr().out.strip()
        assert os.path.getsize(file) > 10_000
    figures = sorted(file.name for file in tmp_path.iterdir() if file.suffix in (".png", ".pdf"))
    assert figures == ["a.pdf", "run-2.png", "run.png"]
    assert os.path.getsize(tmp_path / "run.png") == 0
    scalars = js.save(tmp_path / "scalars.nc", hertz, sweep, fields=False)
    main(["info", str(scalars)])
    assert "HalfSpace" in capsys.readouterr().out


@pytest.mark.parametrize("unit", [[], ["--unit", "um"]])
def test_a_surface_without_lengths_is_described_without_them(scan, unit, capsys):
    main(["info", str(scan), *unit])
    without = capsys.readouterr().out.splitlines()
    main(["info", str(scan), *unit, "--lengths", "2", "1.5"])
    known = capsys.readouterr().out.splitlines()
    (lengths,) = (line for line in without if "lengths" in line)
    assert lengths.endswith("not in the file: a run, and the slope, need --lengths")
    # What else is said is as true with lengths.
    rest = [line for line in without if line != lengths]
    assert set(rest) <= set(known) and any("rms height" in line for line in rest)
    assert not any("slope" in line for line in rest)


def test_points_counted_by_coordinates_are_no_lengths_in_a_unit(tmp_path, capsys):
    x, y = np.meshgrid(np.arange(6), np.arange(4), indexing="ij")
    np.savetxt(tmp_path / "xyz.txt", np.stack([x, y, np.sin(x + y)], axis=-1).reshape(-1, 3))
    main(["info", str(tmp_path / "xyz.txt"), "--unit", "um"])
    said = capsys.readouterr().out
    assert "6 x 4" in said and "lengths      not in the file" in said and "slope   " not in said
    main(["info", str(tmp_path / "xyz.txt")])
    assert "rms slope" in capsys.readouterr().out


def test_what_to_cite_is_said(capsys):
    main(["cite", "solvers.PolonskyKeerRey", "--bibtex"])
    assert "@article" in capsys.readouterr().out
    main(["cite", "jaxstab.potentials.Dugdale"])
    assert "Yielding of steel sheets" in capsys.readouterr().out
    main(["cite"])
    assert "Bleyer" in capsys.readouterr().out
