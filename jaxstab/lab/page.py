"""A page of HTML that loads nothing: texts are escaped, figures are inside."""

from base64 import b64encode
from collections.abc import Iterable, Sequence
from html import escape
from io import BytesIO
from string import Template

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Two figures stand side by side on a screen, one below the other on a phone, where a figure of this
# width [inch] keeps letters that can be read.
_WIDTH, _HEIGHT = 4.8, 3.6
_DPI = 160
_PAGE = Template("""\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
body { margin: 0 auto; padding: 1rem; max-width: 62rem; background: white; color: #1b1b1b;
  font: 1rem/1.5 system-ui, sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.6rem; line-height: 1.25; }
h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #ccc; }
.scroll { overflow-x: auto; overflow-wrap: normal; }
table { border-collapse: collapse; font-size: 0.95rem; }
th, td { padding: 0.25rem 0.9rem 0.25rem 0; text-align: left; vertical-align: top; }
tr + tr > * { border-top: 1px solid #e4e4e4; }
th { font-weight: 600; }
thead th { border-bottom: 1px solid #888; }
thead + tbody td { white-space: nowrap; }
thead + tbody th { min-width: 5.5rem; }
.figures { display: grid; gap: 1rem; margin-top: 1rem;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, 22rem), 1fr)); }
figure { margin: 0; }
figure img { display: block; width: 100%; height: auto; }
figcaption { font-size: 0.9rem; color: #444; }
pre { padding: 0.7rem; background: #f4f4f4; white-space: pre-wrap; }
pre span { display: inline-block; max-width: 100%; }
</style>
</head>
<body>
<h1>$title</h1>
$body
</body>
</html>
""")


def page(title: str, parts: Iterable[str]) -> str:
    """Return the page of a title and parts, which the functions below make."""
    return _PAGE.substitute(title=escape(title), body="\n".join(parts))


def heading(text: str) -> str:
    """Return the heading of a section."""
    return f"<h2>{escape(text)}</h2>"


def paragraph(text: str) -> str:
    """Return a paragraph."""
    return f"<p>{escape(text)}</p>"


def bullets(texts: Iterable[str]) -> str:
    """Return a list of texts."""
    return "<ul>" + "".join(f"<li>{escape(text)}</li>" for text in texts) + "</ul>"


def command(words: Iterable[str]) -> str:
    """Return the words of a command, which lines divide between words only."""
    return "<pre>" + " ".join(f"<span>{escape(word)}</span>" for word in words) + "</pre>"


def table(rows: Iterable[Sequence[str]], header: Sequence[str] = ()) -> str:
    """Return a table, whose first column names the rows."""
    head = "".join(f"<th>{escape(text)}</th>" for text in header)
    lines = [f"<thead><tr>{head}</tr></thead>"] if header else []
    lines.append("<tbody>")
    for name, *cells in rows:
        body = "".join(f"<td>{escape(text)}</td>" for text in cells)
        lines.append(f"<tr><th>{escape(name)}</th>{body}</tr>")
    # A wide table scrolls on a narrow screen rather than widen the page.
    return '<div class="scroll"><table>' + "\n".join(lines) + "</tbody></table></div>"


def axes_of_figure() -> Axes:
    """Return the axes of a new figure of the size of a page's figures."""
    # Without a layout engine a legend goes inside, where it takes no width.
    return plt.figure(figsize=(_WIDTH, _HEIGHT)).add_subplot()


def figures(drawn: Iterable[tuple[Axes, str]]) -> str:
    """Return figures, each with its caption, and close them."""
    parts = []
    for axes, caption in drawn:
        figure = axes.get_figure(root=True)
        assert isinstance(figure, Figure)
        figure.set_layout_engine("constrained")
        picture = BytesIO()
        figure.savefig(picture, format="png", dpi=_DPI)
        plt.close(figure)
        data = b64encode(picture.getvalue()).decode("ascii")
        text = escape(caption)
        image = f'<img alt="{text}" src="data:image/png;base64,{data}">'
        parts.append(f"<figure>{image}<figcaption>{text}</figcaption></figure>")
    return '<div class="figures">' + "\n".join(parts) + "</div>"
