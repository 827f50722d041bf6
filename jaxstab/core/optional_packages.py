"""Packages that do not come with jaxstab, but with one of its extras."""

from importlib import import_module
from importlib.util import find_spec

# The second comes without the third.
NETCDF = ("xarray", "h5netcdf", "h5py")


def are_installed(*packages: str) -> bool:
    """Return whether all of some packages are."""
    return all(find_spec(name) for name in packages)


def require_packages(purpose: str, extra: str, *packages: str) -> None:
    """Raise `ImportError` that names the extra, unless all of some packages can be imported."""
    try:
        for name in packages:
            import_module(name)
    except ImportError as error:
        sentence = f"{purpose} need {', '.join(packages)}: pip install 'jaxstab[{extra}]'."
        raise ImportError(sentence) from error
