"""The tables and figures of the documentation: what makes each, and which rooms it measures.

`python -m benchmarks` runs them; a table `NAME` lies in `benchmarks/results/NAME.md`.
"""

from typing import NamedTuple


class Table(NamedTuple):
    """A script with its arguments, the packages that it measures, and what else it needs.

    `rooms` are folders of `jaxstab/`; a change of their code makes the table old. `peers` are
    distributions whose versions are part of the result. A table that `needs` something that not
    every machine has is made only if it is named. `figures` are patterns of the files that the
    script writes beside its table.
    """

    command: str
    rooms: str
    peers: str = ""
    needs: str = ""
    figures: str = ""

    @property
    def script(self) -> str:
        return self.command.split()[0]


_CURVES = "--folder with files of instruments"

# The figures come last, since they are drawn from tables.
TABLES = {
    "accelerator-nvidia-h200": Table(
        "benchmarks/accelerator.py", "equilibrium stability loading evolution", needs="an H200"
    ),
    "adverse_equilibria": Table("benchmarks/adverse_equilibria.py", "equilibrium potentials loads"),
    "axisymmetric": Table("benchmarks/axisymmetric.py", "solids branches loading"),
    "barriers": Table("benchmarks/barriers.py", "branches transitions"),
    "batches": Table("benchmarks/batches.py", "equilibrium"),
    "branches": Table("benchmarks/branches.py", "branches"),
    "certificates": Table("benchmarks/certificates.py", "stability"),
    "closed_forms": Table("benchmarks/closed_forms.py", "branches loading potentials"),
    "coarse_starts": Table("benchmarks/coarse_starts.py", "stability"),
    "derivatives": Table("benchmarks/derivatives.py", "equilibrium"),
    "eigenvalues": Table("benchmarks/eigenvalues.py", "stability"),
    "fails_safely": Table("benchmarks/fails_safely.py", "stability"),
    "first_verdict": Table("benchmarks/first_verdict.py", "core contact equilibrium stability"),
    "force_curve_errors": Table("benchmarks/force_curve_errors.py --curves 100", "lab"),
    "force_curves": Table(
        "benchmarks/force_curves.py {folder}", "lab", peers="afmformats", needs=_CURVES
    ),
    "free_half_space": Table(
        "benchmarks/free_half_space.py",
        "solids equilibrium loading",
        peers="Adhesion ContactMechanics muGrid",
    ),
    "half_spaces": Table("benchmarks/half_spaces.py", "solids", peers="ContactMechanics"),
    "hardness": Table(
        "benchmarks/hardness.py",
        "contact equilibrium",
        peers="tamaas ContactMechanics SurfaceTopography muGrid",
    ),
    "jumps": Table("benchmarks/jumps.py", "loading"),
    "kernels": Table("benchmarks/kernels.py", "equilibrium stability"),
    "laboratory": Table("benchmarks/laboratory.py", "contact loading"),
    "laboratory_curves": Table("benchmarks/laboratory.py --curves 20", "calibration"),
    "mutants": Table(
        "benchmarks/mutants.py", "solids loads potentials contact equilibrium stability branches"
    ),
    "paths": Table("benchmarks/paths.py", "loading"),
    "peers": Table(
        "benchmarks/peers.py --sizes 256 512 1024",
        "equilibrium",
        peers="tamaas Adhesion ContactMechanics SurfaceTopography NuMPI muGrid",
    ),
    "problems": Table(
        "benchmarks/problems.py", "equilibrium", peers="tamaas Adhesion ContactMechanics NuMPI"
    ),
    "processes": Table("benchmarks/processes.py 1 2 4 8", "core equilibrium"),
    "programs": Table("benchmarks/programs.py", "core equilibrium stability branches loading"),
    "pull_offs": Table("benchmarks/pull_offs.py", "branches loading"),
    "robustness": Table("benchmarks/robustness.py", "equilibrium"),
    "sensitivity": Table(
        "benchmarks/sensitivity.py --every 3",
        "core equilibrium stability branches loading evolution transitions calibration",
    ),
    "sharded": Table("benchmarks/sharded.py", "core equilibrium"),
    "studies": Table("benchmarks/studies.py", "studies"),
    "validation": Table(
        "benchmarks/validation.py --large --figures docs/_static",
        "equilibrium loading surfaces",
        figures="docs/_static/challenge.svg docs/_static/stickiness.svg",
    ),
    "viscoelastic": Table("benchmarks/viscoelastic.py", "solids evolution", peers="tamaas"),
    "viscoelastic_fits": Table("benchmarks/viscoelastic_fits.py", "lab evolution"),
    "pictures": Table(
        "docs/pictures.py",
        "plots",
        figures="docs/_static/first_picture.png docs/_static/errors.svg docs/_static/gpu.svg "
        "docs/_static/speed.svg docs/_static/films/*.gif docs/_static/questions/*.svg",
    ),
    "paper_figures": Table("paper/figures.py", "plots", figures="paper/*.png"),
}
