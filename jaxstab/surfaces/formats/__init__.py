"""Formats of surfaces, in files and of other packages; each module makes a `Scan` of its own."""

from jaxstab.surfaces.formats.instruments import scan_of_topography
from jaxstab.surfaces.formats.labelled import scan_of_array, scan_of_dataset, scan_of_table
from jaxstab.surfaces.formats.scan import Scan


def scan_of(surface: object) -> Scan | None:
    """Return the content of a surface with labels or sides; None for others.

    That is an array of xarray, a table of pandas, or a surface of SurfaceTopography.
    """
    if isinstance(surface, Scan):
        return surface
    # They are recognised by their attributes, since neither package need be there.
    makers = {
        "data_vars": scan_of_dataset,
        "coords": scan_of_array,
        "iloc": scan_of_table,
        "physical_sizes": scan_of_topography,
    }
    maker = next((maker for name, maker in makers.items() if hasattr(surface, name)), None)
    try:
        return maker and maker(surface)
    except ValueError as error:
        raise ValueError(f"The {type(surface).__name__} of heights: {error}") from None


__all__ = ["Scan", "scan_of"]
