"""The sources behind a computation, as text and as BibTeX."""

from jaxstab.citations.cite import Citations, cite

__all__ = ["Citations", "cite"]
