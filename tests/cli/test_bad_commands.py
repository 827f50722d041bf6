import io
import os
import subprocess
import sys

import numpy as np
import pytest

from jaxstab.__main__ import main, open_streams
from jaxstab.cli import parsing
from jaxstab.cli.options import in_options

SMALL = ["--size", "32", "--k-high", "8", "--study", "unloading", "--number", "5"]
MATERIAL = ["--youngs-modulus", "2", "--surface-energy", "0.02", "--range", "0.2"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--rms-height", "-1"], "-1.0: it must be positive"),
        (["--k-high", "100"], "resolves 16"),
        (["--hurst", "2"], "The Hurst exponent is 2"),
        (["--youngs-modulus", "0"], "Young's modulus is 0"),
        (["--number", "0"], "--number: '0' is not a whole number of at least 1."),
        (["--seed", "-1"], "--seed: '-1' is not a whole number from 0 to 4294967295."),
        (["--size", "1"], "--size: '1' is not a whole number of at least 2."),
        (["--range", "wide"], "--range: 'wide' is not a finite number."),
        (["--first", "-1e-3", "--last", "wide"], "--last: 'wide' is not a finite number."),
        (["--potential", "glue"], "invalid choice: 'glue'"),
        (["--load", "spring"], "--stiffness belongs to --load spring, which needs it."),
        (["--stiffness", "2"], "--stiffness belongs to --load spring"),
        (["--load", "pressure", "--first", "0"], "--last is needed with --load pressure."),
        (["--smoothing", "0.2"], "--smoothing belongs to --potential dugdale."),
        (["--potential", "none", "--range", "1"], "--range belongs to a law, not to --potential"),
        (["--smallest-jump", "1e-3"], "--smallest-jump belongs to --study loop."),
        (["--study", "loop"], "--number belongs to --study unloading."),
        (["--lengths", "2"], "--lengths belongs to --surface."),
        (["--surface", __file__], "--size describes a generated surface"),
        (["--surface", "none.txt"], "there is no file none.txt."),
        (["--colour", "red"], "there is no option --colour; --help lists them."),
        (["--siz", "8"], "there is no option --siz; the nearest is --size."),
        (["--size"], "--size: expected one argument"),
        (["--config", "none.toml"], "there is no file none.toml."),
    ],
)
def test_options_that_make_no_sense_end_in_one_line(tmp_path, capsys, arguments, message):
    assert_refused([*SMALL, "--output", str(tmp_path / "results"), *arguments], message, capsys)
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rnu"], "there is no command rnu; the nearest is run. Commands: run, study, info"),
        (["info"], "the following arguments are required: FILE"),
        (["info", "none.x3p"], "none.x3p"),
        (["plot", "none.nc"], "there is no file none.nc."),
        (
            ["study", "--wrokers", "2", "empty.txt"],
            "no option --wrokers; the nearest is --workers.",
        ),
        (["plot", "empty.txt", "--widht", "single"], "no option --widht; the nearest is --width."),
        (["plot", "empty.txt"], "empty.txt is no readable NetCDF file"),
        (["cite", "equilibrat"], "there is no equilibrat in jaxstab; the nearest is equilibrate."),
        (["cite", "Nope"], "there is no Nope in jaxstab; give one as equilibrate or potentials."),
        (["sweeps"], "there is no command sweeps. Commands: run, study, info"),
        (["cite", "plots.drawing"], "There is no plots.drawing in jaxstab: give a public name."),
        (["run", "--surface", "empty.txt"], "--youngs-modulus is needed with --surface"),
        (["run", "--surface", "empty.txt", *MATERIAL], "empty.txt"),
        (["run", "--config", "empty.txt", "--output", "empty.txt"], "empty.txt"),
        (["run", "--config", "broken.toml"], "broken.toml: it is not TOML"),
        (["run", "--config", "other.toml"], "other.toml: config is 'wrong.toml': give options"),
        (
            ["--first", "1", "--last", "1", "--size", "16", "--k-high", "4"],
            "repeats the one before",
        ),
        (["run", "--config", "twice.toml"], "twice.toml: k-high is given twice"),
        (["run", "--config", "wrong.toml"], "wrong.toml: size is True: give options as"),
        (
            ["run", "--config", "typo.toml"],
            "typo.toml: there is no option --rms-hight; the nearest is --rms-height.",
        ),
    ],
)
def test_files_that_make_no_sense_end_in_one_line(
    tmp_path, monkeypatch, capsys, arguments, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.txt").touch()
    (tmp_path / "broken.toml").write_text("size = = 3")
    (tmp_path / "wrong.toml").write_text("size = true")
    (tmp_path / "twice.toml").write_text("k_high = 8\n[surface]\nk-high = 9")
    (tmp_path / "typo.toml").write_text("[surface]\nrms_hight = 0.1")
    (tmp_path / "other.toml").write_text('config = "wrong.toml"')
    assert_refused(arguments, message, capsys)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le"])
def test_a_configuration_is_read_in_the_encodings_of_editors(tmp_path, encoding, capsys):
    file = tmp_path / "editor.toml"
    file.write_bytes("size = true".encode(encoding))
    assert_refused(["run", "--config", str(file)], "size is True: give options as", capsys)
    file.write_bytes(b"\0\1\2")
    assert_refused(["run", "--config", str(file)], "it is not TOML: it is no text", capsys)


def assert_refused(arguments, message, capsys):
    with pytest.raises(SystemExit) as refused:
        main(arguments)
    said = capsys.readouterr().err
    assert refused.value.code == 2
    assert message in said and said.count("\n") == 1, said


@pytest.mark.parametrize(
    "arguments", [["rnu"], ["--siz", "8"], ["info", "none.x3p"], ["cite", "x"]]
)
def test_a_mistake_is_answered_before_anything_heavy_is_imported(arguments):
    code = (
        "import sys, jaxstab.__main__ as command\n"
        f"try: command.main({arguments})\n"
        "except SystemExit as ended: print(ended.code)\n"
        "print(sorted({'jax', 'numpy', 'equinox', 'matplotlib'} & {*sys.modules}))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines() == ["2", "[]"]
    assert len(ran.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("unbuffered", "arguments"),
    [
        pytest.param("", ["cite", "equilibrate"], marks=pytest.mark.nightly),
        ("", ["run", "--help"]),
        ("1", ["--size", "8", "--k-high", "2"]),
    ],
)
def test_nothing_is_said_when_the_reader_of_a_pipe_has_gone(unbuffered, arguments, tmp_path):
    environment = {"PYTHONUNBUFFERED": unbuffered, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    with subprocess.Popen(
        [sys.executable, "-m", "jaxstab", *arguments],
        cwd=tmp_path,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141
    # A run that wrote nothing leaves no folder.
    assert not list((tmp_path / "results").glob("*"))


def test_advice_has_the_form_of_the_command_line(tmp_path, capsys):
    np.savetxt(tmp_path / "plain.txt", np.random.default_rng(0).normal(size=(40, 40)))
    with pytest.raises(SystemExit):
        main(["run", "--surface", str(tmp_path / "plain.txt"), *MATERIAL])
    assert "as in --lengths 3 1.4." in capsys.readouterr().err
    for python, options in (
        (
            'by `Topography.periodic("mirror")`, which keeps a, or '
            '`Topography.periodic("window")`, which keeps b.',
            "by --periodic mirror, which keeps a, or --periodic window, which keeps b.",
        ),
        ("locate fewer jumps (`smallest_jump`)", "locate fewer jumps (--smallest-jump)"),
        ('choose `width="double"`.', "choose --width double."),
        ("leave out `lengths=`, `mu`", "leave out --lengths, `mu`"),
        ("loosen it, or use `float64`.", "loosen it, or use --precision float64."),
    ):
        assert in_options(python) == options


def test_characters_that_a_terminal_lacks_are_spelled(tmp_path, monkeypatch):
    # A name that is no UTF-8, as Python reads it.
    file = tmp_path / "w\udce9ave.txt"
    np.savetxt(file, np.cos(2 * np.pi * np.arange(16) / 16)[:, None] * np.ones(16))
    written = io.BytesIO()
    terminal = io.TextIOWrapper(written, "ascii")
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setattr(sys, "stderr", terminal)
    open_streams()
    main(["info", str(file), "--lengths", "2000", "--unit", "µm"])
    with pytest.raises(SystemExit):
        main(["info", str(file), "--lengths", "2000", "--unit", "elle à dû"])
    print("3 ± 1 m², Å Œ")
    terminal.flush()
    said = written.getvalue().decode("ascii")
    assert "2000 x 2000 um" in said
    assert "w?ave.txt: the unit is 'elle a du': choose one of km, m, cm, mm, um, nm, A, pm" in said
    assert said.endswith("3 +- 1 m2, A ?\n")


def test_an_argument_is_what_was_typed_in_any_locale(monkeypatch):
    # As Python reads it where the locale is C and UTF-8 is off.
    monkeypatch.setattr(os, "fsencode", lambda text: text.encode("ascii", "surrogateescape"))
    assert parsing.typed_text("\udcc2\udcb5m") == "µm"


def test_streams_that_are_closed_take_what_is_said(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    open_streams()
    with pytest.raises(SystemExit):
        main(["cite", "equilibrat"])
    print("nobody reads this")
    sys.stdout.flush()
