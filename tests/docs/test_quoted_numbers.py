"""The numbers of README, paper and pages beside the tables that they are quoted from.

Each phrase is written anew from the tables of `benchmarks/results/`, with as many digits as the
page shows, and must be on its page. On some stretches of pages no other number is allowed.
"""

import re
from pathlib import Path
from statistics import median

import pytest

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "results"
README, PAPER, PERFORMANCE = "README.md", "paper/paper.md", "docs/performance.md"
H200 = "accelerator-nvidia-h200.md"
# Sizes of grids, names and addresses are not measured.
NOT_MEASURED = re.compile(
    r"\d+²(?: to \d+²)?|\d+ x \d+ points|H200|Algorithm 1|float\d\d|\[@[^\]]*\]|@\w+"
    r"|\]\([^)]*\)|`[^`]*`|!\[[^\]]*\]\([^)]*\)"
)
NUMBER = re.compile(r"\d[\d.]*(?:e[-+]?\d+)?")
# Stretches, from one text to another, whose numbers are all quoted.
QUOTED = {
    README: [("## How fast", "## How to cite")],
    PAPER: [("**Verdicts with error bars.**", "**Large studies.**"), ("# Limits", "# Avail")],
    PERFORMANCE: [("## In short", "`benchmarks/accelerator.py`")],
}


def rows(name, heading="", **chosen):
    """Return the rows of the first table below a heading, as dictionaries, those of some cells."""
    text = (ROOT / name if "/" in name else RESULTS / name).read_text()
    text = text[text.index(heading) :]
    header, *lines = re.search(r"^\|.*\n\|[-|: ]+\n((?:\|.*\n?)+)", text, re.MULTILINE)[0].split(
        "\n"
    )
    # Of two columns with one name, the second is called by its number.
    names = cells(header)
    names = [f"{x} 2" if x in names[:i] else x for i, x in enumerate(names)]
    found = [dict(zip(names, cells(line), strict=True)) for line in lines[1:] if line]
    words = {key: str(value) for key, value in chosen.items()}
    return [row for row in found if all(row[key] == value for key, value in words.items())]


def cells(line):
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def column(name, key, heading="", **chosen):
    """Return the first number of each cell of a column."""
    found = [number(row[key]) for row in rows(name, heading, **chosen)]
    assert found, (name, chosen)
    return found


def number(cell):
    return float(re.search(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?", cell)[0])


def digits(value, count=2):
    """Return a number with so many digits, without an exponent."""
    rounded = float(f"{value:.{count}g}")
    decimals = max(0, count - 1 - int(f"{rounded:e}".split("e")[1])) if rounded else 0
    return f"{rounded:.{decimals}f}"


def thousands(value):
    return f"{float(digits(value)):,.0f}".replace(",", " ")


def spread(values, between=" to "):
    return between.join(digits(value) for value in (min(values), max(values)))


def text_of(name):
    return (RESULTS / name).read_text()


def peers():
    def of(key, peer, kind="adhesive", **chosen):
        return column("peers.md", key, peer=peer, problem=kind, **chosen)

    versions = dict(re.findall(r"(\w+) ([\d.]+)", text_of("peers.md").partition("\n|")[0]))
    tamaas, numpi = versions["tamaas"][:3], versions["NuMPI"].rpartition(".")[0]
    yield README, f"| points | jaxstab | Tamaas {tamaas} | NuMPI {numpi}, `tr_newton_bounded` |"
    for n in (256, 512, 1024):
        (ours,), (theirs,) = (of(x, "tamaas", n=n, k_high=32) for x in ("jaxstab [s]", "peer [s]"))
        (newton,) = of("peer [s]", "numpi", n=n, k_high=32)
        yield README, f"| {n}² | {digits(ours)} | {digits(theirs)} | {digits(newton)} |"
    assert max(number(row["gaps differ by"]) for row in rows("peers.md")) < 1e-6
    yield README, "Gaps agree within 1e-6 of the rms height"
    faster = {peer: of("peer / jaxstab", peer) for peer in ("tamaas", "numpi")}
    steps = of("steps", "tamaas")
    yield (
        PAPER,
        f"In {min(steps):.0f} to {max(steps):.0f} steps it reaches the same equilibrium as Tamaas "
        f"{tamaas}, {spread(faster['tamaas'])} times faster. It is {spread(faster['numpi'])} times "
        f"faster than the trust-region Newton method of NuMPI {numpi}.",
    )
    ours, theirs = (of(key, "tamaas") for key in ("jaxstab [s]", "peer [s]"))
    newton = of("peer [s]", "numpi")
    yield (
        PERFORMANCE,
        f"{spread(ours, ' s to ')} s, against {spread(theirs, ' s to ')} s: "
        f"{spread(faster['tamaas'])} times faster",
    )
    yield (
        PERFORMANCE,
        f"{spread(newton, ' s to ')} s for NuMPI: {spread(faster['numpi'])} times faster",
    )
    bare = [of(key, "tamaas", "no adhesion") for key in ("jaxstab [s]", "peer [s]")]
    ratio = of("peer / jaxstab", "tamaas", "no adhesion")
    yield (
        PERFORMANCE,
        f"{spread(bare[0], ' s to ')} s, against {spread(bare[1], ' s to ')} s: "
        f"{spread(ratio)} times faster",
    )


def eigenvalues():
    times = {n: column("eigenvalues.md", "fast [s]", n=n) for n in (128, 256)}
    # The first ratio is of pairs, the second of seconds.
    ratios = {n: column("eigenvalues.md", "ratio 2", n=n) for n in (128, 256)}
    middle = " and ".join(f"{median(ratios[n]):.0f}" for n in ratios)
    least = " and ".join(digits(min(ratios[n])) for n in ratios)
    spreads = ", ".join(f"{spread(times[n])} s at {n}²" for n in times)
    yield PERFORMANCE, spreads
    yield PERFORMANCE, f"{middle} in the median, {least} at least"
    in_pairs = " and ".join(
        f"{median(column('eigenvalues.md', 'ratio', n=n)):.0f}" for n in (128, 256)
    )
    yield (
        PERFORMANCE,
        f"takes {in_pairs} times as many transforms, with less work between them: {middle} times "
        "as much time",
    )
    yield (
        PAPER,
        f"In the median a verdict is {middle} times faster than that one eigenvalue by the "
        "proximal iteration of @rey_bleyer_2018, on grids of 128² and 256² points.",
    )
    ended = [row["Algorithm 1 ended as"] for row in rows("eigenvalues.md")]
    failed = sum(end != "successful" for end in ended)
    yield (
        PERFORMANCE,
        f"In all {len(ended)} states the verdict was faster, by a factor of at least "
        f"{digits(min(min(ratios[n]) for n in ratios))}. In {failed} of them Algorithm 1 did not",
    )
    over = {n: column("eigenvalues.md", "over pairs", n=n) for n in ratios}
    middle_over = " and ".join(digits(median(over[n])) for n in over)
    yield PERFORMANCE, f"takes {middle_over} times as long as its transforms alone, in the median"
    yield PERFORMANCE, f"up to {digits(max(map(max, over.values())))}, without contact"
    yield (
        PERFORMANCE,
        f"they take {spread(column('coarse_starts.md', 'ratio'))} times as many pairs",
    )
    (ours,) = [rows("eigenvalues.md", "Pairs of the default solver")]
    pairs = [float(row[n]) for row in ours for n in ("128", "256", "512", "1024")]
    theirs = [number(row["Algorithm 1"]) for row in rows("eigenvalues.md")]
    assert max(theirs) > 200_000
    yield (
        PERFORMANCE,
        f"{spread(pairs)}; finer grids need no more. Algorithm 1 of the paper takes "
        f"{digits(min(theirs))} to over 200 000 pairs for one of them",
    )


def first_verdict():
    key = "from `import jax` to the verdict"
    times = {row[""]: number(row[key]) for row in rows("first_verdict.md")}
    cold, warm = digits(times["no cache"]), digits(times["warm cache"])
    yield README, f"first verdict at 128² in {cold} s on two cores"
    yield README, f"in {warm} s with JAX's compilation cache"
    yield PERFORMANCE, f"{cold} s; {warm} s with JAX's compilation cache"
    yield (
        PAPER,
        f"the first verdict of a process takes {cold} s on 128² points and two cores, or {warm} s "
        "with JAX's compilation cache",
    )


def accelerator():
    page = {row["points"]: row for row in rows(PERFORMANCE, "## On a GPU")}
    shown = {points: [*row.values()][1:] for points, row in page.items()}
    for row in rows(H200, "One contact, float64"):
        measured = [digits(number(row[key])) for key in ("equilibrium [s]", "verdict [s]")]
        of_page = shown[f"{row['points a side']}²"]
        assert [digits(float(of_page[i])) for i in (0, 3)] == measured
    # The times of the CPU are in no table but that of the page.
    measured = {
        points: [digits(float(times[i])) for i in (0, 3, 1, 4)]
        for points, times in shown.items()
        if times[1]
    }
    (batch,) = rows(H200, "Many contacts, float64", **{"points a side": 64})
    rates = [number(batch[f"a second{i}"]) for i in ("", " 2")]
    alone = [number(batch[f"one after another, a second{i}"]) for i in ("", " 2")]
    yield (
        PERFORMANCE,
        f"at 64² points {thousands(rates[0])} equilibria a second and {digits(rates[1])} verdicts, "
        f"instead of {' and '.join(map(digits, alone))} one after another",
    )
    (path,) = rows(H200, "A path to contact", **{"points a side": 256})
    seconds = digits(number(path["path [s]"]))
    yield PERFORMANCE, f"A path of {path['states']} states on 256² points takes {seconds} s"
    now, verdict, slow, slow_verdict = measured["2048²"]
    yield (
        README,
        f"On an NVIDIA H200 an equilibrium at 2048² takes {now} s and its verdict {verdict} s; two "
        f"CPU cores take {slow} s and {slow_verdict} s.",
    )
    yield (
        PAPER,
        f"On an NVIDIA H200 an equilibrium of 2048² points takes {now} s and its verdict "
        f"{verdict} s, on two CPU cores {slow} s and {slow_verdict} s.",
    )
    small = measured["512²"]
    yield (
        PERFORMANCE,
        f"{small[0]} and {small[1]} s at 512², {now} and {verdict} s at 2048²; {small[2]} and "
        f"{small[3]} s, {slow} and {slow_verdict} s on two CPU cores",
    )


def robustness():
    found = {row["solver"]: row for row in rows("robustness.md")}
    ours, reference = found["PreconditionedConjugateGradient"], found["PolonskyKeerRey"]
    assert ours["outcomes"] == "500 successful" and ours["energy rose"] == ours["saddles"] == "0"
    solved = int(number(reference["outcomes"]))
    failed = 500 - solved
    assert "500 random problems" in text_of("robustness.md")
    yield (
        README,
        "| [500 random problems](benchmarks/results/robustness.md) | always, in "
        f"{ours['seconds']} s; the reference solver failed on {failed} |",
    )
    yield (
        PAPER,
        "The method solved all of 500 random problems; the reference method, after "
        f"@polonsky_keer_1999 and @rey_anciaux_molinari_2017, solved {solved}.",
    )
    yield PERFORMANCE, "| 500 random problems, adhesion"
    yield PERFORMANCE, f"the reference solver failed on {failed}"
    text = text_of("adverse_equilibria.md")
    assert re.search(r"\b2000 problems on", text) and "wrong" not in text[text.index("\n|") :]
    yield PAPER, "Among 2000 adverse problems no wrong equilibrium was called successful."
    yield PERFORMANCE, "Of 2000 random equilibria none was successful and wrong"


def fails_safely():
    table = rows("fails_safely.md")
    undecided = {row["exact verdict"]: int(row["undecided"]) for row in table}
    right = undecided["undecided"] + undecided["broken"]
    (silent,) = column("fails_safely.md", "count", "| silent failure |")
    assert silent == 0
    text = text_of("fails_safely.md")
    problems, seconds = re.search(r"^(\d+) problems .* (\d+) s$", text, re.MULTILINE).groups()
    yield (
        README,
        f"[{problems} small problems](benchmarks/results/fails_safely.md), exact verdicts | never; "
        f"{sum(undecided.values())} were called `undecided`, {right} of them correctly; "
        f"{seconds} s",
    )
    yield PAPER, f"Of {problems} small problems with exact verdicts"


def pull_offs():
    errors = column("pull_offs.md", "less bisection")
    assert len(errors) == 12
    largest = max(map(abs, errors))
    short = f"{largest:.0e}".replace("e-0", "e-")
    yield README, f"[12 rough contacts](benchmarks/results/pull_offs.md), bisection | to {short} |"
    yield PAPER, f"Pull-off pressures agree with bisection to {largest:.1e}.".replace("e-0", "e-")
    yield PERFORMANCE, f"within {short} of a bisection; derivatives agree too |"


def closed_forms():
    headings = "Johnson's wave; pressures", "Maugis", "Johnson's wave, alpha = 0.5"
    table = [row for heading in headings for row in rows("closed_forms.md", heading)]
    resolved = [row for row in table if number(row["resolution"]) >= 4]
    of_pull_offs, of_jumps = (
        max(abs(number(row[key])) for row in resolved if key in row) for key in ("error", "error 2")
    )
    yield README, f"pull-offs within {of_pull_offs:.1f} % where the grid resolves the law"
    yield (
        PERFORMANCE,
        f"from a resolution of 4 on, those of pull-offs are at most {of_pull_offs:.1f} %, those of "
        f"jumps {of_jumps:.1f} %",
    )
    refined = {
        number(row["resolution"]): abs(number(row["error"]))
        for row in rows("closed_forms.md", "Johnson's wave, alpha = 0.5")
    }
    maugis = [abs(x) for x in column("closed_forms.md", "error", "Maugis", points="512²")]
    yield (
        PAPER,
        f"it is {refined[4]:.1f} % at a resolution of 4 and {refined[16]:.2f} % at 16",
    )
    yield PAPER, f"agree with @maugis_1992 within {max(maugis):.1f} % at 512 x 512 points."


def paths():
    loops = rows("paths.md", "Loops against")
    large, found = (
        sum(int(row[key]) for row in loops) for key in ("large jumps", "of these found")
    )
    assert large == found and len(loops) == 10 and "1200 steps a leg" in text_of("paths.md")
    apart = [abs(number(row["difference"])) for row in loops if row["difference"] != "none"]
    yield (
        PAPER,
        f"In ten random loops, load stepping with 1200 steps each way found {large} jumps of 1 % "
        "of a loop's loss or more. `follow` found all of them, and the losses of the loops differ "
        f"by at most {max(apart):.1f} %.",
    )
    yield PERFORMANCE, f"the losses of the loops differ by {min(apart):.1f} to {max(apart):.1f} %"
    jumps = rows("jumps.md")
    assert len(jumps) == 162 and {row["points"] for row in jumps} == {"0"}
    yield README, "[162 jumps](benchmarks/results/jumps.md), overdamped relaxation | all 162 at the"
    yield PAPER, "In all of 162 jumps, a gradient flow"


def derivatives():
    alone = column("derivatives.md", "gradient alone")
    yield (
        PAPER,
        f"The gradient of an equilibrium takes {spread(alone)} of the time of the equilibrium.",
    )
    (middle,) = column("derivatives.md", "gradient alone", n=256)
    yield PERFORMANCE, f"| {middle} times the equilibrium itself"


def single_contacts():
    (row,) = rows("free_half_space.md", "Seconds to the force", points="256²")
    apart = column("free_half_space.md", "force differs by", "Seconds to the force")
    assert max(map(abs, apart)) < 1e-4
    yield (
        PERFORMANCE,
        f"{digits(float(row['jaxstab [s]']))} s; {digits(float(row['Adhesion [s]']))} s for "
        f"Adhesion's L-BFGS-B on the same free system, {row['ratio']} times longer; forces within "
        "1e-4",
    )

    (hertz,) = column("free_half_space.md", "force", points="128²")
    maugis = [
        abs(number(row["error"]))
        for row in rows("free_half_space.md", "pulled off by a dead load", points="128²")
        if number(row["resolution"]) >= 4
    ]
    yield PERFORMANCE, f"within {hertz} %, and within {max(maugis):.1f} %"


def studies():
    text = text_of("studies.md")
    assert re.match(r"[\s\S]*\n20 kills .*\n- of any one case .* one that was done 0;", text)
    yield PERFORMANCE, "after 20 kills no finished case ran again"
    yield PAPER, "in 20 kills of its processes no finished case ran again"


TABLES = [
    peers,
    eigenvalues,
    first_verdict,
    accelerator,
    robustness,
    fails_safely,
    pull_offs,
    closed_forms,
    paths,
    derivatives,
    single_contacts,
    studies,
]


def squeezed(text):
    return " ".join(text.split())


@pytest.mark.parametrize("quotes", TABLES, ids=lambda quotes: quotes.__name__)
def test_pages_quote_the_tables(quotes):
    for page, phrase in quotes():
        assert phrase in squeezed((ROOT / page).read_text()), page


@pytest.mark.parametrize("page", QUOTED)
def test_no_other_number_is_quoted(page):
    whole = squeezed((ROOT / page).read_text())
    for start, end in QUOTED[page]:
        text = whole[whole.index(start) : whole.index(end)]
        for quotes in TABLES:
            for _, phrase in (quote for quote in quotes() if quote[0] == page):
                text = text.replace(phrase, "")
        assert NUMBER.findall(NOT_MEASURED.sub("", text)) == [], text
