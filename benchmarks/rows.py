"""The rows of the table of validation."""

from typing import NamedTuple

HEAD = ["| setting | source | published | ours | difference |", "|---|---|---|---|---|"]


class Row(NamedTuple):
    """A setting, the source of its number, two bounds or words, and that beside ours."""

    setting: str
    source: str
    published: float | tuple[float, float] | str
    ours: float | str

    def __str__(self) -> str:
        ours = self.ours if isinstance(self.ours, str) else f"{self.ours:.6g}"
        if isinstance(self.published, str) or isinstance(self.ours, str):
            numbers = f"{self.published} | {ours} | "
        elif isinstance(self.published, tuple):
            least, most = self.published
            side = "between" if least <= self.ours <= most else "outside"
            numbers = f"{least:.4g} to {most:.4g} | {ours} | {side}"
        else:
            difference = 100 * (self.ours / self.published - 1)
            numbers = f"{self.published:.6g} | {ours} | {difference:+.2g} %"
        return f"| {self.setting} | {self.source} | {numbers} |"
